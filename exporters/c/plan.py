"""Plan of a program for hardware and C: its integers by layer, types, magnitudes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.bounds import Magnitudes, bound
from spikedeploy.exporters.c.declarations import as_lists, bytes_of, narrowest, narrowest_of
from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.compiler.program import OutputTerm, Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire

Integers = NDArray[np.int64]

# a row with gaps is kept whole where that takes no more than so many times the bytes
_WHOLE = 1.4
# and where at least this part of it is not 0: a synapse of a list takes more instructions
_DENSE = 0.5
# synapses of a projection that are written as statements, which take half the instructions of lists
# and twice the memory
_STATEMENTS = 2048


@dataclass(frozen=True)
class SpikeMemory:
    """Memory of the spikes of the input or of a layer.

    name: of the source in C.
    capacity: channels or neurons that can spike in one timestep.
    times_max: spikes of a neuron in a timestep.
    slots: timesteps that are kept: as late as they are read, and the present.
    """

    name: str
    capacity: int
    times_max: int
    slots: int

    @property
    def several(self) -> bool:
        """True if a neuron can spike several times in a timestep."""
        return self.times_max > 1

    @property
    def count_kind(self) -> str:
        """The C type of the number of channels or neurons that spike."""
        return narrowest(0, self.capacity)

    def slot(self, lag: int = 0) -> str:
        """C for the index of the spikes some timesteps ago."""
        if self.slots == 1:
            return "0"
        head = f"{self.name}_head"
        return f"({head} + {self.slots - lag}u) % {self.slots}u" if lag else head


@dataclass(frozen=True, eq=False)
class SynapsePlan:
    """Synapses between two layers.

    name: of the function in C that adds the weights of a spike.
    weight: (M, N), or of a window its kernel, divided by the unit of the layer.
    spikes: of the source.
    lag: timesteps by which they arrive late.
    window: of a convolution; None where weights are a matrix.
    """

    name: str
    weight: Integers
    spikes: SpikeMemory
    lag: int
    window: Window | None

    @property
    def slot(self) -> str:
        """C for the index of the spikes that arrive."""
        return self.spikes.slot(self.lag)

    @property
    def stored(self) -> str:
        """The C type of a weight."""
        return narrowest_of(self.weight)

    @cached_property
    def layout(self) -> str:
        """The storage of weights: "kernel", whole "rows", "lists", "statements", or "nothing"."""
        if self.window is not None:
            return "kernel"
        axons, neurons = self.weight.shape
        synapses, each = int(np.count_nonzero(self.weight)), bytes_of(self.stored)
        lists = synapses * (each + bytes_of("uint8_t" if neurons <= 256 else "uint16_t"))
        lists += (axons + 1) * (2 if synapses < 2**16 else 4)
        dense = synapses >= _DENSE * axons * neurons
        if dense and axons * neurons * each <= _WHOLE * lists:
            return "rows"
        if not synapses:
            return "nothing"
        return "statements" if synapses <= _STATEMENTS and not self.spikes.several else "lists"

    @property
    def lists(self) -> tuple[Integers, Integers, Integers]:
        """First synapse of each axon (M + 1,); neuron and weight of each synapse."""
        return as_lists(self.weight)


def diagonal_of(weight: NDArray[Any]) -> NDArray[Any] | None:
    """The diagonal of a matrix that has nothing else; else None."""
    square = weight.shape[0] == weight.shape[1]
    plain = square and not (weight - np.diag(np.diag(weight))).any()
    return np.diag(weight) if plain else None


@dataclass(frozen=True, eq=False)
class LayerPlan:
    """The integers of a layer.

    name: in C.
    layer: thresholds, decays and leaks.
    unit: by which its sums are multiplied: the largest power of two that divides all weights.
    bias: (N,) of the sums, divided by it.
    inputs: its synapses.
    spikes: that it sends; None of a layer that is read by its membranes.
    states: of each neuron, name -> type in C; "" is that of the chip's integers.
    held: registers that numbers can exceed.
    """

    name: str
    layer: Layer
    unit: int
    bias: Integers
    inputs: Sequence[SynapsePlan]
    spikes: SpikeMemory | None
    states: Mapping[str, str]
    held: frozenset[str]

    @property
    def size(self) -> int:
        """Neurons."""
        return self.layer.size


@dataclass(frozen=True, eq=False)
class Tap:
    """Part of a layer that the host adds to the scores.

    layer: its name in the program; index: its number.
    silent: whether membranes count, of a layer without a threshold, and not spikes.
    lag: timesteps by which the value is late.
    times_max: spikes of a neuron in a timestep.
    first: score that the first of the weights belongs to.
    weight: (N, scores of the output).
    """

    layer: str
    index: int
    silent: bool
    lag: int
    times_max: int
    first: int
    weight: NDArray[np.float64]

    @property
    def size(self) -> int:
        """Neurons."""
        return len(self.weight)

    @property
    def diagonal(self) -> NDArray[np.float64] | None:
        """(N,) weights where each neuron has a score of its own; else None."""
        return diagonal_of(self.weight)

    @property
    def lists(self) -> tuple[Integers, Integers, NDArray[Any]]:
        """First score of each neuron (N + 1,); score and weight of each entry."""
        return as_lists(self.weight)


@dataclass(frozen=True, eq=False)
class Plan:
    """A program and its codec, with the answers that templates need.

    codec: None where the chip's part alone is written.
    """

    program: Program
    codec: Codec | None

    @property
    def rules(self) -> CubaFixedPoint | IntegrateAndFire:
        """The arithmetic of the chip."""
        arithmetic = self.program.chip.arithmetic
        if not isinstance(arithmetic, CubaFixedPoint | IntegrateAndFire):
            raise TypeError(type(arithmetic).__name__)
        return arithmetic

    @property
    def family(self) -> str:
        """The template of the neurons: "cuba" or "integrate"."""
        return "cuba" if isinstance(self.rules, CubaFixedPoint) else "integrate"

    @cached_property
    def names(self) -> dict[str, str]:
        """The name in C of the input and of each layer."""
        layers = {layer.name: f"l{k}" for k, layer in enumerate(self.program.layers)}
        return {self.program.input: "in", **layers}

    @cached_property
    def times_max(self) -> dict[str, int]:
        """Spikes of a neuron in a timestep, of the input and each layer."""
        chip = self.program.chip
        layers = dict.fromkeys((layer.name for layer in self.program.layers), chip.spikes_max)
        return {self.program.input: chip.input_spikes_max if not self.codec else 1, **layers}

    @property
    def events_max(self) -> int:
        """Input channels that can spike in one timestep."""
        encoder = self.codec.encoder if self.codec else None
        if isinstance(encoder, DeltaEncoder):
            return (encoder.most if encoder.code == "unary" else 1) * encoder.observed
        return self.program.width

    @cached_property
    def slots(self) -> dict[str, int]:
        """Timesteps of which the spikes are kept: as late as they are read, and the present."""
        latest = dict.fromkeys(self.names, 0)
        for layer, lags in zip(self.program.layers, self.program.lags, strict=True):
            for synapses, lag in zip(layer.synapses, lags, strict=True):
                latest[synapses.source] = max(latest[synapses.source], lag)
        for term in filter(self.is_spiking, self.program.output_terms):
            latest[term.layer] = max(latest[term.layer], term.lag)
        return {name: lag + 1 for name, lag in latest.items()}

    @cached_property
    def spikes(self) -> dict[str, SpikeMemory]:
        """Spikes of the input and of each layer that has any, by name in the program."""
        return {
            source: SpikeMemory(
                name,
                self.events_max if source == self.program.input else self.program.sizes[source],
                self.times_max[source],
                self.slots[source],
            )
            for source, name in self.names.items()
            if source == self.program.input or self.program.layer(source).spiking
        }

    @property
    def input(self) -> SpikeMemory:
        """Spikes of the input."""
        return self.spikes[self.program.input]

    @cached_property
    def layers(self) -> list[LayerPlan]:
        """The integers of the layers, in the order in which they are computed."""
        return list(map(self._plan_layer, self.program.layers, self.program.lags))

    def _plan_layer(self, layer: Layer, lags: Sequence[int]) -> LayerPlan:
        name, bias = self.names[layer.name], layer.bias.astype(np.int64)
        if isinstance(self.rules, CubaFixedPoint):
            waits = layer.spiking and self.rules.refractory > 1
            states = {
                "current": "",
                "membrane": "",
                **({"refractory": "uint32_t"} if waits else {}),
            }
            reached = self.magnitudes[layer.name].registers
            held = frozenset(
                each for each, most in reached.items() if _changes(getattr(self.rules, each), most)
            )
        else:
            bias = bias + layer.voltage_bias.astype(np.int64)
            states = {"membrane": "", **({"spikes": "uint8_t"} if layer.spiking else {})}
            held = frozenset(["membrane"] if _changes(self.rules.membrane, None) else [])
        units = (*(each.weight.ravel() for each in layer.synapses), bias)
        merged = int(np.bitwise_or.reduce(np.abs(np.concatenate(units).astype(np.int64))))
        unit = (merged & -merged) or 1
        inputs = [
            SynapsePlan(
                f"{name}_row{k}", each.weight // unit, self.spikes[each.source], lag, each.window
            )
            for k, (each, lag) in enumerate(zip(layer.synapses, lags, strict=True))
        ]
        spikes = self.spikes.get(layer.name)
        return LayerPlan(name, layer, unit, bias // unit, inputs, spikes, states, held)

    @cached_property
    def bias(self) -> NDArray[np.float64]:
        """(scores,) bias of the output in every timestep."""
        return np.concatenate([node.bias for node in self.program.output_nodes])

    @cached_property
    def taps(self) -> list["Tap"]:
        """Parts of layers that the host adds up to scores."""
        found, first = [], 0
        for node in self.program.output_nodes:
            found += [self._plan_tap(term, first) for term in node.terms]
            first += len(node.bias)
        return found

    def _plan_tap(self, term: OutputTerm, first: int) -> "Tap":
        layers = [layer.name for layer in self.program.layers]
        if term.layer not in layers:
            raise ConfigError(
                f"--to c: the output receives {term.layer!r}, which is no layer of the chip."
            )
        size, silent = self.program.sizes[term.layer], not self.is_spiking(term)
        weight = np.eye(size) if term.weight is None else term.weight
        if silent:
            scale = np.broadcast_to(self.program.layer(term.layer).scale, (size,))
            weight = np.asarray(scale[:, None] * weight)
        index = layers.index(term.layer)
        return Tap(term.layer, index, silent, term.lag, self.times_max[term.layer], first, weight)

    def is_spiking(self, term: OutputTerm) -> bool:
        """True where the host receives spikes of a layer, and not its membranes."""
        return term.layer == self.program.input or self.program.layer(term.layer).spiking

    @cached_property
    def kind(self) -> str:
        """The C type of all states and sums."""
        return max((each.kind for each in self.magnitudes.values()), key=bytes_of)

    @property
    def id_kind(self) -> str:
        """The C type of the number of a channel or neuron."""
        return narrowest(0, max(self.program.sizes.values()) - 1)

    @property
    def largest(self) -> int:
        """Largest magnitude of a state of any layer [state units]."""
        return max(each.states for each in self.magnitudes.values())

    @cached_property
    def magnitudes(self) -> dict[str, Magnitudes]:
        """Largest magnitudes of each layer, by its name in the program."""
        reset = self.program.convention.state == "reset"
        window = self.codec.timesteps if self.codec and reset else None
        return {
            layer.name: bound(layer, self.rules, self.times_max, window)
            for layer in self.program.layers
        }

    @property
    def held(self) -> frozenset[str]:
        """Registers that numbers of some layer can exceed."""
        return frozenset().union(*(layer.held for layer in self.layers))

    @property
    def decays(self) -> list[Integers]:
        """Decay factors (N,) of which some are a part of a state, and not all or nothing."""
        factors = ((a.current_decay, a.membrane_decay) for a in self.program.layers)
        return [factor for both in factors for factor in both if self.is_decay(factor)]

    def is_decay(self, factor: Integers) -> bool:
        """True if some neuron keeps a part of a state, and not all or nothing."""
        one = self.rules.decay_one if isinstance(self.rules, CubaFixedPoint) else None
        return bool(factor.any() and (factor != one).any())

    def floor(self, layer: Layer) -> Integers | None:
        """Below what membranes (N,) cannot fall; None where there is no floor."""
        rules, wanted = self.rules, self.program.convention.floor
        floors = []
        if isinstance(rules, IntegrateAndFire) and rules.floor is not None:
            floors.append(np.full(layer.size, rules.floor))
        if wanted in ("zero", "threshold"):
            floors.append(-layer.threshold * (wanted == "threshold"))
        return np.max(floors, axis=0) if floors else None


def _changes(register: Register, most: int | None) -> bool:
    """Return True if a register changes some number of at most this magnitude."""
    if register.between is not None:
        return True
    below = most is not None and most < 1 << (register.bits - 1)
    return register.overflow != "none" and not below
