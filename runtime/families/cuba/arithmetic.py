"""The arithmetics of CuBa-LIF chips: Loihi's integers, free widths, and floats.

CubaFixedPoint computes as Loihi, CubaGradedSpikes as Loihi 2 with sigma-delta neurons.

CubaFreeWidth is Loihi's arithmetic with free bit widths: no existing chip, but a way to find the
widths that one would need. Its neurons lack what is peculiar to Loihi: registers end at
the largest magnitude, decays are stored without offsets, weights use all their bits.

CubaFloat64 computes without rounding, which separates effects of compiling from those of rounding.
CubaFloat32 has whole weights and float32 states, as programs on SpiNNaker2's cores. Approximate:
in which order the firmware multiplies and adds, and rounds, is not published.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import ArithmeticDefaults, Description
from spikedeploy.runtime.chips.layer import (
    Layer,
    LayerState,
    Network,
    Numbers,
    Recording,
    StepResult,
)
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.chips.registers import Rounding, decay, magnitude, round_values
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ChipError, RuleError
from spikedeploy.runtime.families.cuba.neurons import (
    CubaRegisters,
    float_sigma_delta,
    float_update,
    sigma_delta,
    sum_arriving,
    update,
)
from spikedeploy.runtime.families.cuba.quantise import describe_range, quantise

# from rounded weights to the chip, each with those before it
_ROUNDING_STEPS = ("weights", "thresholds", "decays", "states")
# of lava's neurons; of whole numbers that float64 holds
_GRADED_BITS, _GRADED_BITS_FLOAT = 24, 53


@dataclass(frozen=True)
class CubaFixedPoint(CubaRegisters, ArithmeticDefaults):
    """The integer CuBa-LIF arithmetic of a chip; its fields are those of CubaRegisters."""

    backends: ClassVar[Mapping[str, str]] = {
        "numpy": "spikedeploy.runtime.families.cuba.numpy_backend:NumpyPipeline",
        "numba": "spikedeploy.runtime.families.cuba.numba_steps:CubaPipeline",
    }
    spikes_max: ClassVar[int] = 1
    choices: ClassVar[tuple[str, ...]] = ("granularity", "rounding")
    spikes_and_floor: ClassVar[tuple[str, str] | None] = ("above", "none")
    ablation_steps: ClassVar[tuple[str, ...]] = _ROUNDING_STEPS

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its current and its membrane."""
        return self.current.bits, self.membrane.bits

    @property
    def weights_have_signs(self) -> bool:
        """True where one of a weight's bits is its sign; else its list has it."""
        return self.sign_mode == "mixed"

    def input_delay(self, delay: int) -> int:
        """Delay of the network's input [timesteps], that of spikes or none."""
        return delay if self.input_acts == "next" else 0

    @property
    def threshold_range(self) -> tuple[int, int]:
        """Step and largest threshold [state units]."""
        return 1 << self.mantissa_shift, self.threshold_max << self.mantissa_shift

    @property
    def weight_lists(self) -> int:
        """Lists that hold the weights of an axon: 2 where each sign has its own."""
        return 2 if self.sign_mode == "split" else 1

    def quantise(
        self, network: Network, quantisation: Quantisation, timesteps: int | None, limits: bool
    ) -> Sequence[Layer]:
        """Return the float layers as integers."""
        return [quantise(layer, self, quantisation) for layer in network.layers]

    def ranges(self, layers: Sequence[Layer], timesteps: int | None) -> list[str]:
        """Return a warning for each quantised layer whose leak does not bound its registers.

        timesteps: T of an inference; None where it is not known, or states are kept.
        """
        drifts = not any(layer.graded for layer in layers)
        found = [describe_range(layer, self, timesteps, drifts) for layer in layers]
        return [sentence for sentence in found if sentence]

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        return update(self, network.convention, layer, sum_arriving(layer, presynaptic), state)

    def partly_rounded(self, before: Layer, after: Layer, step: str) -> Layer:
        """The layer in float64 and state units, rounded up to one of the ablation steps."""
        units, one = 1.0 / after.scale, float(1 << self.mantissa_shift)
        fields: dict[str, Any] = {
            "synapses": tuple(replace(s, weight=s.weight * one) for s in after.synapses),
            "bias": after.bias * one,
        }
        for name in ("threshold", "voltage_bias"):
            is_float = step == "weights"
            fields[name] = getattr(before, name) * units if is_float else getattr(after, name) * 1.0
        for name in ("current_decay", "membrane_decay"):
            factor = getattr(after, name) / self.decay_one
            fields[name] = factor if step == "decays" else getattr(before, name)
        return replace(after, **fields)

    def before_reset(self, layer: Layer, convention: Convention, ran: Recording) -> Numbers:
        """Membranes (B, T, N) before a spike reset them, computed once more [state units]."""
        # without a spike, and out of a refractory period, nothing was reset
        at = _places(ran.spikes) if self.refractory == 1 else np.arange(ran.spikes.size)
        bias, factor = (
            _of_neurons(each, at, layer.size).astype(np.int64)
            for each in (layer.voltage_bias, layer.membrane_decay)
        )
        # v = b v + (u + bias)      each as its register holds it
        kept = decay(_one_step_before(ran.membrane, at), factor, self.decay_bits)
        before: Numbers = ran.membrane.copy()
        push = self.push.fit(ran.current.reshape(-1)[at] + bias)
        before.reshape(-1)[at] = self.membrane.fit(kept + push)
        return before

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        signs = "with the sign" if self.sign_mode == "mixed" else "and sign"
        return Description("CuBa-LIF", f"{self.weight_bits} bits {signs}", self.membrane.describe())


