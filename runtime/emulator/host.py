"""What the host makes of what leaves a chip, where that is not the spikes of one layer alone.

Membranes of readout layers become floats again. Readout layers that the chip has no way out for are
integrated here, in float64, from the spikes of their sources, which leave the chip, and those of
the input, which the host has. Outlets add up spikes and membranes.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Backend

Floats = NDArray[np.float64]


class Host:
    """The host of a program with readout layers; its states are those of a batch of B.

    program: whose output it computes.
    """

    def __init__(self, program: Program, batch: int) -> None:
        self._program, self._batch = program, batch
        self._terms = _terms(program)
        self._rest = np.zeros(max(place.stop for _, _, _, place in self._terms)) + _bias(program)
        sources = {s.source for layer in program.host for s in layer.synapses}
        self._hears_input = program.input in sources | {name for name, _, _, _ in self._terms}
        self._sizes = program.sizes | {layer.name: layer.size for layer in program.host}
        # made once: where windows do not keep states, each begins with a reset
        self._delays = {
            streaming: _Delays(program, streaming=streaming) for streaming in (False, True)
        }
        self.reset(streaming=False)

    def reset(self, streaming: bool) -> None:
        """Forget every current and membrane, and all rows that are still late.

        streaming: whether single timesteps of the chip come, in which later layers are behind, and
            not windows, in which rows of one number mean the same.
        """
        delays = self._delays[streaming]
        self._integrators = [
            _Integrator(layer, self._batch, delays) for layer in self._program.host
        ]
        self._late = [
            _Late(delays.of(name, lag), self._batch, self._sizes[name])
            for name, _, lag, _ in self._terms
        ]

    def output(self, raster: NDArray[Any], backend: Backend) -> Floats:
        """Output (B, T, act) of the last window, whose input was the raster (T, B, M).

        Of layers that run free, the T timesteps of their windows are heard.
        """
        rows = self._rows(raster, backend)
        for integrator in self._integrators:
            rows[integrator.layer.name] = integrator.run(rows)
        output = np.empty((*raster.shape[:2], len(self._rest)))
        output[...] = self._rest
        for (name, weight, _, place), late in zip(self._terms, self._late, strict=True):
            arriving, total = late.through(rows[name]), output[..., place]
            np.add(total, arriving if weight is None else arriving @ weight, out=total)
        return np.asarray(output.swapaxes(0, 1))

    def _rows(self, raster: NDArray[Any], backend: Backend) -> dict[str, Floats]:
        """(T, B, N) of the input, where it is heard, and of all that leaves the chip."""
        program = self._program
        rows = {program.input: raster.astype(np.float64)} if self._hears_input else {}
        single = backend.schedule.mode == "step"
        for name in program.to_host:
            layer = program.layer(name)
            ran = backend.spikes(name) if layer.spiking else backend.membranes(name) * layer.scale
            heard = ran if single else ran[program.window(layer, len(ran))]
            rows[name] = heard.astype(np.float64, copy=False)
        return rows


# name, weight (N, act) or None, lag, and the elements of the output that it adds to
_Term = tuple[str, Floats | None, int, slice]


def _terms(program: Program) -> list[_Term]:
    """All that adds to the output."""
    if not program.outlets:
        readout, size = program.readout, program.layer(program.output).size
        if readout is None:
            return [(program.output, None, 0, slice(0, size))]
        return [(program.output, readout.weight, readout.lag, slice(0, len(readout.bias)))]
    terms: list[_Term] = []
    first = 0
    for outlet in program.outlets:
        place = slice(first, first + outlet.port.size)
        terms += [(tap.layer, tap.weight, tap.lag, place) for tap in outlet.taps]
        first = place.stop
    return terms


def _bias(program: Program) -> Floats:
    """What the output begins with, (act,) or one for all."""
    if program.outlets:
        return np.concatenate([outlet.bias for outlet in program.outlets])
    return np.zeros(1) if program.readout is None else program.readout.bias


class _Delays:
    """Rows by which the host holds back what it receives.

    In windows that is the lag of the graph. In single timesteps of the chip also what a layer is
    ahead of the last that leaves the chip.

    latest: [timesteps] when that one starts; 0 in windows.
    """

    def __init__(self, program: Program, *, streaming: bool) -> None:
        here = {layer.name: layer.start for layer in program.layers} if streaming else {}
        self._starts = {name: here.get(name, 0) for name in (program.input, *program.sizes)}
        self.latest = max(self._starts[name] for name in (program.input, *program.to_host))

    def of(self, name: str, lag: int) -> int:
        """Of an input or layer; what the host has integrated is as late as the last."""
        return self.latest - self._starts.get(name, self.latest) + lag


class _Late:
    """Rows that arrive some timesteps late."""

    def __init__(self, delay: int, batch: int, size: int) -> None:
        self._tail = np.zeros((delay, batch, size))

    def through(self, rows: Floats) -> Floats:
        """The rows (T, B, N) that arrive now."""
        if not len(self._tail):
            return rows
        all_ = np.concatenate([self._tail, rows])
        self._tail = all_[len(rows) :]
        return all_[: len(rows)]


class _Integrator:
    """A readout layer in float64, as the float twin computes it."""

    def __init__(self, layer: Layer, batch: int, delays: _Delays) -> None:
        self.layer = layer
        self._late = [
            _Late(delays.of(s.source, s.delay), batch, len(s.weight)) for s in layer.synapses
        ]
        self._current = self._membrane = np.zeros((batch, layer.size))
        # as a layer of the chip, it begins when what is late arrives
        self._waits = delays.latest

    def run(self, rows: dict[str, Floats]) -> Floats:
        """Membranes (T, B, N) after each timestep."""
        layer = self.layer
        arrived = [
            late.through(rows[synapses.source]) @ synapses.weight
            for synapses, late in zip(layer.synapses, self._late, strict=True)
        ]
        drive: Floats = sum(arrived, layer.bias)
        membranes = np.zeros_like(drive)
        if self._waits:
            self._waits -= 1
            return membranes
        for t, arriving in enumerate(drive):
            # I = a I + W s      V = b V + I + bias
            self._current = layer.current_decay * self._current + arriving
            self._membrane = (
                layer.membrane_decay * self._membrane + self._current + layer.voltage_bias
            )
            membranes[t] = self._membrane
        return membranes
