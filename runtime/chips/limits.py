"""The limits of a chip: what fits on it, and what it has."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Cost = Literal["words", "bits"]

# maps without a state: weights of the neurons behind them on every chip that has synapses
WEIGHTS = ("Affine", "Linear")
SPACE = ("Conv1d", "Conv2d", "Flatten", "SumPool2d", "AvgPool2d")
ENDS = ("Input", "Output")
# neurons without a threshold, whose membranes leave the chip
READOUTS = ("LI", "CubaLI", "I")


@dataclass(frozen=True)
class SynapticMemory:
    """The memory of a core that holds the synapses of its neurons.

    size: of a core [bit].
    cost: "words" packs up to 64 synapses of an axon into 64-bit words, as Loihi does; "bits" takes
        weight_bits a synapse and nothing else, which is the least that it can be.
    weight_bits: of a stored weight.
    """

    size: int
    cost: Cost
    weight_bits: int


@dataclass(frozen=True)
class LayerCore:
    """A core that computes one layer by itself.

    kernel: entries of its kernel memory.
    neurons: entries of its neuron memory.
    """

    kernel: int
    neurons: int


@dataclass(frozen=True)
class Convolutions:
    """What a core that computes a layer can take for one.

    kernel: largest extent of a kernel.
    strides: possible.
    channels: most features.
    extent: largest of what a layer puts out.
    """

    kernel: int
    strides: tuple[int, ...]
    channels: int
    extent: int


@dataclass(frozen=True)
class Limits:
    """What fits on a chip; None, or nothing, is no limit that anyone published.

    primitives: names of the NIR nodes that the chip has, maps without a state included.
    inputs: input channels of the chip.
    neurons: of the chip; besides the outputs where those are limited by themselves.
    outputs: neurons whose spikes leave the chip.
    fan_in: synapses of a neuron.
    fan_out: synapses that a spike can reach in the neurons of the chip, outputs not counted where
        those are limited by themselves.
    fan_out_mean: the same, the mean over the chip's neurons.
    input_targets: neurons that can have synapses from inputs.
    output_sources: neurons that can have synapses onto outputs.
    destinations: postsynaptic layers that a layer can have.
    cores: of a chip.
    neurons_per_core: of one core; larger layers are divided.
    memory: synaptic memory of a core.
    axons_in: different presynaptic sources of a core.
    axons_out: pairs of a neuron in a core and a core with postsynaptic neurons.
    decays: different pairs of decays in a core.
    thresholds: different thresholds in a core.
    layer_cores: where each layer takes a core of its own: what those hold.
    convolutions: what such a layer can be.
    axon_signs: whether a source excites all that it reaches, or inhibits all.
    weight_values: different weights of a neuron, besides 0; None where each synapse has its own.
    weight_max: largest mantissa of a weight.
    threshold_max: largest threshold, in the unit of weight_max.
    current_loss: least and most that a synaptic current may lose in one timestep, of 1.
    membrane_loss: likewise of a membrane.
    recurrence: whether neurons can project to themselves, over however many others.
    input_cores: whether inputs and the always-on axon of biases start in neurons of the chip.
    alone: whether a network must fit on one chip.
    sources: field to where its value comes from and how sure it is.
    """

    primitives: tuple[str, ...]
    sources: Mapping[str, str] = field(compare=False)
    inputs: int | None = None
    neurons: int | None = None
    outputs: int | None = None
    fan_in: int | None = None
    fan_out: int | None = None
    fan_out_mean: int | None = None
    input_targets: int | None = None
    output_sources: int | None = None
    destinations: int | None = None
    cores: int | None = None
    neurons_per_core: int | None = None
    memory: SynapticMemory | None = None
    axons_in: int | None = None
    axons_out: int | None = None
    decays: int | None = None
    thresholds: int | None = None
    layer_cores: tuple[LayerCore, ...] = ()
    convolutions: Convolutions | None = None
    axon_signs: bool = False
    weight_values: int | None = None
    weight_max: int | None = None
    threshold_max: int | None = None
    current_loss: tuple[float, float] | None = None
    membrane_loss: tuple[float, float] | None = None
    recurrence: bool | None = None
    input_cores: bool = False
    alone: bool = True
