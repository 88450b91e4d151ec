"""The arithmetic of Xylo: events added one by one, states that saturate, decays by shifts.

Weights become 8 bits, as in rockpool's `global_quantize` and `channel_quantize`: a scale makes the
largest weight or bias of a population, or the largest weight of a neuron, 127; where a threshold
then does not fit 16 bits, the scale is what makes it fit. Hidden and output neurons have scales of
their own.

Three things of rockpool 3.1.0 are not taken over: `global_quantize` scales the biases of outputs by
the hidden scale, and recurrent weights once more where the outputs' thresholds do not fit;
`channel_quantize` leaves biases unscaled where neurons have one synapse.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import (
    ArithmeticDefaults,
    Description,
    refuse_convention,
)
from spikedeploy.runtime.chips.layer import (
    NEVER,
    Layer,
    LayerState,
    Network,
    Numbers,
    StepResult,
    Synapses,
)
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.chips.registers import Rounding, magnitude, rounded
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.xylo.layers import check_output, xylo_layers
from spikedeploy.runtime.families.xylo.neurons import XyloRegisters, update

Floats: TypeAlias = NDArray[np.float64]


def quantise(
    network: Network, registers: XyloRegisters, quantisation: Quantisation = PLAIN
) -> list[Layer]:
    """The float layers of the network as Xylo's integers.

    quantisation: "layer" is one scale for all hidden neurons and one for all outputs, "channel" one
        for each neuron, which a spike without size allows; rounding is to the nearest by itself.
    """
    one = 1 << quantisation.weight_shift
    scales = _scales(network, registers, quantisation.granularity, one)
    rounding = quantisation.rounding or "nearest"
    return [_layer(layer, scales[layer.name], registers, rounding, one) for layer in network.layers]


def _scales(
    network: Network, registers: XyloRegisters, granularity: Granularity, one: int
) -> dict[str, Floats]:
    """Weights per float unit (N,) of each layer; a weight of 1 is worth so many state units."""
    biases_too = granularity == "layer"
    each = {layer.name: _fitting(layer, registers, one, biases_too) for layer in network.layers}
    if granularity == "channel":
        return each
    outputs = {network.output} if network.output_apart else set()
    common: dict[str, Floats] = {}
    for population in filter(None, (each.keys() - outputs, outputs)):
        least = min(each[name].min() for name in population)
        common |= {name: np.full(each[name].shape, least) for name in population}
    return common


def _fitting(layer: Layer, registers: XyloRegisters, one: int, biases_too: bool) -> Floats:
    """(N,) largest scale at which the weights, the bias and the threshold of each neuron fit.

    biases_too: whether biases, which have 16 bits, are to be no larger than weights all the same.
    """
    _check_thresholds(layer)
    bias = np.abs(layer.voltage_bias)
    weight = np.concatenate([np.abs(s.weight) for s in layer.synapses]).max(axis=0, initial=0.0)
    largest = np.maximum(weight, bias) if biases_too else weight
    wide = registers.state.limit / one
    threshold = layer.threshold if layer.spiking else 0 * largest
    with np.errstate(divide="ignore"):
        scales = registers.weight_max / largest, wide / threshold, wide / bias
    return np.asarray(np.min(scales, axis=0))


def _check_thresholds(layer: Layer) -> None:
    if layer.threshold.min() <= 0:
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold {layer.threshold.min():g}; a "
            "membrane of Xylo at rest would spike without end. Train with positive thresholds."
        )


def _layer(
    layer: Layer, scale: Floats, registers: XyloRegisters, rounding: Rounding, one: int
) -> Layer:
    synapses = tuple(_synapses(s, scale, registers, rounding, one) for s in layer.synapses)
    states = scale * one
    threshold = _threshold(layer, states, rounding)
    if (lost := threshold < 1).any():
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold "
            f"{layer.threshold[lost].min():g} becomes 0 beside the largest weight or bias, and a "
            "membrane at rest would spike without end. Clip the weights, raise the threshold, or "
            "give each channel a scale."
        )
    _check_alive(layer, synapses)
    return replace(
        layer,
        synapses=synapses,
        bias=np.zeros(layer.size, np.int64),
        voltage_bias=rounded(layer.voltage_bias * states, rounding),
        threshold=threshold,
        scale=layer.scale / (states[0] if np.ptp(states) == 0 else states),
    )


def _threshold(layer: Layer, states: Floats, rounding: Rounding) -> NDArray[np.int64]:
    if not layer.spiking:
        return np.full(layer.size, NEVER)
    return rounded(layer.threshold * states, rounding)


def _synapses(
    synapses: Synapses, scale: Floats, registers: XyloRegisters, rounding: Rounding, one: int
) -> Synapses:
    most = registers.weight_max
    weight = rounded(synapses.weight * scale, rounding).clip(-most, most)
    return replace(synapses, weight=(weight * one).astype(np.int32))


def _check_alive(layer: Layer, quantised: Sequence[Synapses]) -> None:
    """A layer with weights must not lose all of them to its threshold or to another layer."""
    before = max(magnitude(s.weight) for s in layer.synapses)
    if before > 0 and not any(s.weight.any() for s in quantised):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
            f"{before:g}, is too small beside a threshold, a bias or the weights of another layer. "
            "Give each channel a scale, or scale the weights up."
        )


@dataclass(frozen=True)
class XyloArithmetic(XyloRegisters, ArithmeticDefaults):
    """The integers of Xylo's cores; its fields are those of XyloRegisters."""

    choices: ClassVar[tuple[str, ...]] = ("granularity", "rounding")
    time_model: ClassVar[str | None] = "xylo-clocks"

    @property
    def input_spikes_max(self) -> int:
        """Spikes of an input channel in a timestep."""
        return self.events_max

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its currents and its membrane."""
        return (self.state.bits,) * (self.currents + 1)

    @property
    def threshold_range(self) -> tuple[int, int]:
        """Step and largest threshold [state units]."""
        return 1, self.state.limit

    def check_convention(self, convention: Convention, chip_name: str) -> None:
        """Refuse a floor; how often neurons spike is the chip's own, and a remark."""
        if convention.floor != "none":
            refuse_convention(convention, chip_name)

    def check_quantisation(self, quantisation: Quantisation, chip_name: str) -> None:
        """Refuse choices that Xylo does not have."""
        quantisation.only(chip_name, *self.choices)
        if not 0 <= (shift := quantisation.weight_shift) <= self.shift_max:
            raise ConfigError(f"weight_shift is {shift}; choose 0 to {self.shift_max} bits.")

    def prepare(
        self,
        layers: Sequence[Layer],
        network_input: str,
        convention: Convention,
        delay: int,
        stagger: bool,
    ) -> tuple[list[Layer], list[str]]:
        """The float layers with dashes for decays, and remarks on what is not as in the file."""
        return xylo_layers(layers, network_input, self, convention, stagger)

    def check_output(self, network: Network, chip_name: str) -> None:
        """Refuse to read neurons that are no output population."""
        check_output(network, self, chip_name)

    def quantise(
        self,
        network: Network,
        quantisation: Quantisation,
        chip_name: str,
        timesteps: int | None,
        limits: bool,
    ) -> Sequence[Layer]:
        """The float layers as Xylo's integers."""
        return quantise(network, self, quantisation)

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        return update(self, network, layer, presynaptic, state)

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        bits = f"{self.weight_bits} bits with the sign"
        return Description("CuBa-LIF, event by event", bits, self.state.describe())
