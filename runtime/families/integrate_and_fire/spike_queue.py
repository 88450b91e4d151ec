"""A timestep of ODIN and tinyODIN with their on-chip queue of spikes, event by event.

All neurons share one crossbar: every event reaches each of them. Events wait in one queue, those
from the host as well as neurons' own spikes, and are processed in the order in which they came;
spikes of one event by the index of the neuron. The event that is processed keeps its entry until it
is done. A spike that finds the queue full is lost; the host waits. A time reference is not queued.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState, Network, Numbers, StepResult
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.integrate_and_fire.neurons import (
    Integers,
    IntegrateAndFireRules,
    PartialStep,
    add,
    begin,
)

# the time reference, an event from the host, one on the axon of all biases, a neuron's own spike
EventKind = Literal["tref", "axon", "bias", "neuron"]
Event = tuple[EventKind, int]
TREF: Event = ("tref", 0)
# events of a timestep; neurons that keep each other spiking never leave the chip idle
_ENDLESS = 1 << 14


@dataclass(frozen=True, eq=False)
class CrossbarNeurons:
    """All neurons of a crossbar and what reaches them.

    neurons: all layers side by side, as one without synapses.
    weights: kind of an event -> (M, N) what one of that index adds.
    entries: of the queue; 0 where neurons' spikes are not queued.
    muted: (N,) neurons whose spikes are seen nowhere.
    """

    rules: IntegrateAndFireRules
    convention: Convention
    neurons: Layer
    weights: Mapping[str, Integers]
    entries: int
    muted: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class EventResult:
    """The effect of one event.

    membrane: (N,) after it.
    spikes: neurons that spiked in it, by index.
    lost: those of them whose spikes found the queue full.
    overflows, arrived: (N,) as in PartialStep.
    """

    event: Event
    membrane: Integers
    spikes: tuple[int, ...]
    lost: tuple[int, ...]
    overflows: Integers
    arrived: NDArray[np.bool_]


class Crossbar:
    """State of one copy of the neurons.

    wired: the neurons that it is a copy of.
    membrane: (N,) now.
    done: events processed so far.
    most: events that it may process.
    """

    def __init__(self, wired: CrossbarNeurons, membrane: Integers, most: int = _ENDLESS) -> None:
        self.most = most
        self.membrane = membrane
        self.done: list[EventResult] = []
        self.wired = wired
        self._queue: deque[Event] = deque()

    def timestep(self, sent: Iterable[Event], waits: bool, drains: bool = True) -> None:
        """A time reference, and the events that the host sends after it.

        waits: the host sends each event when the chip is idle; else as fast as it takes them, and
            then one event is processed between any two.
        drains: all events are processed in the end.
        """
        advance = self.drain if waits else self.process_next
        self.time_reference()
        advance()
        for event in sent:
            self._make_room()
            self._queue.append(event)
            advance()
        if drains:
            self.drain()

    def time_reference(self) -> None:
        """Let all neurons leak; no queued event comes before it, unless the queue is full."""
        self._make_room()
        self.process(TREF, entries_held=0)

    def drain(self) -> None:
        """Process events until none is queued."""
        while self._queue:
            self.process_next()

    def process_next(self) -> None:
        """Process the first event in the queue, if there is one."""
        if self._queue:
            self.process(self._queue.popleft(), entries_held=1)

    def process(self, event: Event, entries_held: int = 1) -> None:
        """Process an event, which occupies some entries meanwhile, and queue the spikes."""
        if len(self.done) >= self.most:
            raise RuleError(
                f"rule queue: the chip is not done after {self.most} events. Weaken recurrent "
                "neurons that keep each other spiking, choose queue=off, or record a shorter run."
            )
        wired, now = self.wired, PartialStep.from_membrane(self.membrane[None])
        if event == TREF:
            begin(wired.rules, wired.convention, wired.neurons, now)
        else:
            weights = wired.weights[event[0]][event[1]]
            add(wired.rules, wired.convention, wired.neurons, weights, now)
        self.membrane = now.membrane[0]
        spikes = np.flatnonzero((now.spikes[0] > 0) & ~wired.muted).tolist()
        room = max(0, wired.entries - len(self._queue) - entries_held)
        self._queue.extend(("neuron", neuron) for neuron in spikes[:room])
        result = EventResult(
            event=event,
            membrane=self.membrane,
            spikes=tuple(spikes),
            lost=tuple(spikes[room:]) if wired.entries else (),
            overflows=now.overflows[0],
            arrived=now.arrived[0],
        )
        self.done.append(result)

    def _make_room(self) -> None:
        entries = self.wired.entries
        while entries and len(self._queue) >= entries:
            self.process_next()


def update_together(
    rules: IntegrateAndFireRules,
    network: Network,
    presynaptic: Mapping[str, Sequence[Numbers]],
    states: Mapping[str, LayerState],
) -> dict[str, StepResult]:
    """Advance all layers by one timestep, in which these spikes (B, M) of the input arrive.

    presynaptic: layer -> spikes through each of its synapses; those of neurons are in the queue.
    """
    wired, ways = _wire(rules, network.convention, network.layers, network.input)
    before = np.concatenate([states[layer.name].membrane for layer in network.layers], axis=1)
    inputs = np.concatenate([presynaptic[name][place] for name, place in ways], axis=1)
    spikes, overflows, lost = (np.zeros_like(before) for _ in range(3))
    total = PartialStep(before.copy(), spikes, overflows, np.zeros(before.shape, np.bool_))
    for copy in range(len(before)):
        crossbar = Crossbar(wired, before[copy])
        crossbar.timestep(_list_events(wired, inputs[copy]), rules.host == "wait")
        total.membrane[copy] = crossbar.membrane
        for done in crossbar.done:
            total.spikes[copy, list(done.spikes)] += 1
            lost[copy, list(done.lost)] += 1
            total.overflows[copy] += done.overflows
            total.arrived[copy] |= done.arrived
    return _by_layer(rules, network, states, before, total, lost)


def _list_events(wired: CrossbarNeurons, counts: Numbers) -> list[Event]:
    """Events that the host sends in a timestep: inputs by index, and the biases at last."""
    biases: list[Event] = [("bias", 0)] if "bias" in wired.weights else []
    return [*axons(counts), *biases]


def axons(counts: Numbers) -> list[Event]:
    """The events of a timestep by the index of their axon, from counts (M,)."""
    return [("axon", int(m)) for m in np.repeat(np.arange(len(counts)), counts)]


def _by_layer(
    rules: IntegrateAndFireRules,
    network: Network,
    states: Mapping[str, LayerState],
    before: Integers,
    total: PartialStep,
    lost: Integers,
) -> dict[str, StepResult]:
    results, at = {}, 0
    for layer in network.layers:
        own = slice(at, at := at + layer.size)
        states[layer.name].membrane = total.membrane[:, own].copy()
        spikes = np.minimum(total.spikes[:, own], rules.spikes_max)
        uncounted = total.spikes[:, own] - spikes
        active = (before[:, own] != 0) | total.arrived[:, own]
        overflows = total.overflows[:, own] + uncounted
        results[layer.name] = StepResult(spikes, active, overflows, lost[:, own])
    return results


@lru_cache(maxsize=8)
def _wire(
    rules: IntegrateAndFireRules, convention: Convention, layers: tuple[Layer, ...], source: str
) -> tuple[CrossbarNeurons, tuple[tuple[str, int], ...]]:
    """The layers as one crossbar; and which synapses, by layer and place, bring the input.

    Inputs that arrive after different delays are axons of their own.
    """
    starts = np.cumsum([0, *(layer.size for layer in layers)]).tolist()
    columns = dict(zip((a.name for a in layers), starts, strict=False))
    rows: dict[int, Integers] = {}
    ways: dict[int, tuple[str, int]] = {}
    recurrent = np.zeros((starts[-1], starts[-1]), np.int64)
    for layer in layers:
        onto = slice(columns[layer.name], columns[layer.name] + layer.size)
        for place, synapses in enumerate(layer.synapses):
            weight = synapses.dense("a queue").weight.astype(np.int64)
            if synapses.source == source:
                ways.setdefault(synapses.delay, (layer.name, place))
                empty = np.zeros((len(weight), starts[-1]), np.int64)
                rows.setdefault(synapses.delay, empty)[:, onto] += weight
            else:
                at = columns[synapses.source]
                recurrent[at : at + len(weight), onto] += weight
    bias = np.concatenate([layer.bias + layer.voltage_bias for layer in layers])
    weights = {"axon": np.concatenate([rows[d] for d in ways]), "neuron": recurrent}
    if bias.any():
        weights["bias"] = bias[None].astype(np.int64)
    wired = CrossbarNeurons(
        rules=rules,
        convention=convention,
        neurons=_merge(layers),
        weights=weights,
        entries=rules.queue_entries,
        muted=np.zeros(starts[-1], np.bool_),
    )
    return wired, tuple(ways.values())


def _merge(layers: Sequence[Layer]) -> Layer:
    """The neurons of all layers as one, without synapses."""
    return replace(
        layers[0],
        synapses=(),
        threshold=np.concatenate([layer.threshold for layer in layers]),
        membrane_decay=np.concatenate([layer.membrane_decay for layer in layers]),
    )
