"""Controllers: a policy file acting on a robot, on a chip or in float.

Machines for batches of any size, with one ledger.

Draws one of several actions, the likelier the higher its score.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.codec.xorshift import Xorshift
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Backend
from spikedeploy.runtime.emulator.float_machine import FloatMachine
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.ledger_builder import LedgerBuilder, Rows
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ArtifactError, ConfigError

# inferences that are computed at once: enough to fill matrix products, few enough for the cache
CHUNK = 64


class MachinePool:
    """A Machine for each batch size that comes along.

    program: what they run.
    ledger: rows to keep, as in Recorder.
    backend: what computes, as in Machine.
    """

    def __init__(self, program: Program, ledger: Rows = "each", backend: Backend = "numpy") -> None:
        self.program = program
        self._backend = backend
        self._recorder = LedgerBuilder(program, ledger)
        self._machines: dict[int, Machine] = {}

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        for machine in self._machines.values():
            machine.reset()

    def infer(self, spikes: NDArray[Any]) -> NDArray[np.float64]:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says.

        States that are kept belong to a batch size: do not change it without `reset`.
        """
        batch = len(spikes)
        if batch <= CHUNK or self.program.convention.state == "kept":
            return self._machine(batch).infer(spikes)
        chunks = [spikes[at : at + CHUNK] for at in range(0, batch, CHUNK)]
        return np.concatenate([self._machine(len(chunk)).infer(chunk) for chunk in chunks])

    @property
    def ledger(self) -> Ledger:
        """What happened since the pool was made."""
        return self._recorder.ledger()

    def _machine(self, batch: int) -> Machine:
        if batch not in self._machines:
            self._machines[batch] = Machine(
                self.program, batch, self._recorder, backend=self._backend
            )
        return self._machines[batch]


STREAM = 2  # keeps the draws apart from those of an environment with the same seed


class Sampler:
    """Draws from the softmax of scores; the seed of the episode decides every draw.

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
        self._rng = np.random.default_rng([seed, STREAM])

    def __call__(self, scores: NDArray[np.floating]) -> NDArray[np.int64]:
        """Indices (B,) of actions drawn for the scores (B, act)."""
        # p = softmax(scores), unnormalised and summed up
        below = np.exp(scores - scores.max(axis=1, keepdims=True)).cumsum(axis=1)
        thrown = self._rng.random((len(scores), 1)) * below[:, -1:]
        return np.asarray((below[:, :-1] <= thrown).sum(axis=1))


class SpikingController:
    """Observation in, action out; the codec of the artifact does the rest.

    artifact: the policy.
    chip: what it runs on; None is the float twin, in float64.
    ledger: rows to keep, as in Recorder.
    sampled: draw one of several actions from the softmax of their scores; else the best is taken.
    backend: what computes on a chip, as in Machine; the float twin is always NumPy.
    options: for compile.
    """

    def __init__(
        self,
        artifact: Artifact,
        chip: Chip | None = None,
        ledger: Rows = "each",
        sampled: bool = False,
        backend: Backend = "numpy",
        **options: Any,  # noqa: ANN401
    ) -> None:
        if artifact.codec is None:
            raise ArtifactError(
                "the file holds a network but no codec, so that observations cannot become spikes. "
                "Export the policy with spikedeploy, or run the network open loop with emulate."
            )
        self.codec = artifact.codec
        self._kept = artifact.convention.state == "kept"
        self._sampler = Sampler(self.codec.chooses) if sampled else None
        self.network: FloatMachine | MachinePool = (
            FloatMachine(artifact, ledger)
            if chip is None
            else MachinePool(compile_program(artifact, chip, **options), ledger, backend)
        )
        self.reset(0)

    @property
    def program(self) -> Program:
        """What runs; that of the float twin is the one without rounding."""
        return self.network.program

    @property
    def remembers(self) -> bool:
        """Whether an action depends on more than its observation."""
        return self._kept or self.codec.encoder.random or self._sampler is not None

    def reset(self, seed: int) -> None:
        """Start an episode: forget every state; what is random in it comes from the seed."""
        self.network.reset()
        self._dice = Xorshift(seed, self.codec.encoder.width)
        if self._sampler is not None:
            self._sampler.reset(seed)

    def act(self, observation: ArrayLike) -> NDArray[Any]:
        """Action (act,), or () int where one of several is chosen, for the observation (obs,)."""
        return np.asarray(self.act_batch(np.asarray(observation)[None])[0])

    def act_batch(self, observations: ArrayLike) -> NDArray[Any]:
        """Actions (B, act), or (B,) int, for the observations (B, obs) of B robots.

        Where states are kept, B must stay the same until `reset`.
        """
        output = self.network.infer(self.codec.encode(observations, self._dice))
        if self._sampler is not None:
            return self._sampler(self.codec.scores(output))
        return self.codec.decode(output)

    @property
    def ledger(self) -> Ledger:
        """What happened since the controller was made."""
        return self.network.ledger
