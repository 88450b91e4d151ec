"""CuBa-LIF neurons in floats: in float64 without any rounding, and in float32 with whole weights.

`ideal` is no chip at all: the compiled path in float64, to tell compiling from rounding.

SpiNNaker2 (22 nm, 152 cores): neurons are programs, so their arithmetic is a float's. Approximate:
states are float32; in which order the firmware multiplies and adds, and rounds, is not published.
py-spinnaker2 has two kinds of models, and each is a datasheet: those that its import of NIR takes,
with weights of 8 bits and no delays (`spinnaker2`), and those that are given lists of synapses,
with weights of 4 bits and a sign and delays (`spinnaker2-lif`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import ArithmeticDefaults, Description
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.layer import Layer, LayerState, Network, Numbers, StepResult
from spikedeploy.runtime.chips.limits import ENDS, READOUTS, WEIGHTS, Limits, SynapticMemory
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.chips.registers import Rounding, magnitude, rounded
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ChipError, RuleError
from spikedeploy.runtime.families.cuba.neurons import (
    arriving,
    float_sigma_delta,
    float_update,
)

_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class CubaFloat64(ArithmeticDefaults):
    """CuBa-LIF neurons in float64: the network as it was trained, compiled as for a chip.

    Measures count its weights and states as float32, which is what hardware would hold.
    """

    backends: ClassVar[Mapping[str, str]] = {
        "numpy": "spikedeploy.runtime.families.cuba_numpy.pipeline:NumpyPipeline",
        # refuses, and says why
        "numba": "spikedeploy.runtime.families.cuba_numba.pipeline:NumbaPipeline",
    }
    rounds: ClassVar[bool] = False
    spikes_max: ClassVar[int] = 1
    weight_bits: ClassVar[int] = 32
    state_bits: ClassVar[tuple[int, ...]] = (32, 32)
    # whole numbers that float64 holds
    graded_bits: ClassVar[int] = 53

    def check_quantisation(self, quantisation: Quantisation, chip_name: str) -> None:
        """Take any choice, since nothing is rounded."""

    def prepare(
        self,
        layers: Sequence[Layer],
        network_input: str,
        convention: Convention,
        delay: int,
        stagger: bool,
    ) -> tuple[list[Layer], list[str]]:
        """As other chips; V >= threshold is V > the next number below it, which is exact."""
        if convention.spikes != "reached" or convention.reset != "zero":
            return super().prepare(layers, network_input, convention, delay, stagger)
        below = [replace(each, threshold=np.nextafter(each.threshold, -np.inf)) for each in layers]
        convention = replace(convention, spikes="above")
        return super().prepare(below, network_input, convention, delay, stagger)

    def quantise(
        self,
        network: Network,
        quantisation: Quantisation,
        chip_name: str,
        timesteps: int | None,
        limits: bool,
    ) -> Sequence[Layer]:
        """The layers as they are."""
        return network.layers

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        weights = arriving(layer, presynaptic)
        if layer.graded:
            return float_sigma_delta(self.graded_bits, layer, weights, state)
        return float_update(network.convention, layer, weights, state)

    def before_reset(
        self,
        layer: Layer,
        convention: Convention,
        current: Numbers,
        membrane: Numbers,
        spikes: Numbers,
    ) -> Numbers:
        """Membranes (B, T, N) before a spike reset them, computed once more [state units]."""
        # V = b V + I + bias
        before = np.concatenate([np.zeros_like(membrane[:, :1]), membrane[:, :-1]], axis=1)
        return np.asarray(layer.membrane_decay * before + current + layer.voltage_bias)

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        return Description("CuBa-LIF", "float64", "float64")


@dataclass(frozen=True)
class CubaFloat32(ArithmeticDefaults):
    """CuBa-LIF neurons in float32, whose synapses hold small integers.

    weight_bits: of a weight, with the sign; the lowest number is not used.
    """

    weight_bits: int
    spikes_max: ClassVar[int] = 1
    state_bits: ClassVar[tuple[int, ...]] = (32, 32)

    def __post_init__(self) -> None:
        if not 2 <= self.weight_bits <= 16:
            raise ChipError(f"weight_bits is {self.weight_bits}; choose 2 to 16.")

    @property
    def weight_max(self) -> int:
        """Largest weight of either sign."""
        return (1 << (self.weight_bits - 1)) - 1

    def quantise(
        self,
        network: Network,
        quantisation: Quantisation,
        chip_name: str,
        timesteps: int | None,
        limits: bool,
    ) -> Sequence[Layer]:
        """The float layers with whole weights, and everything else in float32."""
        rounding = quantisation.rounding or "nearest"
        return [_quantised(layer, self.weight_max, rounding) for layer in network.layers]

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        return float_update(network.convention, layer, arriving(layer, presynaptic), state)

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        return Description("CuBa-LIF", f"{self.weight_bits} bits with the sign", "float32")


def _quantised(layer: Layer, weight_max: int, rounding: Rounding) -> Layer:
    """The layer with whole weights; its states and thresholds grow as the weights do."""
    scale = _scale(layer, weight_max)
    return replace(
        layer,
        synapses=tuple(
            replace(s, weight=rounded(s.weight * scale, rounding).astype(np.int16))
            for s in layer.synapses
        ),
        bias=_single(layer, "bias", scale),
        voltage_bias=_single(layer, "voltage_bias", scale),
        threshold=_single(layer, "threshold", scale),
        current_decay=layer.current_decay.astype(np.float32),
        membrane_decay=layer.membrane_decay.astype(np.float32),
        scale=layer.scale / scale,
    )


def _scale(layer: Layer, weight_max: int) -> float:
    """w_scale = weight_max / max|w| over all synapses into the population."""
    largest = max(magnitude(s.weight) for s in layer.synapses)
    scale = weight_max / largest if largest > 0 else 1.0
    if not np.isfinite(scale):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: the largest weight is {largest:g}; nothing "
            f"that small can be scaled to {weight_max}. Scale the weights up, or leave the "
            "layer out."
        )
    return scale


def _single(layer: Layer, name: str, scale: float) -> NDArray[np.float32]:
    """(N,) the layer's numbers of that name, scaled, in float32."""
    if name == "threshold" and not layer.spiking:
        return layer.threshold.astype(np.float32)
    values = np.asarray(getattr(layer, name), np.float64)
    largest = magnitude(values)
    if largest * scale > _LARGEST:
        rule = "threshold-range" if name == "threshold" else "bias"
        raise RuleError(
            f"rule {rule}: layer {layer.name!r}: {name} {largest:g} is {largest * scale:g} beside "
            f"weights that are whole; float32 holds {_LARGEST:.3g}. Rescale the layer."
        )
    return (values * scale).astype(np.float32)


