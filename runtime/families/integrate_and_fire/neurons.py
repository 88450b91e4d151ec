"""Integrate-and-fire neurons without a synaptic current: one timestep of them.

The specification of a timestep:

    V = V - leak(V)             leak(V) = 0, sign(V) min(|V|, leak), sign(V) leak, or V >> leak
    V = V + sum W s + bias      as one sum, or event by event, each as the register holds it
    fires where V >= threshold or V > threshold: V = 0, or V = V - threshold

Whether the leak comes first or after the spikes, and whether the threshold is looked at after the
sum or after every event, a leak that comes first included, is the chip's. Where the reset stands in
for a leak, a neuron that fires keeps its membrane until the next timestep, which resets it instead
of leaking.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState, Numbers, StepResult
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.integrate_and_fire.rules import IntegrateAndFireRules

Integers = NDArray[np.int64]


@dataclass(eq=False)
class PartialStep:
    """A layer in the middle of a timestep.

    membrane: (B, N).
    spikes: (B, N) counts so far.
    overflows: (B, N) numbers so far that did not fit the membrane, and spikes that were too many.
    arrived: (B, N) whether any weight arrived.
    """

    membrane: Integers
    spikes: Integers
    overflows: Integers
    arrived: NDArray[np.bool_]

    @classmethod
    def of(cls, membrane: Integers) -> "PartialStep":
        """The beginning of a timestep, or of an event."""
        none = np.zeros_like(membrane)
        return cls(membrane, none, none, none.astype(np.bool_))


def update(
    rules: IntegrateAndFireRules,
    convention: Convention,
    layer: Layer,
    presynaptic: Sequence[Numbers],
    state: LayerState,
) -> StepResult:
    """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
    before, now = state.membrane, PartialStep.of(state.membrane)
    if rules.leak_order == "first":
        begin(rules, convention, layer, now)
    if rules.adds == "step":
        add(rules, convention, layer, _sum(layer, presynaptic), now)
    else:
        _each(rules, convention, layer, presynaptic, now)
    if rules.leak_order == "last":
        _leak(rules, layer, now)
    if rules.checks == "step":
        _fire(rules, convention, layer, now)
    state.membrane = now.membrane
    return StepResult(now.spikes, (before != 0) | now.arrived, now.overflows)


def begin(
    rules: IntegrateAndFireRules, convention: Convention, layer: Layer, state: PartialStep
) -> None:
    """The leak at the start of a timestep, and the resets that take its place."""
    v = state.membrane
    _leak(rules, layer, state)
    if rules.reset_at == "leak":
        after = _after_spike(convention, layer, v)
        state.membrane = np.where(fires(rules, layer, v), after, state.membrane)
    if rules.checks == "event":
        # the leak is an event, too
        _fire(rules, convention, layer, state)


def _leak(rules: IntegrateAndFireRules, layer: Layer, state: PartialStep) -> None:
    v, leak = state.membrane, layer.membrane_decay
    if rules.leak == "linear":
        # V = V - sign(V) min(|V|, leak)
        state.membrane = v - np.sign(v) * np.minimum(np.abs(v), leak)
    elif rules.leak == "crossing":
        # V = V - sign(V) leak
        state.membrane = v - np.sign(v) * leak
    elif rules.leak == "shift":
        # V = V - (V >> leak)      a negative shift is none at all
        state.membrane = v - np.where(leak < 0, 0, v >> np.maximum(leak, 0))


def _sum(layer: Layer, presynaptic: Sequence[Numbers]) -> Integers:
    # sum W s + bias
    total: Integers = (layer.bias + layer.voltage_bias).astype(np.int64)
    for synapses, spikes in zip(layer.synapses, presynaptic, strict=True):
        total = total + spikes.astype(np.int64) @ synapses.weight.astype(np.int64)
    return total


def _each(
    rules: IntegrateAndFireRules,
    convention: Convention,
    layer: Layer,
    presynaptic: Sequence[Numbers],
    state: PartialStep,
) -> None:
    """Add event by event: axon by axon, synapses in their order, and the bias at last."""
    bias = (layer.bias + layer.voltage_bias).astype(np.int64)
    for synapses, counts in zip(layer.synapses, presynaptic, strict=True):
        weight = synapses.weight.astype(np.int64)
        for axon in np.flatnonzero(counts.any(axis=0)):
            for nth in range(counts[:, axon].max()):
                arrives = (counts[:, axon] > nth)[:, None]
                add(rules, convention, layer, arrives * weight[axon], state, arrives)
    if bias.any():
        add(rules, convention, layer, bias, state)


def add(
    rules: IntegrateAndFireRules,
    convention: Convention,
    layer: Layer,
    weights: Integers,
    state: PartialStep,
    arrives: NDArray[np.bool_] | bool = True,
) -> None:
    """Add weights (N,) or (B, N) as one event; `arrives` says (B, 1) in which copies."""
    # V = V + W s, as the register holds it, and not below the floor
    raised = state.membrane + weights
    held = rules.membrane.fit(raised)
    state.overflows = state.overflows + (held != raised)
    state.membrane = np.maximum(held, _floor(rules, convention, layer))
    state.arrived = state.arrived | (weights != 0)
    if rules.checks == "event":
        _fire(rules, convention, layer, state, arrives)


def _floor(rules: IntegrateAndFireRules, convention: Convention, layer: Layer) -> Integers:
    """Below what the membranes (N,) cannot fall; no register is that wide."""
    chips = -(1 << 62) if rules.floor is None else rules.floor
    wanted = {"none": chips, "zero": 0}.get(convention.floor, -layer.threshold)
    return np.asarray(np.maximum(chips, wanted), np.int64)


def _fire(
    rules: IntegrateAndFireRules,
    convention: Convention,
    layer: Layer,
    state: PartialStep,
    arrives: NDArray[np.bool_] | bool = True,
) -> None:
    """Spikes of the membranes; several at once only where the threshold is taken off each time."""
    subtract = convention.reset == "subtract"
    for _ in range(rules.spikes_max if subtract and rules.checks == "step" else 1):
        v = state.membrane
        firing = fires(rules, layer, v) & arrives
        if not firing.any():
            break
        if rules.reset_at == "spike":
            state.membrane = np.where(firing, _after_spike(convention, layer, v), v)
        spikes = state.spikes + firing
        state.spikes = np.minimum(spikes, rules.spikes_max)
        state.overflows = state.overflows + (spikes - state.spikes)


def fires(rules: IntegrateAndFireRules, layer: Layer, v: Integers) -> NDArray[np.bool_]:
    """Which membranes (B, N) reach, or pass, the threshold."""
    # fires where V >= threshold, or V > threshold
    return np.asarray(v >= layer.threshold if rules.fires == "reached" else v > layer.threshold)


def _after_spike(convention: Convention, layer: Layer, v: Integers) -> Numbers | int:
    # V = V - threshold, or V = 0
    return v - layer.threshold if convention.reset == "subtract" else layer.v_reset
