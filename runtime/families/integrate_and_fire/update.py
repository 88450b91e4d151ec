"""One timestep of integrate-and-fire neurons in the arithmetic of a chip: its specification.

    V = V - leak(V)             leak(V) = 0, sign(V) min(|V|, leak), sign(V) leak, or V >> leak
    V = V + sum W s + bias      as one sum, or event by event, each as the register holds it
    fires where V >= threshold or V > threshold: V = 0, or V = V - threshold

Whether the leak comes first or after the spikes, and whether the threshold is looked at after the
sum or after every event, a leak that comes first included, is the chip's.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Layer
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire

Integers = NDArray[np.int64]


@dataclass(eq=False)
class Stepping:
    """A layer in the middle of a timestep.

    membrane: (B, N).
    spikes: (B, N) counts so far.
    lost: (B, N) numbers so far that did not fit the membrane, and spikes that were too many.
    arrived: (B, N) whether any weight arrived.
    """

    membrane: Integers
    spikes: Integers
    lost: Integers
    arrived: NDArray[np.bool_]


def stepped(
    point: IntegrateAndFire,
    convention: Convention,
    layer: Layer,
    presynaptic: list[NDArray[Any]],
    membrane: Integers,
) -> Stepping:
    """The layer after a timestep in which these spikes (B, M) of each of its synapses arrive."""
    zero = np.zeros_like(membrane)
    state = Stepping(membrane, zero, zero, zero.astype(np.bool_))
    if point.leak_order == "first":
        _leak(point, layer, state)
        if point.checks == "event":
            # the leak is an event, too
            _fire(point, convention, layer, state)
    if point.adds == "step":
        _add(point, convention, layer, _sum(layer, presynaptic), state)
    else:
        _each(point, convention, layer, presynaptic, state)
    if point.leak_order == "last":
        _leak(point, layer, state)
    if point.checks == "step":
        _fire(point, convention, layer, state)
    return state


def _leak(point: IntegrateAndFire, layer: Layer, state: Stepping) -> None:
    v, leak = state.membrane, layer.membrane_decay
    if point.leak == "linear":
        # V = V - sign(V) min(|V|, leak)
        state.membrane = v - np.sign(v) * np.minimum(np.abs(v), leak)
    elif point.leak == "crossing":
        # V = V - sign(V) leak
        state.membrane = v - np.sign(v) * leak
    elif point.leak == "shift":
        # V = V - (V >> leak)      a negative shift is none at all
        state.membrane = v - np.where(leak < 0, 0, v >> np.maximum(leak, 0))


def _sum(layer: Layer, presynaptic: list[NDArray[Any]]) -> Integers:
    # sum W s + bias
    total: Integers = (layer.bias + layer.voltage_bias).astype(np.int64)
    for synapses, spikes in zip(layer.synapses, presynaptic, strict=True):
        total = total + spikes.astype(np.int64) @ synapses.weight.astype(np.int64)
    return total


def _each(
    point: IntegrateAndFire,
    convention: Convention,
    layer: Layer,
    presynaptic: list[NDArray[Any]],
    state: Stepping,
) -> None:
    """Add event by event: axon by axon, synapses in their order, and the bias at last."""
    bias = (layer.bias + layer.voltage_bias).astype(np.int64)
    for synapses, counts in zip(layer.synapses, presynaptic, strict=True):
        weight = synapses.weight.astype(np.int64)
        for axon in np.flatnonzero(counts.any(axis=0)):
            for nth in range(counts[:, axon].max()):
                arrives = (counts[:, axon] > nth)[:, None]
                _add(point, convention, layer, arrives * weight[axon], state, arrives)
    if bias.any():
        _add(point, convention, layer, bias, state)


def _add(
    point: IntegrateAndFire,
    convention: Convention,
    layer: Layer,
    weights: Integers,
    state: Stepping,
    arrives: NDArray[np.bool_] | bool = True,
) -> None:
    # V = V + W s, as the register holds it, and not below the floor
    raised = state.membrane + weights
    held = point.membrane.fit(raised)
    state.lost = state.lost + (held != raised)
    state.membrane = np.maximum(held, _floor(point, convention, layer))
    state.arrived = state.arrived | (weights != 0)
    if point.checks == "event":
        _fire(point, convention, layer, state, arrives)


def _floor(point: IntegrateAndFire, convention: Convention, layer: Layer) -> Integers:
    """Below what the membranes (N,) cannot fall; no register is that wide."""
    chips = -(1 << 62) if point.floor is None else point.floor
    wanted = {"none": chips, "zero": 0}.get(convention.floor, -layer.threshold)
    return np.asarray(np.maximum(chips, wanted), np.int64)


def _fire(
    point: IntegrateAndFire,
    convention: Convention,
    layer: Layer,
    state: Stepping,
    arrives: NDArray[np.bool_] | bool = True,
) -> None:
    """Spikes of the membranes; several at once only where the threshold is taken off each time."""
    subtract = convention.reset == "subtract"
    for _ in range(point.spikes_max if subtract and point.checks == "step" else 1):
        v, threshold = state.membrane, layer.threshold
        # fires where V >= threshold, or V > threshold
        fires = (v >= threshold if point.fires == "reached" else v > threshold) & arrives
        if not fires.any():
            break
        # V = V - threshold, or V = 0
        state.membrane = np.where(fires, v - threshold if subtract else 0, v)
        spikes = state.spikes + fires
        state.spikes = np.minimum(spikes, point.spikes_max)
        state.lost = state.lost + (spikes - state.spikes)