@dataclass(frozen=True)
class CubaGradedSpikes(CubaFixedPoint):
    """CubaFixedPoint with sigma-delta neurons besides, which send graded spikes.

    Of 24 bits with the sign, as lava keeps them (lava-nc 0.10.0, proc.sdn, source read); 32 by
    public statements on Loihi 2 (Orchard et al. 2021, IEEE SiPS). That the chip's microcode counts
    thresholds is derived, and measured on no board.
    """

    graded_bits: ClassVar[int | None] = _GRADED_BITS

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        if layer.graded:
            weights = sum_arriving(layer, presynaptic)
            return sigma_delta(self, _GRADED_BITS, layer, weights, state)
        return super().update(network, layer, presynaptic, state)


def _places(spikes: Numbers) -> NDArray[np.intp]:
    """Places (K,) of the spikes in C order."""
    # of booleans ten times as fast as of bytes
    return np.flatnonzero(spikes.reshape(-1) != 0)


def _of_neurons(values: Numbers, at: NDArray[np.intp], size: int) -> Numbers:
    """Values (N,) or () at places (K,) of (B, T, N) in C order; one where all are the same."""
    first = values.reshape(-1)[:1]
    return first if (values == first).all() else values[at % size]


def _one_step_before(states: Numbers, at: NDArray[np.intp]) -> Numbers:
    """Return states (B, T, N) one timestep before places (K,) in C order; 0 before the first."""
    timesteps, neurons = states.shape[1:]
    begins = at // neurons % timesteps == 0
    return np.where(begins, 0, states.reshape(-1)[np.maximum(at - neurons, 0)])


# float64, which the kernels compute in, holds every product of such a state and such a decay
_WIDEST_STATE = 36
_WIDEST_DECAY = 16
# what a synapse is stored in
_WIDEST_WEIGHT = 16


