"""CuBa-LIF neurons: the registers that hold them in integers, and one timestep.

`update` and `float_update` are the specification that everything fast is tested to equal.
Sigma-delta neurons (runtime.graph.discretisation), which the interpreter alone runs, have the same
registers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState, Numbers, StepResult
from spikedeploy.runtime.chips.registers import Register, decay
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ChipError

SignMode = Literal["split", "mixed"]
StepRounding = Literal["floor", "zero"]
Exponents = Literal["sum", "weight", "exact"]
InputActs = Literal["next", "same"]


@dataclass(frozen=True)
class CubaRegisters:
    """The registers of CuBa-LIF neurons in integers, and what they do to a number.

    weight_bits: stored bits of a weight's magnitude; fewer than the widest drop low bits.
    weight_bits_allowed: what may be chosen.
    sign_mode: "split" keeps excitatory and inhibitory weights in lists of their own, all bits
        magnitude; "mixed" spends one bit on the sign, so the weight's step doubles.
    step_rounding: where a mixed weight goes that is no multiple of the step; the emulators
        differ for negative ones. Split weights go toward zero in all of them.
    exponents: what a negative weight exponent rounds down: "sum", that of the weights of a list
        that arrive together; "weight", each weight by itself; "exact", nothing.
    mantissa_shift: weights and thresholds are multiplied by 2**this to meet the states.
    threshold_max: largest threshold mantissa.
    bias_mantissa_max, bias_exponent_max: a voltage bias is mantissa * 2**exponent.
    decay_bits: a decay is a fraction of 2**this.
    decay_max: largest number in a decay's register.
    current_decay_offset: added to the current's decay register by the hardware.
    membrane_decay_offset: likewise for the membrane.
    accumulator: sum of the weights that arrive in a timestep, after the shift.
    current, membrane: the two states.
    push: the current and the voltage bias, on their way to the membrane.
    refractory: timesteps from a spike to the next possible one; 1 is none.
    input_acts: the timestep in which an input spike that the host injects in a timestep reaches
        neurons: "next", as the spikes of other neurons; or the "same".
    """

    weight_bits: int
    weight_bits_allowed: tuple[int, ...]
    sign_mode: SignMode
    step_rounding: StepRounding
    exponents: Exponents
    mantissa_shift: int
    threshold_max: int
    bias_mantissa_max: int
    bias_exponent_max: int
    decay_bits: int
    decay_max: int
    current_decay_offset: int
    membrane_decay_offset: int
    accumulator: Register
    current: Register
    push: Register
    membrane: Register
    refractory: int
    input_acts: InputActs

    def __post_init__(self) -> None:
        if self.weight_bits not in self.weight_bits_allowed:
            raise ChipError(
                f"weight_bits is {self.weight_bits}; the chip stores one of "
                f"{', '.join(map(str, self.weight_bits_allowed))}."
            )
        if not self.weight_max:
            raise ChipError(
                "weight_bits is 1 and sign_mode 'mixed': the bit is the sign, and nothing is left "
                "for the weight. Choose more bits, or 'split'."
            )
        if self.refractory < 1:
            raise ChipError(f"refractory is {self.refractory}; the least is 1, which is none.")

    @cached_property
    def weight_step(self) -> int:
        """Distance between two neighbouring weights, a power of two."""
        dropped = max(self.weight_bits_allowed) - self.weight_bits
        return 1 << (dropped + (self.sign_mode == "mixed"))

    @cached_property
    def weight_max(self) -> int:
        """Largest weight of either sign."""
        widest = 1 << max(self.weight_bits_allowed)
        return int((widest - 1) // self.weight_step * self.weight_step)

    @property
    def weight_exponent_max(self) -> int:
        """Largest exponent by which the weights of a layer count 2**exponent times (lava: -8 to 7).

        It is used for readout layers alone: nothing else limits their scale.
        """
        return 7

    @cached_property
    def decay_one(self) -> int:
        """The decay that leaves nothing."""
        return 1 << self.decay_bits


def sum_arriving(layer: Layer, presynaptic: Sequence[Numbers]) -> Numbers:
    """Sum of the weights (B, N) that arrive, those of the bias included."""
    total = layer.bias.astype(layer.threshold.dtype)
    for synapses, spikes in zip(layer.synapses, presynaptic, strict=True):
        kind = np.float64 if total.dtype.kind == "i" else total.dtype
        arrived = synapses.sums(spikes, kind).astype(total.dtype)
        total = total + (arrived >> synapses.shift if synapses.shift else arrived)
    return total


def update(
    registers: CubaRegisters,
    convention: Convention,
    layer: Layer,
    weights: Numbers,
    state: LayerState,
) -> StepResult:
    """Advance a layer by one timestep; the sum of the weights (B, N) arrives in it."""
    # u = a u + (W s << 6)      v = b v + (u + bias)      each as its register holds it
    drive, lost = registers.accumulator.fit_counted(weights << registers.mantissa_shift)
    kept = decay(state.current, layer.current_decay, registers.decay_bits)
    current, wrapped = registers.current.fit_counted(kept + drive)
    push, turned = registers.push.fit_counted(current + layer.voltage_bias)
    kept = decay(state.membrane, layer.membrane_decay, registers.decay_bits)
    membrane, clipped = registers.membrane.fit_counted(kept + push)
    overflows = lost + wrapped + turned + clipped
    return _fire(convention, layer, state, current, membrane, registers.refractory, overflows)


def float_update(
    convention: Convention, layer: Layer, weights: Numbers, state: LayerState
) -> StepResult:
    """Advance a layer by one timestep in its floats, without registers."""
    # I = a I + W s      V = b V + I + bias
    current = layer.current_decay * state.current + weights
    membrane = layer.membrane_decay * state.membrane + current + layer.voltage_bias
    none = np.zeros(membrane.shape, np.int64)
    return _fire(convention, layer, state, current, membrane, 1, none)


def _fire(
    convention: Convention,
    layer: Layer,
    state: LayerState,
    current: Numbers,
    membrane: Numbers,
    refractory: int,
    overflows: NDArray[np.int64],
) -> StepResult:
    """The end of a timestep: spikes of the new membranes, resets, and refractory periods."""
    before, held = state.membrane, state.refractory > 0
    spikes = (membrane > layer.threshold) & ~held
    after = membrane - layer.threshold if convention.reset == "subtract" else 0
    state.current = current
    state.membrane = np.where(held, 0, np.where(spikes, after, membrane))
    state.refractory = np.where(spikes, refractory - 1, np.maximum(state.refractory - 1, 0))
    active = (before != 0) | (current != 0) | (layer.voltage_bias != 0)
    return StepResult(spikes, active, overflows)


def float_sigma_delta(bits: int, layer: Layer, weights: Numbers, state: LayerState) -> StepResult:
    """Advance sigma-delta neurons by one timestep in floats; weights (B, N) arrive in it.

        sigma = sigma + W g ;  a = max(sigma + b, 0) ;  d = a - q theta
        k = sign(d) floor(|d| / theta + 1/2) where |d| >= theta, else 0 ;  q = q + k

    k, a signed whole number, is sent; the weights behind the layer count it in thresholds theta.
    What is beyond 2**bits, the whole numbers that a float64 holds, is clipped, and counted.
    """
    before = state.membrane
    state.current, state.membrane = weights, before + weights
    # e = max(sigma + b, 0) / theta - q
    apart = np.maximum(state.membrane + layer.voltage_bias, 0) / layer.threshold - state.sent
    far = np.abs(apart)
    graded = np.where(far >= 1, np.sign(apart) * np.floor(far + 0.5), 0)
    held = np.clip(graded, -(2.0**bits), 2.0**bits)
    overflows = (held != graded).astype(np.int64)
    return _record_sent(layer, before, state, held.astype(np.int64), overflows)


def sigma_delta(
    registers: CubaRegisters, bits: int, layer: Layer, weights: Numbers, state: LayerState
) -> StepResult:
    """Advance sigma-delta neurons by one timestep in integers; graded spikes have `bits` bits.

    lava's neurons send where |d| >= vth too (lava-nc 0.10.0, proc.sdn: the corrected fixed-point
    model; source read), in units of 2**state_exp, rounded down, and keep sigma and what they send
    in 24 bits. The unit here is theta: a multiplication by 1 / theta, which no public source shows.
    """
    before = state.membrane
    drive, lost = registers.accumulator.fit_counted(weights << registers.mantissa_shift)
    state.current = drive
    state.membrane, clipped = registers.membrane.fit_counted(before + drive)
    activation, pushed = registers.push.fit_counted(state.membrane + layer.voltage_bias)
    apart = np.maximum(activation, 0) - state.sent * layer.threshold
    far = np.abs(apart)
    # floor(|d| / theta + 1/2) = (2 |d| + theta) // (2 theta)
    whole = (2 * far + layer.threshold) // (2 * layer.threshold)
    graded = np.where(far >= layer.threshold, np.sign(apart) * whole, 0)
    most = (1 << (bits - 1)) - 1
    held = np.clip(graded, -most, most)
    overflows = lost + clipped + pushed + (held != graded)
    return _record_sent(layer, before, state, held, overflows)


def _record_sent(
    layer: Layer, before: Numbers, state: LayerState, graded: Numbers, overflows: Numbers
) -> StepResult:
    """The end of a timestep: what is sent is remembered."""
    state.sent = state.sent + graded
    active = (before != 0) | (state.current != 0) | (layer.voltage_bias != 0)
    return StepResult(graded, active, overflows)
