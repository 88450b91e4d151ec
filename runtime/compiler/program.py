"""The program: a network as one chip runs it; compiled, frozen, and all that a Machine needs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.damage import Damage, Upsets
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.convention import Clock, Convention
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.graph.ports import Port, concatenate

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OutputTerm:
    """Contribution of one layer to an Output node.

    layer: name; of a readout layer its membranes [float units] arrive, and not spikes.
    weight: (N, act) axon-major; None passes the spikes on as they are.
    lag: [timesteps] by which it trails the spikes.
    """

    layer: str
    weight: Floats | None
    lag: int


@dataclass(frozen=True, eq=False)
class Output:
    """One Output node.

    port: its name and shape.
    terms: what it receives.
    bias: (act,) added in every timestep.
    """

    port: Port
    terms: tuple[OutputTerm, ...]
    bias: Floats


def _counted(timesteps: int) -> str:
    return f"{timesteps} chip timestep{'s' * (timesteps != 1)}"


@dataclass(frozen=True, eq=False)
class Readout:
    """The last affine map, which the host computes in float64.

    weight: (N, act) axon-major.
    bias: (act,).
    lag: rows by which its output trails the spikes; the delay of the convention.
    """

    weight: NDArray[np.float64]
    bias: NDArray[np.float64]
    lag: int

    def __call__(self, spikes: NDArray[Any]) -> NDArray[np.float64]:
        """Output (..., act) of the spikes (..., N)."""
        # BLAS takes two axes; dot() has less overhead than @
        flat = spikes.reshape(-1, len(self.weight)).dot(self.weight) + self.bias
        return np.asarray(flat.reshape(*spikes.shape[:-1], -1))


@dataclass(frozen=True, eq=False)
class Program:
    """Everything that a Machine runs.

    Time is counted in chip timesteps from the first input row. Row t of the input reaches a layer
    `start` timesteps later.

    Where the clock is gated, a layer runs T timesteps from its start, its window, and is held in
    all others, so that row t of every window means the same as without delays. Pipelined, all
    starts are 0, and windows are the same T timesteps of the chip. Free, every layer runs in all
    timesteps from the first row until the last layer has seen the last; its window are the T from
    its start, in which its bias axon spikes and the host reads it.

    chip: the one that it runs on.
    convention: of the artifact; reset and state are read from it.
    input: name of the input.
    width: M of the input.
    layers: in an order in which each comes after its sources without a delay.
    output: name of the layer that the readout or the host receives spikes from.
    readout: None where the spikes themselves are the output.
    remarks: what of it is not as in the artifact, besides rounding and its convention; sentences.
    inputs: the Input nodes side by side in the input; empty where there was no graph.
    outputs: the Output nodes side by side in the output; likewise.
    host_outputs: what the host makes of the spikes where several layers leave the chip; then they
        stand for output and readout.
    host: readout layers that the host integrates in float64, because the chip has no way out for
        membranes; their delays are lags of the graph. `host_outputs` say what becomes of them.
    damage: what faults of the chip have hit; the layers have them (runtime.faults).
    upsets: what goes wrong while it runs; None where nothing does.
    outliers: those of the remarks that are on layers which one large number makes coarse
        (runtime.compiler.outliers).
    clock: how the layers advance.
    """

    chip: Chip
    convention: Convention
    input: str
    width: int
    layers: tuple[Layer, ...]
    output: str
    readout: Readout | None
    remarks: tuple[str, ...] = ()
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    host_outputs: tuple[Output, ...] = ()
    host: tuple[Layer, ...] = ()
    damage: tuple[Damage, ...] = ()
    upsets: Upsets | None = None
    clock: Clock = "gated"
    outliers: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        presynaptic = {self.input}
        for layer in self.layers:
            for synapses in layer.synapses:
                self._check(layer, synapses, presynaptic)
            presynaptic.add(layer.name)

    def dense(self, needed_by: str = "the list of them") -> "Program":
        """Return the program with a matrix for each window; RuleError where one is too large."""

        def dense(layers: tuple[Layer, ...]) -> tuple[Layer, ...]:
            return tuple(
                replace(a, synapses=tuple(s.dense(needed_by) for s in a.synapses)) for a in layers
            )

        return replace(self, layers=dense(self.layers), host=dense(self.host))

    def joined(self, rasters: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """The input (B, T, M), from the raster (B, T, *shape) of each Input node."""
        return concatenate(self.inputs, rasters)

    @property
    def chip_name(self) -> str:
        """Name of the chip that it runs on."""
        return self.chip.name

    def layer(self, name: str) -> Layer:
        """The layer called `name`."""
        return self._by_name[name]

    def lag(self, layer: Layer, synapses: Synapses) -> int:
        """Rows by which what the layer runs trails its spikes: 0 where starts make up delays."""
        source = 0 if synapses.source == self.input else self.begin(self.layer(synapses.source))
        return source + synapses.delay - self.begin(layer)

    def begin(self, layer: Layer) -> int:
        """Timestep of the first row that the layer runs in an inference."""
        return layer.start if self.clock == "gated" else 0

    def rows(self, timesteps: int) -> int:
        """Rows that each layer runs in an inference of T input rows."""
        return timesteps + (self.fill if self.clock == "free" else 0)

    def window(self, layer: Layer, rows: int) -> slice:
        """The layer's window among the rows that it runs: all of them, unless it runs free."""
        if self.clock != "free":
            return slice(0, rows)
        return slice(layer.start, layer.start + rows - self.fill)

    @cached_property
    def trailing(self) -> tuple[int, int]:
        """[timesteps] by which the output trails the input: along the shortest path, the longest.

        0 where windows make up for the delays of the chip. Of paths without loops, through
        connections with a weight that is not 0; (0, 0) where there is none.
        """
        starts = {layer.name: layer.start for layer in (*self.layers, *self.host)}
        found = {self.input: (0, 0)}
        for layer in self._from_the_input():
            paths = [
                tuple(n + starts.get(s.source, 0) + s.delay - layer.start for n in found[s.source])
                for s in layer.synapses
                if s.source in found and s.fan_out.any()
            ]
            if paths:
                found[layer.name] = (min(p[0] for p in paths), max(p[1] for p in paths))
        ends = [(found[term.layer], term.lag) for term in self.output_terms if term.layer in found]
        if not ends:
            return 0, 0
        return min(f[0] + lag for f, lag in ends), max(f[1] + lag for f, lag in ends)

    def _from_the_input(self) -> list[Layer]:
        """Layers that input reaches, each behind those before it but for what closes a loop."""
        layers = {layer.name: layer for layer in (*self.layers, *self.host)}
        onto: dict[str, list[str]] = {name: [] for name in (self.input, *layers)}
        for layer in layers.values():
            for synapses in layer.synapses:
                if synapses.fan_out.any():
                    onto[synapses.source].append(layer.name)
        done: list[str] = []
        seen, under_way = {self.input}, [(self.input, iter(onto[self.input]))]
        while under_way:
            name, targets = under_way[-1]
            if (target := next((each for each in targets if each not in seen), None)) is None:
                done.append(name)
                under_way.pop()
            else:
                seen.add(target)
                under_way.append((target, iter(onto[target])))
        return [layers[name] for name in reversed(done[:-1])]

    def control_steps_late(self, timesteps: int) -> tuple[int, int] | None:
        """Control steps of T timesteps from an observation to the actions that it reaches.

        The first that it reaches by the shortest path, and by the longest. None where states are
        reset, so that no spike outlives its control step, which then acts on its own observation.
        """
        if self.convention.state == "reset":
            return None
        first, last = self.trailing
        # what is sent in the first row arrives soonest, what is sent in the last row latest
        return first // timesteps, (timesteps - 1 + last) // timesteps

    def describe_clock(self) -> str:
        """Its clock and what that costs: `free, 2 chip timesteps more an inference`."""
        least, most = self.trailing
        said = [self.clock, *["assumed"] * self.assumed_clock]
        if self.fill:
            said.append(f"{_counted(self.fill)} more an inference")
        if most:
            reach = f"{least} to {_counted(most)}" if least < most else _counted(most)
            said.append(f"input reaches the output {reach} late")
        return ", ".join(said)

    @property
    def assumed_clock(self) -> bool:
        """True if nothing says that the chip can advance its layers so."""
        return self.clock not in self.chip.clocks

    @cached_property
    def lags(self) -> tuple[tuple[int, ...], ...]:
        """The lag of each synapse of each layer."""
        return tuple(tuple(self.lag(a, s) for s in a.synapses) for a in self.layers)

    @cached_property
    def delays(self) -> tuple[tuple[int, ...], ...]:
        """The delay of each synapse of each layer."""
        return tuple(tuple(s.delay for s in a.synapses) for a in self.layers)

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Neurons of the input and of each layer."""
        return {self.input: self.width, **{layer.name: layer.size for layer in self.layers}}

    @cached_property
    def output_layers(self) -> frozenset[str]:
        """Names of the layers with spikes or membranes that leave the chip."""
        terms = {term.layer for term in self.output_terms}
        onto_host = {synapses.source for layer in self.host for synapses in layer.synapses}
        return frozenset((terms | onto_host) & self._by_name.keys())

    @cached_property
    def reads_membranes(self) -> bool:
        """True if membranes leave the chip, or the host integrates what leaves it."""
        return bool(self.host) or any(not self.layer(name).spiking for name in self.output_layers)

    @cached_property
    def output_nodes(self) -> tuple[Output, ...]:
        """The outputs; of a single layer that leaves the chip, as one of them."""
        if self.host_outputs:
            return self.host_outputs
        readout, size = self.readout, self.layer(self.output).size
        weight, lag = (None, 0) if readout is None else (readout.weight, readout.lag)
        bias = np.zeros(size) if readout is None else readout.bias
        port = Port(self.output, (len(bias),))
        return (Output(port, (OutputTerm(self.output, weight, lag),), bias),)

    @property
    def output_terms(self) -> tuple[OutputTerm, ...]:
        """Terms of all outputs."""
        return tuple(term for node in self.output_nodes for term in node.terms)

    @property
    def spiking(self) -> tuple[Layer, ...]:
        """The layers that can spike."""
        return tuple(layer for layer in self.layers if layer.spiking)

    @cached_property
    def graded(self) -> frozenset[str]:
        """Names of the layers of sigma-delta neurons, whose spikes are signed numbers."""
        return frozenset(layer.name for layer in self.layers if layer.graded)

    @property
    def readout_weights(self) -> tuple[tuple[str, NDArray[np.float64]], ...]:
        """The layers that the host reads through weights, and those weights (N, act)."""
        return tuple(
            (term.layer, term.weight) for term in self.output_terms if term.weight is not None
        )

    @cached_property
    def feed_forward(self) -> bool:
        """True if every layer has only the input and layers before it for sources."""
        presynaptic = {self.input}
        for layer in self.layers:
            if any(s.source not in presynaptic for s in layer.synapses):
                return False
            presynaptic.add(layer.name)
        return True

    @cached_property
    def output_apart(self) -> bool:
        """True if the output layer has hidden layers for sources and no targets, as on Xylo."""
        connections = [(s.source, layer.name) for layer in self.layers for s in layer.synapses]
        presynaptic = {source for source, target in connections if target == self.output}
        targets = {target for source, target in connections if source == self.output}
        return self.input not in presynaptic and not targets

    def steps(self, rows: int) -> int:
        """Chip timesteps of one inference in which each layer runs so many rows."""
        return rows + (self.fill if self.clock == "gated" else 0)

    @cached_property
    def fill(self) -> int:
        """[timesteps] that an inference takes beyond its rows: until the last layer starts."""
        return max(layer.start for layer in self.layers)

    @cached_property
    def _by_name(self) -> dict[str, Layer]:
        return {layer.name: layer for layer in self.layers}

    def _check(self, layer: Layer, synapses: Synapses, presynaptic: set[str]) -> None:
        edge = f"layer {layer.name!r}: the synapses from {synapses.source!r}"
        way_out = "" if layer.spiking else " Or let the host integrate it: membrane_output=none."
        if synapses.delay > self.chip.delay_max:
            raise RuleError(
                f"rule delay: {edge} need a delay of {synapses.delay} timesteps; {self.chip.name} "
                f"has at most {self.chip.delay_max}. Shorten the delay, or the skip connection."
                f"{way_out}"
            )
        if self.lag(layer, synapses) < 0 or (
            synapses.delay == 0 and synapses.source not in presynaptic
        ):
            raise RuleError(
                f"rule delay: {edge} deliver a spike {synapses.delay} timesteps after it was "
                f"emitted, too early or too late for a layer that starts at {layer.start}. Compile "
                "with clock='pipelined', or remove the feedback."
            )
