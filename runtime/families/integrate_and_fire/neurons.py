"""Integrate-and-fire neurons without a synaptic current: what chips differ in, and one timestep.

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
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState, Numbers, StepResult
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ChipError

Signs = Literal["weight", "axon"]
Leak = Literal["none", "linear", "crossing", "shift"]
LeakOrder = Literal["first", "last"]
Moment = Literal["step", "event"]
Fires = Literal["above", "reached"]
Scaling = Literal["full", "binary"]
StepRounding = Literal["nearest", "truncate"]
ResetAt = Literal["spike", "leak"]
Queue = Literal["off", "on"]
QueueHost = Literal["wait", "step"]


@dataclass(frozen=True)
class IntegrateAndFireRules:
    """Rules and registers of integrate-and-fire neurons without a synaptic current.

    weight_bits: of a weight; with the sign, or of the magnitude where axons have the sign.
    signs: what has a sign of its own: each "weight", or each "axon" for all its weights.
    axon_types: an axon is of one of so many types, and a neuron has one weight for each; 0 where
        every synapse has a weight of its own.
    bias_bits: with the sign, of what a neuron adds in each timestep; 0 where a bias has to be the
        weight of an axon that spikes in every timestep.
    leak: what a membrane loses in each timestep: nothing ("none"), the same amount toward 0 at
        which it stops ("linear") or which it may step over ("crossing"), or itself shifted right,
        rounded down ("shift").
    leak_bits: of that amount, or of that shift.
    leak_order: whether a timestep begins with the leak ("first"), or spikes come before it.
    membrane: the state.
    floor: below which no membrane falls; None leaves it to its register.
    floors: what a convention may want as floor instead, as in Convention.
    adds: whether the membrane takes in all spikes of a "step" as one sum, or each "event" by
        itself, saturating every time.
    checks: when the threshold is looked at: at the end of the "step", or after each "event", of
        which a leak that comes first is one.
    fires: whether a neuron fires where its membrane is "above" the threshold, or at it too
        ("reached").
    threshold_bits: of a threshold, unsigned.
    spikes_max: spikes of a neuron in a timestep.
    scaling: what floats are multiplied with to become whole: as much as fits ("full"), or the
        largest power of two that fits ("binary").
    rounding: how the chip's own tools round, where nothing else is wanted.
    reset_at: whether a neuron is reset with its "spike", or in the next timestep in place of the
        "leak", and then its spikes leave one timestep later.
    queue: whether neurons' spikes go through the queue on the chip and reach others in the same
        timestep ("on"), or the host relays them, layer by layer ("off").
    queue_entries: of that queue, the event that is being worked on included; 0 is no queue.
    host: with the queue on, whether the host sends an event when the chip is idle ("wait"), or the
        events of a timestep as fast as the chip takes them ("step").
    """

    weight_bits: int
    signs: Signs
    axon_types: int
    bias_bits: int
    leak: Leak
    leak_bits: int
    leak_order: LeakOrder
    membrane: Register
    floor: int | None
    floors: tuple[str, ...]
    adds: Moment
    checks: Moment
    fires: Fires
    threshold_bits: int
    spikes_max: int
    scaling: Scaling
    rounding: StepRounding
    reset_at: ResetAt = "spike"
    queue: Queue = "off"
    queue_entries: int = 0
    host: QueueHost = "wait"

    def __post_init__(self) -> None:
        least = 2 if self.signs == "weight" else 1
        if not least <= self.weight_bits <= 16:
            raise ChipError(f"weight_bits is {self.weight_bits}; choose {least} to 16.")
        if not 1 <= self.spikes_max <= 255:
            raise ChipError(f"spikes_max is {self.spikes_max}; choose 1 to 255.")
        if self.floor is not None and self.floor > 0:
            raise ChipError(f"floor is {self.floor}; membranes start from 0. Choose 0 or less.")
        if self.checks == "event" and self.adds == "step":
            raise ChipError(
                "checks is 'event' and adds 'step': where all spikes are one sum, there is no "
                "event to look after. Choose adds 'event', or checks 'step'."
            )
        self._check_order()

    def _check_order(self) -> None:
        """Refuse a late reset, or a queue, that the other rules leave no place for."""
        rules = self.leak_order, self.checks, self.spikes_max
        if self.reset_at == "leak" and rules != ("first", "step", 1):
            raise ChipError(
                "reset_at is 'leak': a reset in place of the leak needs leak_order 'first', checks "
                "'step' and spikes_max 1. Choose those, or reset_at 'spike'."
            )
        if not 0 <= self.queue_entries <= 1 << 16:
            raise ChipError(f"queue_entries is {self.queue_entries}; choose 0 to {1 << 16}.")
        if self.queue == "off":
            return
        if not self.queue_entries:
            raise ChipError("queue is 'on', and the chip's queue has no entries. Choose odin.")
        if (self.leak_order, self.checks) != ("first", "event"):
            raise ChipError(
                "queue is 'on': it holds single events, and needs leak_order 'first' and checks "
                "'event'. Choose those, or queue 'off'."
            )

    @property
    def weight_range(self) -> tuple[int, int]:
        """Least and largest weight."""
        if self.signs == "axon":
            most = (1 << self.weight_bits) - 1
            return -most, most
        return _signed(self.weight_bits)

    @property
    def bias_range(self) -> tuple[int, int]:
        """Least and largest bias, in whichever way neurons get one."""
        return _signed(self.bias_bits) if self.bias_bits else self.weight_range

    @property
    def threshold_max(self) -> int:
        """Largest threshold that a membrane can reach, or be above."""
        reach = self.membrane.limit - (self.fires == "above")
        return min((1 << self.threshold_bits) - 1, reach)

    @property
    def leak_max(self) -> int:
        """Largest amount or shift."""
        return min((1 << self.leak_bits) - 1, self.membrane.limit)


def _signed(bits: int) -> tuple[int, int]:
    half = 1 << (bits - 1)
    return -half, half - 1


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
    """Mask of the membranes (B, N) that reach, or pass, the threshold."""
    # fires where V >= threshold, or V > threshold
    return np.asarray(v >= layer.threshold if rules.fires == "reached" else v > layer.threshold)


def _after_spike(convention: Convention, layer: Layer, v: Integers) -> Numbers | int:
    # V = V - threshold, or V = 0
    return v - layer.threshold if convention.reset == "subtract" else layer.v_reset
