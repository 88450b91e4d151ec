"""Layers of neurons: what a chip stores of them, what they remember, and when they start."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError

Numbers = NDArray[Any]
AnyRecording = TypeVar("AnyRecording", bound="Recording")

# threshold of neurons that never spike, in integers: no membrane comes near it
NEVER = 1 << 60
# bytes of matrices in float64 beyond which a network is a mistake: 33 million weights
MAX_BYTES = 1 << 28


@dataclass(frozen=True, eq=False)
class Synapses:
    """All connections from one source to one layer.

    source: name of a layer, or of the network's input.
    weight: (M, N) axon-major; mantissas (int16) as the chip stores them, float64 on `ideal`. Of a
        window its kernel, (O, I, ky, kx).
    delay: [timesteps] from a spike of the source to its arrival.
    shift: [bits] that the sum of the weights which arrive together loses, rounded down: a negative
        weight exponent as lava reads it. Only the interpreter computes it.
    current: which current of the neurons they feed, where neurons have several.
    window: of a convolution, the matrix that its kernel stands for; None where that is listed.
    """

    source: str
    weight: Numbers
    delay: int
    shift: int = 0
    current: int = 0
    window: Window | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Axons M and neurons N."""
        return (
            self.window.shape
            if self.window is not None
            else (len(self.weight), self.weight.shape[1])
        )

    @cached_property
    def fan_out(self) -> NDArray[np.int64]:
        """(M,) non-zero weights of each axon: what one of its spikes costs in SOPs."""
        if self.window is not None:
            return self.window.fan_out(self.weight)
        return np.asarray(np.count_nonzero(self.weight, axis=1), np.int64)

    def sums(self, spikes: Numbers, dtype: DTypeLike = np.float64) -> Numbers:
        """Sums (..., N) of the weights that spikes (..., M) bring, in floats.

        Of whole numbers exact, up to 2**53 in float64: BLAS knows no integers. 32-bit weights reach
        that with 2**22 spikes in a timestep, 8-bit ones of graded spikes with 2**22 inputs.
        """
        if self.window is not None:
            return self.window.sums(self.weight, spikes, dtype)
        if self.weight.dtype.kind == "f":
            return np.asarray(spikes.astype(dtype) @ self.weight.astype(dtype))
        axons = np.flatnonzero(spikes.any(axis=tuple(range(spikes.ndim - 1))))
        return np.asarray(spikes[..., axons].astype(dtype) @ self.weight[axons].astype(dtype))

    def row(self, axon: int) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Mask (N,) of the neurons that an axon reaches, weights of 0 included, and weights (N,).

        A matrix reaches all.
        """
        if not self.window:
            weights = self.weight[axon].astype(np.int64)
            return np.ones(weights.shape, np.bool_), weights
        places, values = self.window.row(self.weight, axon)
        reached, weights = np.zeros(self.shape[1], np.bool_), np.zeros(self.shape[1], np.int64)
        reached[places], weights[places] = True, values
        return reached, weights

    def over_axons(self, values: Numbers, reduce: np.ufunc) -> Numbers:
        """Sum or maximum (N,) over the axons of each neuron; 0 where there is none.

        values: one, not below 0, for each weight as it is stored.
        reduce: np.add or np.maximum.
        """
        if self.window is not None:
            return self.window.over_axons(values, reduce)
        return np.asarray(reduce.reduce(values, axis=0, initial=0))

    def by_weight(self, values: Numbers | float) -> Numbers:
        """Numbers (N,) of the neurons, or one of all, that broadcast with the weights.

        Of a window those of its channels; RuleError where neurons of a channel differ.
        """
        values = np.asarray(values)
        if self.window is None or not values.ndim:
            return values
        if (each := self.window.of_channels(values)) is None:
            raise RuleError(
                f"rule kernel: the synapses from {self.source!r}: neurons that share a kernel have "
                "numbers of their own. Give those of a channel the same, or run in float."
            )
        return each

    def scaled(self, factors: Numbers) -> "Synapses":
        """Weights times factors (N,) of the neurons; a matrix where those of a channel differ."""
        if self.window is not None and self.window.of_channels(factors) is None:
            return self.dense().scaled(factors)
        return replace(self, weight=self.weight * self.by_weight(factors))

    def dense(self, needed_by: str = "the list of them") -> "Synapses":
        """Return the synapses as a matrix; RuleError, with what needs it, where it is too large."""
        if self.window is None:
            return self
        check_matrix(self.source, self.shape, needed_by)
        return replace(self, weight=self.window.dense(self.weight), window=None)


def check_matrix(source: str, shape: tuple[int, int], needed_by: str) -> None:
    """Refuse a matrix (M, N) of the synapses from a source that is too large."""
    if (found := 8 * math.prod(shape)) > MAX_BYTES:
        raise RuleError(
            f"rule matrix: the synapses from {source!r}: {needed_by} needs them as a matrix, which "
            f"takes {found} bytes; at most {MAX_BYTES}. Make its maps smaller, or run the network "
            "in float."
        )


@dataclass(frozen=True, eq=False)
class Layer:
    """One population of neurons; on integer chips everything but `scale` holds integers.

    name: of the NIR node.
    synapses: its presynaptic connections.
    bias: (N,) weights of an axon that spikes in every timestep.
    voltage_bias: (N,) added to the membrane in every timestep [state units].
    threshold: (N,) membrane above which a neuron spikes [state units].
    current_decay: (N,) decay factor of the current [1 / 2**decay_bits, or 1].
    membrane_decay: (N,) likewise of the membrane. Where decays are shifts, both hold the shift,
        that of K currents as (K, N); where the leak is linear, this is what it takes [state units].
    scale: float units of current and membrane per state unit; (N,) where neurons differ.
    start: [timesteps] when the layer's first timestep runs, counted from the input's first row.
    aliases: for each neuron those that its spikes are counted for too (Xylo); empty is none.
    spiking: False for a readout layer: it never spikes, and its membranes leave the chip instead.
        Its threshold is infinite, or NEVER.
    graded: whether its neurons are sigma-delta neurons (runtime.graph.discretisation): they send
        signed whole numbers of thresholds; the voltage bias is added before the rectification.
    v_reset: (N,) membrane to which a spike resets integrate-and-fire neurons [state units]; the
        compiler refuses all but 0, which some recorded runs have.
    floor: (N,) below which no membrane of integrate-and-fire neurons falls [state units]; None
        leaves it to the convention, as the compiler does.
    """

    name: str
    synapses: tuple[Synapses, ...]
    bias: Numbers
    voltage_bias: Numbers
    threshold: Numbers
    current_decay: Numbers
    membrane_decay: Numbers
    scale: float | NDArray[np.float64]
    start: int
    aliases: tuple[tuple[int, ...], ...] = ()
    spiking: bool = True
    graded: bool = False
    v_reset: Numbers | int = 0
    floor: Numbers | None = None

    @cached_property
    def size(self) -> int:
        """Neurons: N."""
        return int(self.threshold.size)

    @property
    def multiplications(self) -> int:
        """Products with decay factors that are neither 0 nor 1, of a float layer in a timestep."""
        factors = np.concatenate([self.current_decay, self.membrane_decay])
        return int(np.count_nonzero((factors != 0) & (factors != 1)))

    @cached_property
    def bias_fan_out(self) -> int:
        """Non-zero biases: what the always-on axon costs in SOPs per timestep."""
        return int(np.count_nonzero(self.bias))

    def most_arriving(self, times_max: Mapping[str, int]) -> NDArray[np.int64]:
        """Largest magnitude (N,) of any partial sum of the weights, the bias included.

        times_max: spikes of a neuron of each source in a timestep.
        """
        total: NDArray[np.int64] = np.abs(self.bias.astype(np.int64))
        for synapses in self.synapses:
            weight = np.abs(synapses.weight.astype(np.int64))
            total = total + synapses.over_axons(weight, np.add) * times_max[synapses.source]
        return total


class Network(Protocol):
    """The network that layers belong to, as arithmetics see it; Program is one."""

    @property
    def chip_name(self) -> str:
        """Name of the chip, for errors."""

    @property
    def convention(self) -> Convention:
        """Convention of the artifact."""

    @property
    def input(self) -> str:
        """Name of the input."""

    @property
    def layers(self) -> tuple[Layer, ...]:
        """Layers in an order in which each follows its sources without a delay."""

    @property
    def output(self) -> str:
        """Name of the layer with the spikes that leave the chip."""

    @property
    def output_apart(self) -> bool:
        """True where the output layer has hidden sources and no targets, as on Xylo."""


def plain_layer(name: str, synapses: Sequence[Synapses], threshold: Numbers) -> Layer:
    """A layer without biases, currents or leaks."""
    none = np.zeros(threshold.size, np.int64)
    return Layer(name, tuple(synapses), none, none, threshold, none, none, scale=1.0, start=0)


@dataclass(eq=False)
class LayerState:
    """The state of a layer between timesteps.

    current: (B, N) [state units]; (B, K, N) where neurons have K currents.
    membrane: (B, N) [state units].
    refractory: (B, N) timesteps left of the refractory period.
    sent: (B, N) graded spikes so far, added up; (B, 0) where neurons are no sigma-delta neurons.
    """

    current: Numbers
    membrane: Numbers
    refractory: NDArray[np.int64]
    sent: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))

    @classmethod
    def zero(cls, layer: Layer, batch: int) -> "LayerState":
        """The state of a layer that was just reset."""
        shape = (batch, layer.size)
        dtype = layer.threshold.dtype if layer.threshold.dtype.kind == "f" else np.dtype(np.int64)
        currents = np.zeros((batch, *layer.current_decay.shape), dtype)
        sent = np.zeros((batch, layer.size * layer.graded), np.int64)
        return cls(currents, np.zeros(shape, dtype), np.zeros(shape, np.int64), sent)


@dataclass(frozen=True, eq=False)
class StepResult:
    """The outcome of one timestep of a layer.

    spikes: (B, N); counts where neurons spike several times in a timestep, signed numbers of
        sigma-delta neurons.
    active: (B, N) where there was a membrane, a current or a bias to add up; the number of events
        that arrived, on a chip that works event by event.
    overflows: (B, N) how many numbers did not fit their register.
    lost: (B, N) spikes that reach no neuron, because a queue was full; None where there is none.
    """

    spikes: NDArray[Any]
    active: NDArray[np.bool_ | np.int64]
    overflows: NDArray[np.int64]
    lost: NDArray[np.int64] | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """Currents, membranes and spikes of a layer in a window; integers on integer chips.

    current: (B, T, N) after each timestep [state units]; (B, T, K, N) where neurons have K.
    membrane: (B, T, N) after each timestep, resets included [state units].
    spikes: (B, T, N); of sigma-delta neurons signed numbers in int64.
    """

    current: NDArray[Any]
    membrane: NDArray[Any]
    spikes: NDArray[np.integer[Any]]

    def part(self: AnyRecording, window: slice) -> AnyRecording:
        """Return the recording of some of the timesteps."""
        parts: dict[str, Any] = {
            name: None if rows is None else rows[:, window] for name, rows in vars(self).items()
        }
        return replace(self, **parts)


def with_starts(
    layers: Sequence[Layer],
    network_input: str,
    delay: int,
    stagger: bool,
    input_delay: int | None = None,
) -> list[Layer]:
    """The layers with their starts, and delays of at least that of the chip.

    layers: with the lags of the graph for delays, all starting at once.
    delay: [timesteps] from a spike to its arrival on the chip.
    stagger: start each layer when the first spikes can reach it.
    input_delay: [timesteps] likewise of the network's input; None is `delay`.
    """
    least = {network_input: delay if input_delay is None else input_delay}
    delays = {layer.name: [least.get(s.source, delay) for s in layer.synapses] for layer in layers}
    starts = first_arrivals(layers, network_input, delays if stagger else None)
    return [
        replace(
            layer,
            synapses=tuple(
                replace(s, delay=_delay(s, layer.name, starts, delay))
                for s, delay in zip(layer.synapses, delays[layer.name], strict=True)
            ),
            start=starts[layer.name],
        )
        for layer in layers
    ]


def first_arrivals(
    layers: Sequence[Layer], network_input: str, delays: Mapping[str, Sequence[int]] | None
) -> dict[str, int]:
    """Timestep at which the input can first reach each layer; slower paths decide.

    delays: [timesteps] of the synapses of each layer; None starts all at once.
    """
    starts = {network_input: 0}
    for layer in layers:
        late = delays[layer.name] if delays else [0] * len(layer.synapses)
        # sources that come later, or the layer itself, are feedback
        ahead = [(s, d) for s, d in zip(layer.synapses, late, strict=True) if s.source in starts]
        starts[layer.name] = max(
            (starts[s.source] + max(0, d - s.delay) for s, d in ahead), default=0
        )
    return starts


def _delay(synapses: Synapses, target: str, starts: dict[str, int], delay: int) -> int:
    """Delay of a connection: skips wait for the layers they skip, feedback takes its lag more."""
    due = starts[target] - starts[synapses.source] + synapses.delay
    if due < delay and any(starts.values()):
        raise RuleError(
            f"rule delay: layers {synapses.source!r} -> {target!r}: the feedback would have to "
            f"arrive {delay - due} timesteps before it can. Compile with clock='pipelined', which "
            "lengthens every loop by the delays of its layers."
        )
    return max(due, delay)
