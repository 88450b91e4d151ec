"""The Numba backend: a program in memory, run by the compiled kernels."""

from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Recording, SavedState, Schedule, not_spikes
from spikedeploy.runtime.emulator.ledger import EVENTS, LedgerBuilder
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.numba_program import OVERFLOWS, WindowMemory, constants
from spikedeploy.runtime.families.cuba.numpy_backend import unsupported_synapses


class NumbaPipeline:
    """CuBa-LIF layers with integers as a Backend."""

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        # loads the compiler, which takes longer than everything else
        from spikedeploy.runtime.families.cuba.numba_kernels import run

        self.schedule = schedule
        self._program, self._kernel = program, run
        fixed, timesteps = program.chip.arithmetic, schedule.timesteps
        if not isinstance(fixed, CubaFixedPoint):
            raise ConfigError(str(self.obstacle(program)))
        slots = timesteps + 1 if schedule.trace else 2
        known = constants(program, fixed, schedule.delays, schedule.mode != "step")
        self._memory = memory = WindowMemory(known, timesteps, batch, slots)
        self._membranes = self._views_of_membranes()
        self._counts = np.zeros((batch, len(program.layers), len(EVENTS)), np.int64)
        self._presynaptic = np.zeros((timesteps, batch, program.layer(program.output).size))
        self._input = memory.rows(0)
        self._flags = (schedule.mode == "row", schedule.counting)
        self._fresh = True
        lag = program.readout.lag if program.readout else 0
        numbers = (memory.slots, lag, schedule.steps)
        outputs = (self._counts, self._presynaptic)
        self._arguments = (*memory.constants, *memory.arrays, *outputs, *numbers)
        # of a whole window from zero, which is what most calls ask for
        self._anew = (*self._arguments, -1, *self._flags, True)

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        chip = program.chip
        if not isinstance(chip.arithmetic, CubaFixedPoint):
            return (
                f"chip {chip.name!r} has no integers, so its sums depend on their order, and "
                "compiled ones would not be equal. Choose a chip with integers."
            )
        if obstacle := unsupported_synapses(program):
            return obstacle
        if _has_unknown_registers(chip.arithmetic):
            return (
                f"chip {chip.name!r} has a register that the compiled kernels do not know: one "
                "that saturates, has a narrower range, or holds the push."
            )
        if find_spec("numba") is None:
            return "Numba is not installed. In the checkout of spikedeploy: pip install '.[fast]'."
        return None

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._fresh = True

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[np.float64]:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M)."""
        # a view, for numbers of one type are copied ten times faster than those of two
        values = rows.view(np.uint8) if rows.dtype.itemsize == 1 else np.minimum(rows, 2)
        self._input[...] = values.swapaxes(0, 1)
        arguments = self._anew
        if step is not None or not self._fresh:
            arguments = (*self._arguments, -1 if step is None else step, *self._flags, self._fresh)
        if not self._kernel(*arguments):
            raise not_spikes(rows)
        self._fresh = False
        return self._presynaptic

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        ledger.add(self._counts, self.schedule.timesteps, self.schedule.steps)

    def recordings(self) -> dict[str, Recording]:
        """A recording of the last window of each layer."""
        recordings = {}
        for k, layer in enumerate(self._program.layers):
            # (B, T + 1, 2, N) to (2, B, T, N)
            states = self._memory.states(k)[:, 1:].transpose(2, 0, 1, 3)
            current, membrane = states.astype(np.int64)
            recordings[layer.name] = Recording(current, membrane, self._memory.rows(k + 1).copy())
        return recordings

    def membranes(self, layer: str) -> NDArray[Any]:
        """Membranes (T, B, N) of a layer after each timestep of the last window [state units]."""
        return self._membranes[layer]

    def spikes(self, layer: str) -> NDArray[Any]:
        """Spikes (T, B, N) of a layer in the last window."""
        place = [each.name for each in self._program.layers].index(layer)
        return np.asarray(self._memory.rows(place + 1).swapaxes(0, 1))

    def states(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (B, N) of each layer."""
        names = [layer.name for layer in self._program.layers]
        both = [self._memory.states(k)[:, 0].astype(np.int64) for k in range(len(names))]
        return {name: (now[:, 0], now[:, 1]) for name, now in zip(names, both, strict=True)}

    def saved(self) -> SavedState:
        """Copies of all states, and of the spikes that have not arrived yet."""
        # a reset waits for the next window
        return {} if self._fresh else self._memory.saved()

    def restore(self, saved: SavedState) -> None:
        """Go on from there; T may be another."""
        self._fresh = not saved
        if saved:
            self._memory.restore(saved)

    def _views_of_membranes(self) -> dict[str, NDArray[np.float64]]:
        """(T, B, N) of each layer."""
        # without a trace there is one timestep, whose states have become those of now
        rows = slice(1, None) if self.schedule.trace else slice(1)
        return {
            layer.name: self._memory.states(k)[:, rows, 1].swapaxes(0, 1)
            for k, layer in enumerate(self._program.layers)
        }


def _has_unknown_registers(fixed: CubaFixedPoint) -> bool:
    """True where registers do what only the interpreter and the NumPy kernels compute."""
    registers = fixed.accumulator, fixed.current, fixed.membrane
    odd = any(r.overflow not in OVERFLOWS or r.between is not None for r in registers)
    return odd or fixed.push.overflow != "none"