@dataclass(frozen=True)
class CubaFreeWidth(CubaFixedPoint):
    """The integer CuBa-LIF neurons of CubaFixedPoint; fields that follow from others are not given.

    weight_bits: where sign_mode is "mixed", with the sign: -(2**(n - 1) - 1) to 2**(n - 1) - 1;
        where it is "split", of the magnitude. Weights have no bits that are dropped: a narrow
        weight is a small number, and the threshold follows it.
    threshold_bits: of a threshold's mantissa, unsigned; fewer where a membrane could not be above.
    """

    weight_bits_allowed: tuple[int, ...] = field(init=False)
    threshold_max: int = field(init=False)
    decay_max: int = field(init=False)
    threshold_bits: int

    def __post_init__(self) -> None:
        mixed = self.sign_mode == "mixed"
        widths = range(2, _WIDEST_WEIGHT + 1) if mixed else range(1, _WIDEST_WEIGHT)
        largest = (self.membrane.limit - 1) >> self.mantissa_shift
        # a frozen dataclass is written on in no other way
        object.__setattr__(self, "weight_bits_allowed", tuple(widths))
        object.__setattr__(self, "threshold_max", min((1 << self.threshold_bits) - 1, largest))
        object.__setattr__(self, "decay_max", self.decay_one)
        super().__post_init__()
        self._check_widths()

    @property
    def weight_exponent_max(self) -> int:
        """Weight exponent without a limit: fraction bits of the states are free."""
        return 0

    @property
    def weight_step(self) -> int:
        """Distance between two neighbouring weights."""
        return 1

    @property
    def weight_max(self) -> int:
        """Largest weight of either sign."""
        return (1 << (self.weight_bits - (self.sign_mode == "mixed"))) - 1

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        _, weights, membrane = super().describe()
        return Description("CuBa-LIF, free widths", f"{weights}, free", f"{membrane}, free")

    def _check_widths(self) -> None:
        if not 1 <= self.decay_bits <= _WIDEST_DECAY:
            raise ChipError(f"decay_bits is {self.decay_bits}; choose 1 to {_WIDEST_DECAY}.")
        if not 0 <= self.mantissa_shift <= _WIDEST_DECAY:
            raise ChipError(
                f"mantissa_shift is {self.mantissa_shift}; choose 0 to {_WIDEST_DECAY}."
            )
        for name in ("accumulator", "current", "push", "membrane"):
            register = getattr(self, name)
            if register.bits > _WIDEST_STATE:
                raise ChipError(f"{name} has {register.bits} bits; choose at most {_WIDEST_STATE}.")
            if register.overflow == "none" and name in ("current", "membrane"):
                raise ChipError(f"{name} must end somewhere. Choose what an overflow does.")
        if self.threshold_max < 1:
            raise ChipError(
                f"threshold_bits is {self.threshold_bits}, membrane has {self.membrane.bits} bits "
                f"and mantissa_shift is {self.mantissa_shift}: no threshold above 0 is left. "
                "Choose a wider membrane, or a smaller mantissa_shift."
            )


