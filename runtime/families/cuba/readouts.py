"""Layers that add up for long, in Loihi's integers: what registers hold, and a scale for readouts.

Nothing bounds the current of a readout that hardly leaks: it is the sum of all that ever arrived.
So a scale is chosen at which half of each register holds NET_EVENTS more spikes of one sign than of
the other over a neuron's heaviest synapse, or all that can arrive where leaks bound that. A decay
rounds toward zero, by up to 1 state unit in a timestep, which matters least beside large states:
the weights count 2**exponent times, with the largest exponent that leaves this room.
"""

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import magnitude
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters

Floats = NDArray[np.float64]

# spikes of one sign more than of the other, on the heaviest synapse; a channel of a delta code with
# steps of 0.3 standard deviations stays below 10, and several channels add up
NET_EVENTS = 64
# part of a register that they may fill
_SHARE = 0.5
# [timesteps] what a bias adds up to without a leak is taken over so many
_LONG = 4096
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
    filled = max(filled, magnitude(_arriving(layer) * unit) / registers.accumulator.limit)
    widest = int(np.log2(_WIDEST // registers.weight_max))
    most = min(registers.weight_exponent_max, widest)
    return (int(np.clip(np.floor(np.log2(1 / filled)), 0, most)) if filled else 0), 1.0


def range_of(
    layer: Layer, registers: CubaRegisters, timesteps: int | None, drifts: bool = True
) -> str:
    """What registers hold of a quantised layer, in a sentence; "" where that is all, or it leaks.

    Of layers that spike the current is looked at, where it hardly leaks: thresholds bound the rest.
    Nothing bounds what sigma-delta neurons add up. A graded spike counts as one, so that net spikes
    are those of the level that a source has sent.

    timesteps: T of an inference; None is a state that is never reset.
    drifts: whether `spikedeploy drift` takes the network.
    """
    one = float(registers.decay_one)
    current, membrane = layer.current_decay / one, layer.membrane_decay / one
    states = [registers.current.limit, registers.push.limit, registers.membrane.limit]
    if layer.spiking and not layer.graded:
        if current.max() < 1 - _SLOW:
            return ""
        membrane, states = 0 * membrane, states[:2]
    unit, held = 1 << registers.mantissa_shift, min(states)
    positive, negative, heaviest = _weighed(layer)
    each, bias = heaviest * unit * _peak(current, membrane), _biased(layer, current, membrane, unit)
    largest, steady = np.maximum(positive, negative) * unit, _steady(current, membrane)
    if timesteps is not None:
        steady = np.minimum(steady, timesteps * _peak(current, membrane))
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


def _biased(layer: Layer, current: Floats, membrane: Floats, unit: int) -> Floats:
    """What the biases (N,) add up to; without a leak over _LONG timesteps."""
    # sigma-delta neurons add it once, when they read sigma
    kept = 1 - membrane if not layer.graded else np.ones(layer.size)
    pushed = np.abs(layer.voltage_bias) / np.maximum(kept, 1 / _LONG)
    return np.asarray(
        np.abs(layer.bias) * unit * np.minimum(_steady(current, membrane), _LONG) + pushed
    )


def _weighed(layer: Layer) -> tuple[Floats, Floats, Floats]:
    """Sums of the positive and of the negative weights of each neuron, and its heaviest (N,)."""
    weights = np.concatenate([s.weight.astype(np.float64) for s in layer.synapses])
    heaviest = np.abs(weights).max(axis=0, initial=0.0)
    return weights.clip(min=0).sum(axis=0), -weights.clip(max=0).sum(axis=0), heaviest


def _arriving(layer: Layer) -> Floats:
    """The most that arrives in a timestep (N,)."""
    positive, negative, _ = _weighed(layer)
    return np.asarray(np.maximum(positive, negative) + np.abs(layer.bias))


def _reach(layer: Layer) -> Floats:
    """Estimate of the largest current or membrane (N,) of a float layer [float units]."""
    positive, negative, heaviest = _weighed(layer)
    current, membrane = layer.current_decay, layer.membrane_decay
    steady, largest = _steady(current, membrane), np.maximum(positive, negative)
    events = NET_EVENTS * heaviest * _peak(current, membrane)
    bounded = np.isfinite(steady)
    proven = np.multiply(largest, steady, out=events.copy(), where=bounded)
    return np.asarray(np.minimum(events, proven) + _biased(layer, current, membrane, 1))


def _steady(current: Floats, membrane: Floats) -> Floats:
    """What 1 that arrives in every timestep adds up to; infinite without a leak."""
    with np.errstate(divide="ignore"):
        return np.asarray(1 / ((1 - current) * (1 - membrane)))


def _peak(current: Floats, membrane: Floats) -> Floats:
    """Largest membrane after a single arrival of 1.

    v[t] = sum over k <= t of a^k b^(t - k) = (a^(t + 1) - b^(t + 1)) / (a - b)
    """
    t = _TIMES[:, None] + 1.0
    apart = np.abs(current - membrane) > 1e-6
    nearly = t * np.maximum(current, membrane) ** (t - 1)
    rest = current**t - membrane**t
    response = np.divide(rest, current - membrane, out=nearly, where=apart)
    return np.asarray(response.max(axis=0))
