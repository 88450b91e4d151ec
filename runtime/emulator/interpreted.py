"""The interpreted pipeline: a program run by the interpreter; as Pipeline otherwise.

Slow, and exact for every arithmetic that the interpreter knows: what chips without fast kernels run
on, and a reference for those that have some.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Layer, Program
from spikedeploy.runtime.emulator.interpreter import Interpreter, LayerTrace
from spikedeploy.runtime.emulator.ledger import count
from spikedeploy.runtime.emulator.ledger_builder import LedgerBuilder
from spikedeploy.runtime.families.cuba_numpy.pipeline import Recording, Schedule


class InterpretedPipeline:
    """A program's layers in memory, ready to run windows of T timesteps for a batch of B.

    States go on from window to window until `reset`.

    streaming: whether a window is one timestep of the chip, with the chip's own delays.
    """

    def __init__(
        self, program: Program, schedule: Schedule, batch: int, *, streaming: bool
    ) -> None:
        self.schedule = schedule
        self._program = _unstaggered(program) if streaming else program
        self._starts = {layer.name: layer.start for layer in program.layers} if streaming else {}
        self._batch = batch
        self._lag = program.readout.lag if program.readout else 0
        self._waiting: set[str] = set()
        self._traces: dict[str, LayerTrace] = {}
        self.reset()

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._interpreter = Interpreter(self._program, self._batch)
        size = self._program.layer(self._program.output).size
        self._tail = np.zeros((self._lag, self._batch, size), np.uint8)

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[np.uint8]:
        """Spikes (T, B, N) that the readout hears, given those of the input (T, B, M).

        step: chip timestep of a single row; layers that start later only wait.
        """
        self._waiting = {
            n for n, start in self._starts.items() if step is not None and step < start
        }
        self._raster = rows.swapaxes(0, 1).astype(np.uint8)
        self._traces = self._interpreter.run(self._raster, self._waiting)
        output_spikes = self._traces[self._program.output].spikes.swapaxes(0, 1)
        rows = np.concatenate([self._tail, output_spikes])
        self._tail = rows[len(output_spikes) :]
        return rows[: len(output_spikes)]

    def report(self, recorder: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        traces, timesteps = self._traces, self.schedule.timesteps
        counts = count(
            _without_biases(self._program, self._waiting),
            {self._program.input: self._raster, **{n: t.spikes for n, t in traces.items()}},
            {name: trace.active for name, trace in traces.items()},
            {name: trace.overflows for name, trace in traces.items()},
        )
        recorder.add(counts, timesteps, self._program.steps(timesteps))

    def resume(self, other: "InterpretedPipeline") -> None:
        """Go on where another stands, whose windows have another length."""
        self._interpreter, self._tail = other._interpreter, other._tail

    def now(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (B, N) of each layer; the current (B, K, N) where it has K."""
        states = self._interpreter.states
        return {name: (state.current, state.membrane) for name, state in states.items()}

    def recordings(self) -> dict[str, Recording]:
        """What each layer did in the last window."""
        return {n: Recording(t.current, t.membrane, t.spikes) for n, t in self._traces.items()}


def _unstaggered(program: Program) -> Program:
    """The program with all layers starting at once, so that lags are the delays of the chip."""
    return replace(program, layers=tuple(replace(layer, start=0) for layer in program.layers))


def _without_biases(program: Program, names: Iterable[str]) -> Program:
    """The program with silent bias axons for the layers of these names."""
    if not (waiting := set(names)):
        return program
    layers = (_unbiased(layer) if layer.name in waiting else layer for layer in program.layers)
    return replace(program, layers=tuple(layers))


def _unbiased(layer: Layer) -> Layer:
    return replace(layer, bias=0 * layer.bias)