_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class CubaFloat64(ArithmeticDefaults):
    """CuBa-LIF neurons in float64: the network as it was trained, compiled as for a chip.

    Measures count its weights and states as float32, which is what hardware would hold.
    """

    backends: ClassVar[Mapping[str, str]] = {
        "numpy": "spikedeploy.runtime.families.cuba.numpy_backend:NumpyPipeline",
    }
    is_rounded: ClassVar[bool] = False
    spikes_max: ClassVar[int] = 1
    weight_bits: ClassVar[int] = 32
    state_bits: ClassVar[tuple[int, ...]] = (32, 32)
    graded_bits: ClassVar[int | None] = _GRADED_BITS_FLOAT

    def check_quantisation(self, quantisation: Quantisation, chip_name: str) -> None:
        """Accept every choice, since nothing is rounded."""

    def prepare(
        self, layers: Sequence[Layer], source: str, convention: Convention, delay: int, waits: bool
    ) -> tuple[list[Layer], list[str]]:
        """Prepare as on other chips; V >= threshold becomes V > the next lower number, exactly."""
        if convention.spikes != "reached" or convention.reset != "zero":
            return super().prepare(layers, source, convention, delay, waits)
        below = [replace(each, threshold=np.nextafter(each.threshold, -np.inf)) for each in layers]
        convention = replace(convention, spikes="above")
        return super().prepare(below, source, convention, delay, waits)

    def quantise(
        self, network: Network, quantisation: Quantisation, timesteps: int | None, limits: bool
    ) -> Sequence[Layer]:
        """The layers as they are."""
        return network.layers

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        weights = sum_arriving(layer, presynaptic)
        if layer.graded:
            return float_sigma_delta(_GRADED_BITS_FLOAT, layer, weights, state)
        return float_update(network.convention, layer, weights, state)

    def before_reset(self, layer: Layer, convention: Convention, ran: Recording) -> Numbers:
        """Membranes (B, T, N) before a spike reset them, computed once more [state units]."""
        at = _places(ran.spikes)
        bias, factor = (
            _of_neurons(each, at, layer.size) for each in (layer.voltage_bias, layer.membrane_decay)
        )
        # V = b V + I + bias
        before: Numbers = ran.membrane.copy()
        driven = factor * _one_step_before(ran.membrane, at) + ran.current.reshape(-1)[at]
        before.reshape(-1)[at] = driven + bias
        return before

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        return Description("CuBa-LIF", "float64", "float64")


@dataclass(frozen=True)
class CubaFloat32(ArithmeticDefaults):
    """CuBa-LIF neurons in float32, whose synapses hold small integers.

    weight_bits: of a weight, with the sign; the lowest number is not used.
    """

    backends: ClassVar[Mapping[str, str]] = {
        "numba": "spikedeploy.runtime.families.cuba.numba_steps:FloatPipeline",
    }
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
        self, network: Network, quantisation: Quantisation, timesteps: int | None, limits: bool
    ) -> Sequence[Layer]:
        """The float layers with whole weights, and everything else in float32."""
        rounding = quantisation.rounding or "nearest"
        return [self._quantise(layer, rounding) for layer in network.layers]

    def _quantise(self, layer: Layer, rounding: Rounding) -> Layer:
        """The layer with whole weights; its states and thresholds grow as the weights do."""
        # w_scale = weight_max / max|w| over all synapses into the population
        largest = max(magnitude(s.weight) for s in layer.synapses)
        scale = self.weight_max / largest if largest > 0 else 1.0
        if not np.isfinite(scale):
            raise RuleError(
                f"rule weight-bits: layer {layer.name!r}: the largest weight is {largest:g}; "
                f"nothing that small can be scaled to {self.weight_max}. Scale the weights up, or "
                "leave the layer out."
            )

        def scaled(name: str, rule: str = "bias") -> NDArray[np.float32]:
            values = np.asarray(getattr(layer, name), np.float64)
            most = magnitude(values)
            if most * scale > _LARGEST:
                raise RuleError(
                    f"rule {rule}: layer {layer.name!r}: {name} {most:g} is {most * scale:g} "
                    f"beside weights that are whole; float32 holds {_LARGEST:.3g}. Rescale the "
                    "layer."
                )
            return (values * scale).astype(np.float32)

        synapses = tuple(
            replace(s, weight=round_values(s.weight * scale, rounding).astype(np.int16))
            for s in layer.synapses
        )
        return replace(
            layer,
            synapses=synapses,
            bias=scaled("bias"),
            voltage_bias=scaled("voltage_bias"),
            threshold=scaled("threshold", "threshold-range")
            if layer.spiking
            else layer.threshold.astype(np.float32),
            current_decay=layer.current_decay.astype(np.float32),
            membrane_decay=layer.membrane_decay.astype(np.float32),
            scale=layer.scale / scale,
        )

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        return float_update(network.convention, layer, sum_arriving(layer, presynaptic), state)

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        return Description("CuBa-LIF", f"{self.weight_bits} bits with the sign", "float32")
