"""The backend that runs the interpreter: slow, and exact for every arithmetic.

Chips without kernels run on it, and tests compare the others with it.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Recording, SavedState, Schedule, check_counts
from spikedeploy.runtime.emulator.interpreter import Interpreter, LayerTrace, unbiased
from spikedeploy.runtime.emulator.ledger import LedgerBuilder, count


class InterpreterBackend:
    """An Interpreter as a Backend."""

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        self.schedule = schedule
        streaming = schedule.mode == "step"
        self._program = _at_once(program) if streaming else program
        self._starts = {layer.name: layer.start for layer in program.layers} if streaming else {}
        self._batch = batch
        self._lag = program.readout.lag if program.readout else 0
        self._waiting: set[str] = set()
        self._traces: dict[str, LayerTrace] = {}
        self.reset()

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """Supports every arithmetic."""
        return None

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._interpreter = self._fresh()
        size = self._program.layer(self._program.output).size
        self._tail = np.zeros((self._lag, self._batch, size), np.uint8)

    def _fresh(self) -> Interpreter:
        return Interpreter(self._program, self._batch)

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M)."""
        check_counts(rows, self._program.chip.input_spikes_max)
        self._waiting = {
            n for n, start in self._starts.items() if step is not None and step < start
        }
        self._raster = rows.swapaxes(0, 1).astype(np.uint8)
        self._traces = self._interpreter.run(self._raster, self._waiting)
        output_spikes = self._traces[self._program.output].spikes.swapaxes(0, 1)
        rows = np.concatenate([self._tail, output_spikes])
        self._tail = rows[len(output_spikes) :]
        return rows[: len(output_spikes)]

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        traces, timesteps = self._traces, self.schedule.timesteps
        counts = count(
            _without_biases(self._program, self._waiting),
            {self._program.input: self._raster, **{n: t.spikes for n, t in traces.items()}},
            {name: trace.active for name, trace in traces.items()},
            {name: trace.overflows for name, trace in traces.items()},
            self._waiting,
            {name: trace.lost for name, trace in traces.items() if trace.lost is not None},
        )
        ledger.add(counts, timesteps, self._program.steps(timesteps))

    def recordings(self) -> dict[str, Recording]:
        """What each layer did in the last window."""
        return {n: Recording(t.current, t.membrane, t.spikes) for n, t in self._traces.items()}

    def membranes(self, layer: str) -> NDArray[Any]:
        """Membranes (T, B, N) of a layer after each timestep of the last window [state units]."""
        return np.asarray(self._traces[layer].membrane.swapaxes(0, 1))

    def spikes(self, layer: str) -> NDArray[Any]:
        """Spikes (T, B, N) of a layer in the last window."""
        return np.asarray(self._traces[layer].spikes.swapaxes(0, 1))

    def states(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (B, N) of each layer; the current (B, K, N) where it has K."""
        states = self._interpreter.states
        return {name: (state.current, state.membrane) for name, state in states.items()}

    def saved(self) -> SavedState:
        """Copies of all states, and of the spikes that have not arrived yet."""
        saved = {"readout": self._tail.copy()}
        for name, tail in self._interpreter.tails.items():
            saved[f"spikes of {name}"] = tail.copy()
        for name, state in self._interpreter.states.items():
            for quantity, values in vars(state).items():
                saved[f"{quantity} of {name}"] = values.copy()
        return saved

    def restore(self, saved: SavedState) -> None:
        """Go on from there."""
        self._tail = saved["readout"].copy()
        tails = self._interpreter.tails
        self._interpreter.tails = {name: saved[f"spikes of {name}"].copy() for name in tails}
        for name, state in self._interpreter.states.items():
            for quantity in vars(state):
                setattr(state, quantity, saved[f"{quantity} of {name}"].copy())


def _at_once(program: Program) -> Program:
    """The program with all layers starting at once, so that lags are the delays of the chip."""
    layers = tuple(replace(layer, start=0) for layer in program.layers)
    return replace(program, layers=layers, clock="pipelined")


def _without_biases(program: Program, names: Iterable[str]) -> Program:
    """The program with silent bias axons for the layers of these names."""
    if not (waiting := set(names)):
        return program
    layers = (unbiased(layer) if layer.name in waiting else layer for layer in program.layers)
    return replace(program, layers=tuple(layers))
