"""Controllers: a policy file acting on a robot, on a chip or in float."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.artifact import Artifact
from runtime.chip import Chip
from runtime.compile import compile
from runtime.errors import ArtifactError
from runtime.float_machine import FloatMachine
from runtime.ledger import Ledger
from runtime.machine_pool import MachinePool
from runtime.program import Program
from runtime.recorder import Rows


class SpikingController:
    """Observation in, action out; the codec of the artifact does the rest.

    artifact: the policy.
    chip: what it runs on; None is the float twin, in float64.
    ledger: rows to keep, as in Recorder.
    options: for compile.
    """

    def __init__(
        self,
        artifact: Artifact,
        chip: Chip | None = None,
        ledger: Rows = "each",
        **options: Any,  # noqa: ANN401
    ) -> None:
        if artifact.codec is None:
            raise ArtifactError(
                "the file holds a network but no codec, so that observations cannot become spikes. "
                "Export the policy with spikedeploy, or run the network open loop with emulate."
            )
        self.codec = artifact.codec
        self.network: FloatMachine | MachinePool = (
            FloatMachine(artifact, ledger)
            if chip is None
            else MachinePool(compile(artifact, chip, **options), ledger)
        )

    @property
    def program(self) -> Program:
        """What runs; that of the float twin is the one without rounding."""
        return self.network.program

    def reset(self, seed: int) -> None:
        """Start an episode: forget every state. Nothing here is random; any seed does the same."""
        self.network.reset()

    def act(self, observation: ArrayLike) -> NDArray[np.float64]:
        """Action (act,) for the observation (obs,)."""
        return np.asarray(self.act_batch(np.asarray(observation)[None])[0])

    def act_batch(self, observations: ArrayLike) -> NDArray[np.float64]:
        """Actions (B, act) for the observations (B, obs) of B robots.

        Where states are kept, B must stay the same until `reset`.
        """
        output = self.network.infer(self.codec.encode(observations))
        return np.asarray(self.codec.decode(output), dtype=np.float64)

    @property
    def ledger(self) -> Ledger:
        """What happened since the controller was made."""
        return self.network.ledger
