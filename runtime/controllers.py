"""Controllers: a policy file acting on a robot, on a chip or in float."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.artifact import Artifact
from runtime.backend import Backend
from runtime.chip import Chip
from runtime.compile import compile
from runtime.errors import ArtifactError
from runtime.float_machine import FloatMachine
from runtime.ledger import Ledger
from runtime.machine_pool import MachinePool
from runtime.program import Program
from runtime.recorder import Rows
from runtime.sampler import Sampler
from runtime.xorshift import Xorshift


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
            else MachinePool(compile(artifact, chip, **options), ledger, backend)
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
