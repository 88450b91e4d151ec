"""The pipeline: every layer's window, one after another, with the spikes that go between them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.kernels import Window
from runtime.program import Layer, Program
from runtime.raster import Raster
from runtime.recorder import Recorder
from runtime.relay import Relay
from runtime.scratch import Scratch
from runtime.tally import Observation, Ran, Tally
from runtime.wave import Wave, suits


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
        self.tally = Tally(program, self.windows, schedule.steps)
        self._emitted: dict[str, Raster] = {}
        self._lag = program.readout.lag if program.readout else 0
        # layer, its window, and what it hears how many rows late
        self._route = [
            (window.layer, window, list(zip(_sources(window.layer), late, strict=True)))
            for window, late in zip(self._windows, schedule.late, strict=False)
        ]
        memory = max(self._lag, *(max(late) for late in schedule.late))
        self._relay = Relay(program.sizes, memory, batch)

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
        emitted = {self.program.input: Raster(rows)}
        timesteps = self.schedule.timesteps
        if self._wave is not None:
            self._wave.run(rows)
            emitted |= {window.layer.name: Raster(window.spikes) for window in self.windows}
            self._emitted = emitted
            return self.windows[-1].spikes
        for layer, window, wires in self._route:
            if step is not None and step < layer.start:
                emitted[layer.name] = window.wait()
                continue
            # nothing is on its way where nothing is late, as in most networks
            heard = [
                self._relay.heard(source, late, emitted, timesteps) if late else emitted[source]
                for source, late in wires
            ]
            emitted[layer.name] = window.run(heard)
        self._emitted = emitted
        spikes = self._relay.heard(self.program.output, self._lag, emitted, timesteps)
        self._relay.keep(emitted)
        return spikes.rows

    def observe(self) -> Observation:
        """What the ledger needs of the last window."""
        return self.tally.observe(self._emitted)

    def report(self, recorder: Recorder) -> None:
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


def _windows(program: Program, schedule: Schedule, batch: int) -> list[Window]:
    """A window for each layer; they share the memory that is needed only for a moment."""
    largest = max(s.weight.size for layer in program.layers for s in layer.synapses)
    scratch = Scratch(largest * np.dtype(np.float64).itemsize)
    return [
        Window(program, layer, schedule.timesteps, batch, schedule.kept, scratch)
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
