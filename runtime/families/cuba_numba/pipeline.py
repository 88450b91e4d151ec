"""The native pipeline: a program in memory, run by the compiled kernels; as Pipeline otherwise."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.runtime.emulator.ledger_builder import LedgerBuilder
from spikedeploy.runtime.emulator.raster import not_spikes
from spikedeploy.runtime.families.cuba_numba.arrays import NativeMemory, constants
from spikedeploy.runtime.families.cuba_numba.kernels import run
from spikedeploy.runtime.families.cuba_numpy.pipeline import Recording, Schedule


class NativePipeline:
    """A program's layers in memory, ready to run windows of T timesteps for a batch of B.

    States go on from window to window until `reset`.

    rowwise: whether all layers run one timestep after another, which closes loops.
    trace: whether to keep what `recordings` needs.
    counting: whether to count what `report` needs.
    """

    def __init__(
        self,
        program: Program,
        schedule: Schedule,
        batch: int,
        *,
        rowwise: bool,
        trace: bool,
        counting: bool,
    ) -> None:
        self.program, self.schedule = program, schedule
        timesteps = schedule.timesteps
        fixed = constants(program, schedule.late)
        self._memory = memory = NativeMemory(fixed, timesteps, batch, timesteps + 1 if trace else 2)
        self._counts = np.zeros((batch, len(program.layers), len(EVENTS)), np.int64)
        self._heard = np.zeros((timesteps, batch, program.layer(program.output).size))
        self._input = memory.rows(0)
        self._ways = (rowwise, counting)
        self._fresh = True
        lag = program.readout.lag if program.readout else 0
        numbers = (memory.slots, lag, schedule.steps)
        self._arguments = (*memory.constants, *memory.arrays, self._counts, self._heard, *numbers)
        # of a whole window from zero, which is what most calls ask for
        self._anew = (*self._arguments, -1, *self._ways, True)

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._fresh = True

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[np.float64]:
        """Spikes (T, B, N) that the readout hears, given those of the input (T, B, M).

        step: chip timestep of a single row; layers that start later only wait.
        """
        # a view, for numbers of one type are copied ten times faster than those of two
        values = rows.view(np.uint8) if rows.dtype.itemsize == 1 else np.minimum(rows, 2)
        self._input[...] = values.swapaxes(0, 1)
        arguments = self._anew
        if step is not None or not self._fresh:
            arguments = (*self._arguments, -1 if step is None else step, *self._ways, self._fresh)
        if not run(*arguments):
            raise not_spikes(rows)
        self._fresh = False
        return self._heard

    def report(self, recorder: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        recorder.add(self._counts, self.schedule.timesteps, self.schedule.steps)

    def resume(self, other: "NativePipeline") -> None:
        """Go on where another stands, whose windows have another length."""
        self._memory.copy(other._memory)
        self._fresh = other._fresh

    def now(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (B, N) of each layer."""
        names = [layer.name for layer in self.program.layers]
        both = [self._memory.states(k)[:, 0].astype(np.int64) for k in range(len(names))]
        # a reset waits for the next window
        return {
            name: (now[:, 0] * (not self._fresh), now[:, 1] * (not self._fresh))
            for name, now in zip(names, both, strict=True)
        }

    def recordings(self) -> dict[str, Recording]:
        """What each layer did in the last window."""
        recordings = {}
        for k, layer in enumerate(self.program.layers):
            # (B, T + 1, 2, N) to (2, B, T, N)
            states = self._memory.states(k)[:, 1:].transpose(2, 0, 1, 3)
            current, membrane = states.astype(np.int64)
            recordings[layer.name] = Recording(current, membrane, self._memory.rows(k + 1).copy())
        return recordings
