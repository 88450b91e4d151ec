"""A policy file acting on a robot, on a chip or in float."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.damage import Damage
from spikedeploy.runtime.codec.codec import GIVE_CODEC, observed_numbers
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.copies import Copyable
from spikedeploy.runtime.emulator.backend import BackendMaker, BackendName
from spikedeploy.runtime.emulator.ledger import Ledger, Rows
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.running_network import run_network
from spikedeploy.runtime.errors import ArtifactError, ConfigError
from spikedeploy.runtime.faults import NONE, Faults

_STREAM = 2  # keeps the draws apart from those of an environment with the same seed


class Sampler(Copyable):
    """A sampler of the softmax of scores; the seed of the episode decides every draw.

    chooses: whether the policy chooses one of several actions, which is all that can be drawn.
    """

    def __init__(self, chooses: bool) -> None:
        if not chooses:
            raise ConfigError(
                "this policy puts out numbers, and how widely to draw around them was not "
                "exported; only one of several actions can be sampled. Leave sampling out."
            )
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start the draws of this seed."""
        self._rng = np.random.default_rng([seed, _STREAM])

    def __call__(self, scores: NDArray[np.floating]) -> NDArray[np.int64]:
        """Indices (B,) of actions drawn for the scores (B, act)."""
        # p = softmax(scores), unnormalised and summed up
        below = np.exp(scores - scores.max(axis=1, keepdims=True)).cumsum(axis=1)
        drawn = self._rng.random((len(scores), 1)) * below[:, -1:]
        return np.asarray((below[:, :-1] <= drawn).sum(axis=1))


class SpikingController(Copyable):
    """Observation in, action out; the codec of the artifact does the rest.

    Copies go on from where it is, as those of its Machine do.

    artifact: the policy.
    chip: what it runs on; None is the float twin, in float64.
    ledger: rows to keep, as in LedgerBuilder.
    sampled: draw one of several actions from the softmax of their scores; else the best is taken.
    backend: what computes on a chip, as in Machine; the float twin is always NumPy.
    faults: of the chip; the float twin has none.
    trace: whether the network keeps spikes and recordings of the last call.
    encoded: spikes (B, T, M) of the last call.
    output: (B, T, act) of the last call.
    options: for compile_program.
    """

    def __init__(
        self,
        artifact: Artifact,
        chip: Chip | None = None,
        ledger: Rows = "each",
        sampled: bool = False,
        backend: BackendName | BackendMaker = "numpy",
        faults: Faults = NONE,
        trace: bool = False,
        **options: Any,  # noqa: ANN401
    ) -> None:
        if artifact.codec is None:
            raise ArtifactError(
                "the file holds a network but no codec, so that observations cannot become spikes. "
                f"{GIVE_CODEC}. Or run the network open loop with emulate."
            )
        self.codec = artifact.codec
        self._kept = artifact.convention.state == "kept"
        self._sampler = Sampler(self.codec.chooses) if sampled else None
        on_chip = {"backend": backend, "faults": faults, **options} if chip else {}
        self.network = run_network(artifact, chip, ledger, trace, **on_chip)
        self._machine = self.network if isinstance(self.network, Machine) else None
        self.encoded: NDArray[Any] = np.zeros((0, 0, 0), np.uint8)
        self.output = np.zeros((0, 0, 0))
        self.reset(0)

    @property
    def program(self) -> Program:
        """The program that runs; that of the float twin is the one without rounding."""
        return self.network.program

    @property
    def remembers(self) -> bool:
        """True if an action depends on more than its observation."""
        remembers = self._kept or self.codec.encoder.remembers or self._sampler is not None
        return remembers or (self._machine is not None and self.program.upsets is not None)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """Hits of the chip's faults, those over time since the controller was made."""
        return self._machine.damage if self._machine else ()

    def reset(self, seed: int = 0, each: Sequence[int] = ()) -> None:
        """Start an episode: forget every state; what is random in it comes from the seed.

        each: seeds of the B robots of a batch, of which each has upsets of its own.
        """
        self.network.reset()
        if self._machine is not None:
            self._machine.seed(each or (seed,))
        self._state = self.codec.encoder.start(seed)
        if self._sampler is not None:
            self._sampler.reset(seed)

    def act(self, observation: ArrayLike) -> NDArray[Any]:
        """Action (act,), or () int where one of several is chosen, for the observation (obs,)."""
        return np.asarray(self.act_batch(observed_numbers(observation)[None])[0])

    def act_batch(self, observations: ArrayLike) -> NDArray[Any]:
        """Actions (B, act), or (B,) int, for the observations (B, obs) of B robots.

        Where states are kept, also by the encoder, B must stay the same until `reset`.
        """
        self.encoded = self.codec.encode(observations, self._state)
        self.output = self.network.infer(self.encoded)
        if self._sampler is not None:
            return self._sampler(self.codec.scores(self.output))
        return self.codec.decode(self.output)

    @property
    def ledger(self) -> Ledger:
        """The events since the controller was made."""
        return self.network.ledger
