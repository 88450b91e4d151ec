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
EventOrder = Literal["none", "cyx", "yxc"]
EventSpikes = Literal["single", "multi"]


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
    event_order: in which the spikes of one event leave where each layer has a queue of its own, as
        in `events`; "none" is one queue for all neurons.
    event_spikes: with such queues, whether a neuron sends one spike for an event ("single"), or as
        many as the threshold fits into its membrane ("multi").
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
    event_order: EventOrder = "none"
    event_spikes: EventSpikes = "single"

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
        """Refuse a late reset, or a queue, that contradicts the other rules."""
        rules = self.leak_order, self.checks, self.spikes_max
        if self.reset_at == "leak" and rules != ("first", "step", 1):
            raise ChipError(
                "reset_at is 'leak': a reset in place of the leak needs leak_order 'first', checks "
                "'step' and spikes_max 1. Choose those, or reset_at 'spike'."
            )
        if not 0 <= self.queue_entries <= 1 << 16:
            raise ChipError(f"queue_entries is {self.queue_entries}; choose 0 to {1 << 16}.")
        if self.event_order != "none" and (self.leak, self.reset_at) != ("none", "spike"):
            raise ChipError(
                f"event_order is {self.event_order!r}: events have no timesteps to leak in. Choose "
                "leak 'none' and reset_at 'spike', or event_order 'none'."
            )
        if self.queue == "off" or self.by_events:
            return
        if not self.queue_entries:
            raise ChipError("queue is 'on', and the chip's queue has no entries. Choose odin.")
        if (self.leak_order, self.checks) != ("first", "event"):
            raise ChipError(
                "queue is 'on': it holds single events, and needs leak_order 'first' and checks "
                "'event'. Choose those, or queue 'off'."
            )

    @property
    def by_events(self) -> bool:
        """True where each layer works on its queue of events, and `adds` and `checks` are idle."""
        return self.queue == "on" and self.event_order != "none"

    @property
    def weight_max(self) -> int:
        """Largest weight."""
        return self.weight_range[1]

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
    def from_membrane(cls, membrane: Integers) -> "PartialStep":
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
    before, now = state.membrane, PartialStep.from_membrane(state.membrane)
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
        state.membrane = np.where(fires(rules, layer.threshold, v), after, state.membrane)
    if rules.checks == "event" and rules.leak != "none":
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
        total = total + synapses.sums(spikes).astype(np.int64)
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
        for axon in np.flatnonzero(counts.any(axis=0)):
            reached, weight = synapses.row(int(axon))
            for nth in range(counts[:, axon].max()):
                arrives = (counts[:, axon] > nth)[:, None] & reached
                add(rules, convention, layer, arrives * weight, state, arrives)
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
    """Add weights (N,) or (B, N) as one event; `arrives` says (B, N) where."""
    # V = V + W s, as the register holds it, and not below the floor
    raised = state.membrane + weights
    held = rules.membrane.fit(raised)
    state.overflows = state.overflows + (held != raised)
    kept = np.maximum(held, floor_of(rules, convention, layer))
    state.membrane = np.where(arrives, kept, state.membrane)
    state.arrived = state.arrived | (weights != 0)
    if rules.checks == "event":
        _fire(rules, convention, layer, state, arrives)


def floor_of(rules: IntegrateAndFireRules, convention: Convention, layer: Layer) -> Integers:
    """Return the lower bound of membranes (N,); without one, a number below every register."""
    if layer.floor is not None:
        return np.asarray(layer.floor, np.int64)
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
    """Spikes of the membranes that an event reached; several at once only at the end of a step.

    Each takes the threshold off; where a spike resets to 0, several only if the convention says so.
    """
    subtract = convention.reset == "subtract"
    several = rules.checks == "step" and (subtract or convention.spikes == "many")
    left = state.membrane
    for _ in range(rules.spikes_max if several else 1):
        v = state.membrane
        firing = fires(rules, layer.threshold, v if subtract else left) & arrives
        if not firing.any():
            break
        left = left - layer.threshold
        if rules.reset_at == "spike":
            state.membrane = np.where(firing, _after_spike(convention, layer, v), v)
        spikes = state.spikes + firing
        state.spikes = np.minimum(spikes, rules.spikes_max)
        state.overflows = state.overflows + (spikes - state.spikes)


def fires(rules: IntegrateAndFireRules, threshold: Numbers, v: Integers) -> NDArray[np.bool_]:
    """Mask of the membranes (..., N) that reach, or pass, the threshold."""
    # fires where V >= threshold, or V > threshold
    return np.asarray(v >= threshold if rules.fires == "reached" else v > threshold)


def _after_spike(convention: Convention, layer: Layer, v: Integers) -> Numbers | int:
    # V = V - threshold, or V = 0
    return v - layer.threshold if convention.reset == "subtract" else layer.v_reset
