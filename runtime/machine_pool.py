"""Machines for batches of any size, with one ledger."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.backend import Backend
from runtime.ledger import Ledger
from runtime.machine import Machine
from runtime.program import Program
from runtime.recorder import Recorder, Rows

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
        self._recorder = Recorder(program, ledger)
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
