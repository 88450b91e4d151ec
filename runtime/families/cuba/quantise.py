"""Quantisation: a layer in floats becomes the integers that a chip can hold.

The scale of a layer is how many mantissas stand for a float unit. The largest weight or bias
becomes the chip's largest weight (Tang et al. 2020, PopSAN), unless the threshold or the voltage
bias would not fit then. Spikes are unit events, so layers and neurons can be scaled independently:
threshold, bias and membrane follow the scale.

Nothing bounds the current of a readout that hardly leaks: it is the sum of all that ever arrived.
So a scale is chosen at which half of each register holds NET_EVENTS more spikes of one sign than of
the other over a neuron's heaviest synapse, or all that can arrive where leaks bound that. A decay
rounds toward zero, by up to 1 state unit in a timestep, which matters least beside large states:
the weights count 2**exponent times, with the largest exponent that leaves this room.

Bounds on the numbers of a layer, whatever the spikes, prove that fast arithmetic is exact.
"""

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import check_thresholds, check_weights_left
from spikedeploy.runtime.chips.layer import NEVER, Layer, Network
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.chips.registers import Register, Rounding, magnitude, round_values
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# spikes of one sign more than of the other, on the heaviest synapse; a channel of a delta code with
# steps of 0.3 standard deviations stays below 10, and several channels add up
NET_EVENTS = 64
# part of a register that they may fill
_SHARE = 0.5
# [timesteps] what a bias adds up to without a leak is taken over so many
_LONG_BIAS = 4096
# a current that loses no more than this part of itself in a timestep adds up for long
_SLOW = 1 / 256
# net spikes that are not counted further
_MANY = 10**9
# timesteps at which responses are looked at: each at first, then a few of each octave
_TIMES = np.unique(np.concatenate([np.arange(64), np.geomspace(64, 1e6, 200).astype(int)]))
# what weights with their exponent are stored in
_WIDEST = (1 << 15) - 1


