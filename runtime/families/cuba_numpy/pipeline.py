"""The pipeline: every layer's window, one after another, with the spikes that go between them.

The relay: spikes that were emitted in earlier timesteps and are still on their way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Layer, Program
from spikedeploy.runtime.emulator.ledger_builder import (
    EventCounter,
    LedgerBuilder,
    Ran,
    WindowStats,
)
from spikedeploy.runtime.emulator.raster import Raster, Scratch
from spikedeploy.runtime.families.cuba_numpy.layer_kernel import LayerKernel
from spikedeploy.runtime.families.cuba_numpy.wave import Wave, suits

Rows = NDArray[np.uint8]


class DelayBuffer:
    """Delivers the rows of each source late.

    sizes: neurons of each source.
    memory: longest lateness, in rows.
    """

    def __init__(self, sizes: dict[str, int], memory: int, batch: int) -> None:
        self._memory = memory
        self._tails = {name: np.zeros((memory, batch, n), np.uint8) for name, n in sizes.items()}

    def reset(self) -> None:
        """Nothing is on its way."""
        if self._memory:
            for tail in self._tails.values():
                tail.fill(0)

    def presynaptic(
        self, source: str, late: int, output_spikes: dict[str, Raster], timesteps: int
    ) -> Raster:
        """The T rows that arrive in this window when they are so late."""
        if late == 0:
            return output_spikes[source]
        first = self._memory - late
        rows = self._tails[source][first : first + timesteps]
        if late < timesteps:
            rows = np.concatenate([rows, output_spikes[source].rows[: timesteps - late]])
        return Raster(rows)

    def keep(self, output_spikes: dict[str, Raster]) -> None:
        """Remember the last rows of a window."""
        if self._memory:
            for name, raster in output_spikes.items():
                rows = np.concatenate([self._tails[name], raster.rows])
                self._tails[name] = rows[-self._memory :]


@dataclass(frozen=True, eq=False)
class Recording:
    """What a layer did in a window; integers on integer chips.

    current: (B, T, N) after each timestep [state units].
    membrane: (B, T, N) after each timestep, resets included [state units].
    spikes: (B, T, N).
    """

    current: NDArray[Any]
    membrane: NDArray[Any]
    spikes: NDArray[np.uint8]


@dataclass(frozen=True)
class Schedule:
    """What a pipeline is prepared for.

    timesteps: T of a window.
    late: rows by which each synapse of each layer delivers late.
    kept: whether states go on from window to window.
    steps: chip timesteps that a window stands for.
    """

    timesteps: int
    late: tuple[tuple[int, ...], ...]
    kept: bool
    steps: int


class Pipeline:
    """A program's layers in memory, ready to run windows of T timesteps for a batch of B."""

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        self.program, self.schedule = program, schedule
        self._wave: Wave | None = None
        if not schedule.kept and suits(program, schedule.timesteps, batch):
            self._wave = Wave(program, schedule.timesteps)
        self._windows = [] if self._wave else _windows(program, schedule, batch)
        self.windows: Sequence[Ran] = self._wave.windows if self._wave else self._windows
        self.tally = EventCounter(program, self.windows, schedule.steps)
        self._emitted: dict[str, Raster] = {}
        self._lag = program.readout.lag if program.readout else 0
        # layer, its window, and what it hears how many rows late
        self._route = [
            (window.layer, window, list(zip(_sources(window.layer), late, strict=True)))
            for window, late in zip(self._windows, schedule.late, strict=False)
        ]
        memory = max(self._lag, *(max(late) for late in schedule.late))
        self._relay = DelayBuffer(program.sizes, memory, batch)

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._relay.reset()
        if self.schedule.kept:
            for window in self._windows:
                window.reset()

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, B, N) that the readout hears, given those of the input (T, B, M).

        step: chip timestep of a single row; layers that start later only wait.
        """
        output_spikes = {self.program.input: Raster(rows)}
        timesteps = self.schedule.timesteps
        if self._wave is not None:
            self._wave.run(rows)
            output_spikes |= {window.layer.name: Raster(window.spikes) for window in self.windows}
            self._emitted = output_spikes
            return self.windows[-1].spikes
        for layer, window, wires in self._route:
            if step is not None and step < layer.start:
                output_spikes[layer.name] = window.wait()
                continue
            # nothing is on its way where nothing is late, as in most networks
            presynaptic = [
                self._relay.presynaptic(source, late, output_spikes, timesteps)
                if late
                else output_spikes[source]
                for source, late in wires
            ]
            output_spikes[layer.name] = window.run(presynaptic)
        self._emitted = output_spikes
        spikes = self._relay.presynaptic(self.program.output, self._lag, output_spikes, timesteps)
        self._relay.keep(output_spikes)
        return spikes.rows

    def observe(self) -> WindowStats:
        """What the ledger needs of the last window."""
        return self.tally.observe(self._emitted)

    def report(self, recorder: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        recorder.observe(self.tally, self.observe())

    def now(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (B, N) of each layer."""
        return {
            name: (recording.current[:, -1], recording.membrane[:, -1])
            for name, recording in self.recordings().items()
        }

    def recordings(self) -> dict[str, Recording]:
        """What each layer did in the last window."""
        dtype = np.int64 if self.program.chip.fixed else np.float64
        recordings = {}
        for window in self.windows:
            # (T + 1, 2, B, N) to (2, B, T, N)
            current, membrane = window.states[1:].transpose(1, 2, 0, 3).astype(dtype)
            spikes = window.spikes.swapaxes(0, 1).astype(np.uint8)
            recordings[window.layer.name] = Recording(current, membrane, spikes)
        return recordings


def _windows(program: Program, schedule: Schedule, batch: int) -> list[LayerKernel]:
    """A window for each layer; they share the memory that is needed only for a moment."""
    largest = max(s.weight.size for layer in program.layers for s in layer.synapses)
    scratch = Scratch(largest * np.dtype(np.float64).itemsize)
    return [
        LayerKernel(program, layer, schedule.timesteps, batch, schedule.kept, scratch)
        for layer in program.layers
    ]


def _sources(layer: Layer) -> list[str]:
    return [synapses.source for synapses in layer.synapses]


def joined(parts: list[dict[str, Recording]]) -> dict[str, Recording]:
    """Recordings of consecutive windows as one."""
    names = parts[0] if parts else {}
    return {
        name: Recording(
            current=np.concatenate([part[name].current for part in parts], axis=1),
            membrane=np.concatenate([part[name].membrane for part in parts], axis=1),
            spikes=np.concatenate([part[name].spikes for part in parts], axis=1),
        )
        for name in names
    }