IDEAL = Chip(
    name="ideal",
    summary="float64 through the compiled path: no rounding, no limits",
    arithmetic=CubaFloat64(),
    resets=("zero", "subtract"),
    delay=0,
    delay_max=4096,
    energy_tables=(),
    membrane_output="software",
    sources={
        "clocks": "by definition",
        "arithmetic": "by definition",
        "membrane_output": "by definition",
        "resets": "by definition: both that a convention can name",
        "delay": "by definition: the convention decides",
        "delay_max": "by choice: so many timesteps of spikes fit any memory",
    },
    evidence="equal to the float graph in every spike",
)


_S2_NIR = "py-spinnaker2, s2_nir (source read)"
_PY = "py-spinnaker2's import of NIR, s2_nir (source read)"
_API = "py-spinnaker2, page 'SNN API' of its documentation"
_BOARDS = "public scripts that run lif_curr_exp on SpiNNaker2 boards (read)"
_SURVEY = "secondary: surveys of the chip"
_FIRMWARE = "assumed: the firmware was not read"

_LIMITS = Limits(
    primitives=(
        *ENDS,
        *WEIGHTS,
        "Conv2d",
        "Flatten",
        "SumPool2d",
        "Scale",
        "IF",
        "LIF",
        "CubaLIF",
        *READOUTS,
    ),
    cores=152,
    memory=SynapticMemory(size=128 * 1024 * 8, cost="bits", weight_bits=8),
    recurrence=True,
    alone=False,
    sources={
        "primitives": f"{_PY}: models lif_no_delay, lif_curr_exp_no_delay and lif_conv2d; IF is a "
        "lif without a leak, LI, CubaLI and I the same without a threshold (derived)",
        "cores": _SURVEY,
        "memory": f"{_SURVEY}: 128 KB of SRAM; program and states lie there too, so the number of "
        "cores is the least that it can be (derived)",
        "recurrence": f"{_PY}: a population can hear itself",
        "alone": f"{_SURVEY}: chips are joined on boards",
    },
)