def exponent_and_share(
    layer: Layer, registers: CubaRegisters, scale: float | Floats
) -> tuple[int, float]:
    """The exponent of a float readout layer, and the part of the scale to use, 1 but for overflow.

    scale: mantissas per float unit, (N,) or one for all.
    """
    unit = scale * (1 << registers.mantissa_shift)
    states = min(registers.current.limit, registers.push.limit, registers.membrane.limit)
    widest_bias = registers.bias_mantissa_max << registers.bias_exponent_max
    filled = max(
        magnitude(_reach(layer) * unit) / (_SHARE * states),
        magnitude(layer.voltage_bias * unit) / max(widest_bias, 1),
    )
    if filled > 1:
        return 0, 1 / filled
    # whatever arrives at once is to fit the accumulator, or kernels would be slow
    filled = max(filled, magnitude(_largest_arrival(layer) * unit) / registers.accumulator.limit)
    widest = int(np.log2(_WIDEST // registers.weight_max))
    most = min(registers.weight_exponent_max, widest)
    return (int(np.clip(np.floor(np.log2(1 / filled)), 0, most)) if filled else 0), 1.0


def describe_range(
    layer: Layer, registers: CubaRegisters, timesteps: int | None, drifts: bool = True
) -> str:
    """Return a warning if registers may not hold a quantised layer; "" if they do, or it leaks.

    Of layers that spike the current is looked at, where it hardly leaks: thresholds bound the rest.
    Nothing bounds what sigma-delta neurons add up. A graded spike counts as one, so that net spikes
    are those of the level that a source has sent.

    timesteps: T of an inference; None is a state that is never reset.
    drifts: whether `spikedeploy drift` takes the network.
    """
    current, membrane = _factors(layer, registers)
    states = [registers.current.limit, registers.push.limit, registers.membrane.limit]
    if layer.spiking and not layer.graded:
        if current.max() < 1 - _SLOW:
            return ""
        membrane, states = 0 * membrane, states[:2]
    unit, held = 1 << registers.mantissa_shift, min(states)
    positive, negative, heaviest = weight_sums(layer)
    each, bias = (
        heaviest * unit * _peak_response(current, membrane),
        _bias_sums(layer, current, membrane, unit),
    )
    largest, steady = np.maximum(positive, negative) * unit, _steady(current, membrane)
    if timesteps is not None:
        steady = np.minimum(steady, timesteps * _peak_response(current, membrane))
    proven = np.multiply(largest, steady, out=np.zeros(layer.size), where=largest > 0) + bias
    if magnitude(proven) <= held:
        return ""
    room = np.divide(held - bias, each, out=np.full(layer.size, np.inf), where=each > 0)
    look = "; `spikedeploy drift` shows what recorded inputs fill" if drifts else ""
    kind = "sigma-delta layer" if layer.graded else "layer" if layer.spiking else "readout"
    return (
        f"{kind} {layer.name!r}: its leaks do not bound what it adds up; its registers hold "
        f"{max(int(min(room.min(), _MANY)), 0)} net spikes over a heaviest synapse (the ledger "
        f"counts saturations{look})"
    )


def _bias_sums(layer: Layer, current: Floats, membrane: Floats, unit: int) -> Floats:
    """Sums (N,) of the biases over time; without a leak over _LONG_BIAS timesteps."""
    # sigma-delta neurons add it once, when they read sigma
    kept = 1 - membrane if not layer.graded else np.ones(layer.size)
    pushed = np.abs(layer.voltage_bias) / np.maximum(kept, 1 / _LONG_BIAS)
    return np.asarray(
        np.abs(layer.bias) * unit * np.minimum(_steady(current, membrane), _LONG_BIAS) + pushed
    )


def weight_sums(layer: Layer) -> tuple[Floats, Floats, Floats]:
    """Sums (N,) of the positive and of the negative weights of each neuron, and its heaviest."""
    positive = negative = heaviest = np.zeros(layer.size)
    for synapses in layer.synapses:
        weight = synapses.weight.astype(np.float64)
        positive = positive + synapses.over_axons(weight.clip(min=0), np.add)
        negative = negative - synapses.over_axons(weight.clip(max=0), np.add)
        heaviest = np.maximum(heaviest, synapses.over_axons(np.abs(weight), np.maximum))
    return positive, negative, heaviest


def _largest_arrival(layer: Layer) -> Floats:
    """The most that arrives in a timestep (N,)."""
    positive, negative, _ = weight_sums(layer)
    return np.asarray(np.maximum(positive, negative) + np.abs(layer.bias))


def _reach(layer: Layer) -> Floats:
    """Estimate of the largest current or membrane (N,) of a float layer [float units]."""
    positive, negative, heaviest = weight_sums(layer)
    current, membrane = layer.current_decay, layer.membrane_decay
    steady, largest = _steady(current, membrane), np.maximum(positive, negative)
    events = NET_EVENTS * heaviest * _peak_response(current, membrane)
    bounded = np.isfinite(steady)
    proven = np.multiply(largest, steady, out=events.copy(), where=bounded)
    return np.asarray(np.minimum(events, proven) + _bias_sums(layer, current, membrane, 1))


def _steady(current: Floats, membrane: Floats) -> Floats:
    """Return the membrane for a constant arrival of 1; infinite without a leak."""
    with np.errstate(divide="ignore"):
        return np.asarray(1 / ((1 - current) * (1 - membrane)))


def _peak_response(current: Floats, membrane: Floats) -> Floats:
    """Largest membrane after a single arrival of 1.

    v[t] = sum over k <= t of a^k b^(t - k) = (a^(t + 1) - b^(t + 1)) / (a - b)
    """
    t = _TIMES[:, None] + 1.0
    apart = np.abs(current - membrane) > 1e-6
    nearly = t * np.maximum(current, membrane) ** (t - 1)
    rest = current**t - membrane**t
    response = np.divide(rest, current - membrane, out=nearly, where=apart)
    return np.asarray(response.max(axis=0))


# (), one for a layer, or (N,), one for each of its neurons
Scale: TypeAlias = float | Floats


def _mantissas_per_unit(layer: Layer, registers: CubaRegisters, granularity: Granularity) -> Scale:
    """Return the most mantissas per unit that weights, threshold and bias allow."""
    widest_bias = (
        registers.bias_mantissa_max << registers.bias_exponent_max >> registers.mantissa_shift
    )
    _, _, heaviest = weight_sums(layer)
    scale = np.full(layer.size, np.inf)
    for most, numbers in (
        (registers.weight_max, heaviest),
        (registers.weight_max, layer.bias),
        (registers.threshold_max, layer.threshold if layer.spiking else 0 * layer.bias),
        (widest_bias, layer.voltage_bias),
    ):
        with np.errstate(over="ignore"):  # what is so small that no float is its scale bounds none
            found = np.divide(most, np.abs(numbers), out=scale.copy(), where=numbers != 0)
        scale = np.minimum(scale, found)
    if granularity == "layer":
        least = float(scale.min())
        return least if np.isfinite(least) else 1.0
    # a neuron of zeros has no largest number
    scale = np.where(np.isfinite(scale), scale, 1.0)
    for window in (s.window for s in layer.synapses if s.window is not None):
        # neurons that share a kernel share its scale
        channels = scale.reshape(window.target[0], -1)
        scale = np.broadcast_to(channels.min(axis=1, keepdims=True), channels.shape).ravel()
    return scale


def quantise(layer: Layer, registers: CubaRegisters, quantisation: Quantisation = PLAIN) -> Layer:
    """The float layer as the chip's integers."""
    if not registers.bias_mantissa_max and layer.voltage_bias.any():
        raise RuleError(
            f"rule bias: layer {layer.name!r}: a voltage bias of "
            f"{magnitude(layer.voltage_bias):g}; the chip's neurons have none. Set v_leak to 0, "
            "or take another model of the chip."
        )
    rounding = quantisation.rounding or "nearest"
    scale = _mantissas_per_unit(layer, registers, quantisation.granularity)
    exponent = 0
    if not layer.spiking:
        exponent, part = exponent_and_share(layer, registers, scale)
        scale = scale * part
    one = 1 << (registers.mantissa_shift + exponent)

    def weights(values: Floats, scale: Scale) -> Integers:
        """Multiples of the chip's weight step."""
        steps = round_values(values * scale / registers.weight_step, rounding)
        most = registers.weight_max
        return np.clip(steps * registers.weight_step, -most, most) << exponent

    quantised = replace(
        layer,
        synapses=tuple(
            replace(s, weight=weights(s.weight, s.by_weight(scale)).astype(np.int16))
            for s in layer.synapses
        ),
        bias=weights(layer.bias, scale),
        voltage_bias=_voltage_bias(layer.voltage_bias * scale * one, registers, rounding),
        threshold=_thresholds(layer, scale, registers, rounding, one),
        current_decay=_decay_factor(layer, "current", registers, rounding),
        membrane_decay=_decay_factor(layer, "membrane", registers, rounding),
        scale=layer.scale / (scale * one),
    )
    beside = (
        f"beside its threshold ({magnitude(layer.threshold):g}, of at most "
        f"{registers.threshold_max} mantissas) or bias. Scale the weights up, or the others down."
        if layer.spiking
        else "beside its bias, or beside what its registers would have to hold. Choose a faster "
        "leak."
    )
    check_weights_left(layer, quantised.synapses, beside)
    return quantised


def drop_low_bits(
    weights: NDArray[Any], registers: CubaRegisters, exponent: int = 0
) -> NDArray[np.int16]:
    """Whole weights as the chip stores them, without the bits below its weight step.

    exponent: each weight then counts 2**this times, rounded down.
    """
    whole = weights.astype(np.int64)
    if registers.sign_mode == "mixed" and registers.step_rounding == "floor":
        steps = whole // registers.weight_step
    else:
        steps = np.sign(whole) * (np.abs(whole) // registers.weight_step)
    held = steps * registers.weight_step
    held = held << exponent if exponent > 0 else held >> -exponent
    if registers.exponents == "weight":  # brian2_loihi clips what a weight adds to the accumulator
        limit = registers.accumulator.limit >> registers.mantissa_shift
        held = np.clip(held, -limit, limit)
    return np.asarray(held, np.int16)


def _thresholds(
    layer: Layer, scale: Scale, registers: CubaRegisters, rounding: Rounding, one: int
) -> Integers:
    """Thresholds [state units], of which mantissas are `one` apart."""
    if not layer.spiking:
        return np.full(layer.size, NEVER)
    if layer.graded:  # a state of the neuron's program, not a mantissa
        return np.maximum(round_values(layer.threshold * scale * one, rounding), 1)
    mantissa = round_values(layer.threshold * scale, rounding)
    why = "beside the largest weight. Clip the weights, or raise the threshold."
    return np.minimum(check_thresholds(layer, mantissa, why), registers.threshold_max) * one


def _voltage_bias(values: Floats, registers: CubaRegisters, rounding: Rounding) -> Integers:
    """Biases as mantissa * 2**exponent, with the smallest exponent that holds each value."""
    over = np.maximum(np.abs(values) / max(registers.bias_mantissa_max, 1), 1.0)
    exponent = np.ceil(np.log2(over)).astype(np.int64)
    exponent = np.minimum(exponent, registers.bias_exponent_max)
    mantissa = round_values(values / 2.0**exponent, rounding)
    limit = registers.bias_mantissa_max
    return np.clip(mantissa, -limit, limit) << exponent


def _decay_factor(layer: Layer, of: str, registers: CubaRegisters, rounding: Rounding) -> Integers:
    """Parts of 2**decay_bits left after a timestep, as near as the decay's register allows."""
    factor = getattr(layer, f"{of}_decay")
    least = getattr(registers, f"{of}_decay_offset")
    most = registers.decay_max + least
    if (least > 0 and (factor == 1).any()) or (most < registers.decay_one and (factor == 0).any()):
        raise RuleError(
            f"rule decay-range: layer {layer.name!r}: a {of} that keeps "
            f"{'all' if least else 'nothing'} of itself is not possible; the chip takes away "
            f"{least} to {most} of {registers.decay_one} in each timestep. Choose another time "
            "constant."
        )
    decays = round_values((1 - factor) * registers.decay_one, rounding)
    return registers.decay_one - np.clip(decays, least, most)


# largest magnitude for which float64 decays exactly: 2**53 less 12 decay bits, with one to spare
_EXACT_STATE = 1 << 40

# [timesteps] longer windows are treated as unbounded
_LONG = 100


@dataclass(frozen=True)
class Bounds:
    """Largest magnitudes over the neurons of a layer, whatever the spikes.

    partial: of any partial sum of weights, in any order.
    drive: of what arrives in a timestep [state units].
    current: [state units].
    above: of a membrane before its reset, where it is positive [state units].
    below: of a membrane where it is negative [state units].
    """

    partial: int
    drive: float
    current: float
    above: float
    below: float


def register_limit(register: Register) -> int:
    """Largest magnitude that a register holds, and that float64 decays exactly."""
    limitless = register.overflow == "none" and register.between is None
    return _EXACT_STATE if limitless else register.limit


def bounds(
    network: Network, layer: Layer, registers: CubaRegisters, timesteps: int | None
) -> Bounds:
    """Bounds of a layer that starts from 0; timesteps None is a state that is never reset."""
    one = float(1 << registers.mantissa_shift)
    positive, negative, _ = weight_sums(layer)
    positive, negative = positive + layer.bias.clip(min=0), negative - layer.bias.clip(max=0)
    raised, above = _leaky(layer, registers, positive * one, layer.voltage_bias, timesteps)
    lowered, below = _leaky(layer, registers, negative * one, -layer.voltage_bias, timesteps)
    if network.convention.reset == "zero":
        # no membrane stays above its threshold
        above = np.minimum(above, layer.threshold + raised + layer.voltage_bias.clip(min=0))
    partial = np.maximum(positive, negative).max()
    return Bounds(
        partial=int(partial),
        drive=float(partial * one),
        current=float(np.maximum(raised, lowered).max()),
        above=float(above.max()),
        below=float(below.max()),
    )


def _factors(layer: Layer, registers: CubaRegisters) -> tuple[Floats, Floats]:
    """The parts that currents and membranes (N,) keep."""
    one = float(registers.decay_one)
    return layer.current_decay / one, layer.membrane_decay / one


def _leaky(
    layer: Layer, registers: CubaRegisters, drive: Floats, bias: NDArray[Any], timesteps: int | None
) -> tuple[Floats, Floats]:
    """Largest current and membrane (N,) when so much arrives in every timestep."""
    current_factor, membrane_factor = _factors(layer, registers)
    push = bias.clip(min=0).astype(np.float64)
    if timesteps is None or timesteps > _LONG:
        current = _limit_of_leak(drive, current_factor)
        return current, _limit_of_leak(current + push, membrane_factor)
    current = membrane = np.zeros(layer.size)
    for _ in range(timesteps):
        current = current_factor * current + drive
        membrane = membrane_factor * membrane + current + push
    return current, membrane


def _limit_of_leak(drive: Floats, factor: Floats) -> Floats:
    """Limit of x = factor x + drive: drive / (1 - factor), and infinite without a leak."""
    unbounded = np.where(drive > 0, np.inf, 0.0)
    return np.divide(drive, 1 - factor, out=unbounded, where=factor < 1)