SPINNAKER2 = Chip(
    name="spinnaker2",
    summary="SpiNNaker2, models *_no_delay: 8-bit weights, float32 states; approximate",
    arithmetic=CubaFloat32(weight_bits=8),
    resets=("subtract", "zero"),
    delay=1,
    delay_max=1,
    energy_tables=("spinnaker2",),  # two secondary sources that disagree: an interval
    limits=_LIMITS,
    membrane_output="software",
    sources={
        "clocks": "neurons are programs on ARM cores, so software can update a layer when it is "
        "told to; py-spinnaker2's own programs update every neuron in each timer tick",
        "membrane_output": f"{_PY}: neurons are programs, and its recordings hold their voltages",
        "weight_bits": f"{_S2_NIR}: 127 / max|w| into a population; rounding to nearest is assumed",
        "resets": f"{_S2_NIR}: subtraction is its default",
        "delay": f"{_S2_NIR}: conn_delay is 1 unless given; that a spike of a model without delays "
        f"is heard in the next timestep is {_FIRMWARE}",
        "delay_max": f"{_S2_NIR}: the models lif_no_delay, lif_curr_exp_no_delay and lif_conv2d, "
        "which its import takes, hold no delay of a synapse, as their names say",
    },
    evidence="approximate: the firmware's order of operations is not published; compared with "
    "nothing",
)

_LIF_LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Scale", "Delay", "IF", "LIF", "CubaLIF", *READOUTS),
    cores=152,
    neurons_per_core=250,
    memory=SynapticMemory(size=128 * 1024 * 8, cost="bits", weight_bits=16),
    recurrence=True,
    alone=False,
    sources={
        "primitives": f"{_API}: models lif and lif_curr_exp, whose synapses have a delay; "
        "convolutions have a model of their own, without (spinnaker2); IF, LI, CubaLI and I as on "
        "spinnaker2 (derived)",
        "cores": _SURVEY,
        "neurons_per_core": "max_atoms_per_core of a class that NESTML writes for py-spinnaker2, "
        "made from its LIFApplication (read)",
        "memory": f"{_SURVEY}: 128 KB of SRAM; 16 bits a synapse: 4 of weight, 3 of delay, its "
        "sign and the index of one of 250 neurons (derived)",
        "recurrence": f"{_API}: a projection joins any two populations",
        "alone": f"{_SURVEY}: chips are joined on boards",
    },
)

SPINNAKER2_LIF = replace(
    SPINNAKER2,
    name="spinnaker2-lif",
    summary="SpiNNaker2, models lif and lif_curr_exp: weights -15 to 15, delays; approximate",
    arithmetic=CubaFloat32(weight_bits=5),
    delay_max=7,
    limits=_LIF_LIMITS,
    sources={
        "clocks": SPINNAKER2.sources["clocks"],
        "membrane_output": f"{_API}: recordings hold the voltages of a population",
        "weight_bits": f"{_API}: lif takes whole weights of -15 to 15 (secondary); {_BOARDS} scale "
        "theirs to +-15; rounding to nearest is assumed",
        "resets": f"{_API}: reset_by_subtraction, reset_to_v_reset",
        "delay": f"{_API}: a delay of 1 is one timestep; what 0 means is {_FIRMWARE}, so 1 is the "
        "least here",
        "delay_max": f"{_API}: delays of 0 to 7 (secondary)",
    },
)
