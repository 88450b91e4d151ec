"""Speck event by event: each layer works on its queue of events, one event after another.

The specification. For each event (c, y, x) in the queue of a layer:

    1. Its coordinates are divided by those of the pool; what lies in the rows and columns left over
       is lost. A pool has no counter.
    2. It reaches neurons through their kernels, weights of 0 included. No other is touched, not
       even one above its threshold.
    3. V = V + w                               as the register holds it
       where V >= threshold: one spike, V = V - threshold or V = 0
                                               "multi": V / threshold spikes without a fraction
       V = max(V, floor)
    4. The spikes leave in the order "cyx", channel after channel, or "yxc", place after place;
       several of a neuron follow one another. They are the queue of the next layer.

One spike for an event is the rule that SynSense documents (sinabs 3.1.3,
docs/speck/faqs/tips_for_training.md, Weight Clipping During Training), several are what sinabs'
layers send for one event a call. No source says in which order spikes leave; it is
assumed. A layer with two sources takes what an event of the network caused in the one, then in the
other, which is assumed too. In a chain it is the same whether events go through all layers one by
one, as on the chip, or layer by layer, as here.

Fully connected layers are kernels as large as their input, so that an event reaches all of them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import (
    Layer,
    LayerState,
    Network,
    Numbers,
    StepResult,
    Synapses,
)
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.integrate_and_fire.neurons import (
    Integers,
    IntegrateAndFireRules,
    fires,
    floor_of,
)


class OrderedSpikes(NamedTuple):
    """Spikes of a layer, or events of the input, in their order.

    cause: (n,) place of the event of the network's input that each follows from.
    neuron: (n,) in C order of the layer.
    """

    cause: Integers
    neuron: Integers


class EventQueue(NamedTuple):
    """Events that a layer works on, in their order.

    cause: (n,) as in OrderedSpikes.
    place: (n,) number of the synapses of the layer that bring each.
    axon: (n,) of those synapses.
    """

    cause: Integers
    place: Integers
    axon: Integers


@dataclass(frozen=True, eq=False)
class EventLayer:
    """A layer as its events see it.

    layer: with windows for all synapses.
    rank: (N,) place of each neuron in the order in which spikes of an event leave.
    floor: (N,) below which membranes do not fall.
    """

    layer: Layer
    rules: IntegrateAndFireRules
    convention: Convention
    rank: Integers
    floor: Integers


@dataclass(eq=False)
class EventState:
    """A layer while events arrive.

    membrane: (N,) [state units].
    touched: (N,) events so far that reached each neuron.
    overflows: (N,) numbers so far that did not fit, and spikes that were too many for an event.
    """

    membrane: Integers
    touched: Integers
    overflows: Integers

    @classmethod
    def from_membrane(cls, membrane: Integers) -> "EventState":
        """The state before the first event."""
        membrane = membrane.astype(np.int64)
        return cls(membrane, np.zeros_like(membrane), np.zeros_like(membrane))


# spikes of a layer that works on its queue; `process_queue` below, or its compiled twin
ProcessQueue: TypeAlias = Callable[[EventLayer, EventQueue, EventState], OrderedSpikes]


def process_queue(each: EventLayer, queue: EventQueue, state: EventState) -> OrderedSpikes:
    """Work on the queue of a layer, event after event; return its spikes."""
    causes: list[Integers] = []
    neurons: list[Integers] = []
    for cause, place, axon in zip(*queue, strict=True):
        synapses = each.layer.synapses[place]
        reached, weights = window_of(synapses).row(synapses.weight, axon)
        counts = _add(each, reached, weights.astype(np.int64), state)
        firing = reached[counts > 0]
        spikes = np.repeat(firing, counts[counts > 0])
        neurons.append(spikes[np.argsort(each.rank[spikes], kind="stable")])
        causes.append(np.full(len(spikes), cause, np.int64))
    if not causes:
        return OrderedSpikes(np.zeros(0, np.int64), np.zeros(0, np.int64))
    return OrderedSpikes(np.concatenate(causes), np.concatenate(neurons))


def _add(each: EventLayer, reached: Integers, weights: Integers, state: EventState) -> Integers:
    """Add weights (k,) to the membranes of neurons (k,); return how often each spikes."""
    rules, threshold = each.rules, each.layer.threshold[reached]
    # V = V + w, as the register holds it
    raised = state.membrane[reached] + weights
    v = rules.membrane.fit(raised)
    wanted = fires(rules, threshold, v).astype(np.int64)
    if rules.event_spikes == "multi":
        # n = V / threshold without a fraction; of a threshold of 0 as many as there can be
        wanted *= np.where(threshold > 0, v // np.maximum(threshold, 1), rules.spikes_max)
    n = np.minimum(wanted, rules.spikes_max)
    # V = V - n threshold, or V = 0;  V = max(V, floor)
    subtract = each.convention.reset == "subtract"
    after = v - n * threshold if subtract else np.where(n > 0, 0, v)
    state.membrane[reached] = np.maximum(after, each.floor[reached])
    state.touched[reached] += 1
    state.overflows[reached] += (v != raised) + (wanted - n)
    return n


def window_of(synapses: Synapses) -> Window:
    """The window of synapses that `wire` gave one."""
    if synapses.window is None:
        raise TypeError("synapses without a window take no events")
    return synapses.window


# layers, one after another


class EventNetwork:
    """The layers of a program with their states, of one copy of it.

    layers: as events see them.
    states: of each layer.
    """

    def __init__(
        self, rules: IntegrateAndFireRules, network: Network, process: ProcessQueue = process_queue
    ) -> None:
        self.layers = wire(rules, network.convention, network.layers)
        self._input, self._process_queue = network.input, process
        self.states = {
            e.layer.name: EventState.from_membrane(np.zeros(e.layer.size, np.int64))
            for e in self.layers
        }

    def process(self, events: OrderedSpikes) -> dict[str, OrderedSpikes]:
        """Spikes of each layer that follow from events of the input."""
        sent = {self._input: events}
        for each in self.layers:
            queue = _join([sent[s.source] for s in each.layer.synapses])
            sent[each.layer.name] = self._process_queue(each, queue, self.states[each.layer.name])
        del sent[self._input]
        return sent


def _join(sources: Sequence[OrderedSpikes]) -> EventQueue:
    """The queue of a layer; what an event of the input caused in each source, one after another."""
    place = np.repeat(np.arange(len(sources)), [len(each.cause) for each in sources])
    cause = np.concatenate([each.cause for each in sources])
    axon = np.concatenate([each.neuron for each in sources])
    if len(sources) == 1:
        return EventQueue(cause, place, axon)
    turn = np.argsort(cause, kind="stable")
    return EventQueue(cause[turn], place[turn], axon[turn])


@lru_cache(maxsize=8)
def wire(
    rules: IntegrateAndFireRules, convention: Convention, layers: tuple[Layer, ...]
) -> tuple[EventLayer, ...]:
    """The layers as events see them."""
    found = []
    for layer in layers:
        windowed = replace(layer, synapses=tuple(map(as_window, layer.synapses)))
        floor = np.broadcast_to(floor_of(rules, convention, layer), (layer.size,))
        rank = ranks(shape_of(windowed), rules.event_order)
        found.append(EventLayer(windowed, rules, convention, rank, floor.astype(np.int64)))
    return tuple(found)


def as_window(synapses: Synapses) -> Synapses:
    """The synapses with a window; a matrix (M, N) is a kernel as large as its input."""
    if synapses.window:
        return synapses
    axons, neurons = synapses.shape
    window = Window((axons, 1, 1), (neurons, 1, 1), (1, 1))
    return replace(synapses, weight=synapses.weight.T[:, :, None, None], window=window)


def shape_of(layer: Layer) -> tuple[int, int, int]:
    """(C, Y, X) of a layer, by the first of its windows."""
    return window_of(layer.synapses[0]).target


@lru_cache(maxsize=64)
def ranks(shape: tuple[int, int, int], order: str) -> Integers:
    """(N,) place of each neuron (C, Y, X) in the order in which spikes of an event leave."""
    places = np.arange(np.prod(shape)).reshape(shape)
    found = places.ravel() if order == "cyx" else np.argsort(places.transpose(1, 2, 0).ravel())
    found.setflags(write=False)
    return found


# timesteps: events of a timestep in the order in which spikes leave


def update_by_events(
    rules: IntegrateAndFireRules,
    network: Network,
    presynaptic: Mapping[str, Sequence[Numbers]],
    states: Mapping[str, LayerState],
    process: ProcessQueue = process_queue,
) -> dict[str, StepResult]:
    """Advance all layers by one timestep, whose spikes (B, M) of the input are single events."""
    name, place = next(
        (layer.name, place)
        for layer in network.layers
        for place, synapses in enumerate(layer.synapses)
        if synapses.source == network.input
    )
    counts = presynaptic[name][place]
    done = {
        layer.name: StepResult(*(np.zeros((len(counts), layer.size), np.int64) for _ in range(3)))
        for layer in network.layers
    }
    working = EventNetwork(rules, network, process)
    source = next(e for e in working.layers if e.layer.name == name).layer.synapses[place]
    rank = ranks(window_of(source).source, rules.event_order)
    for state in states.values():
        # what was there before is kept in recordings
        state.membrane = state.membrane.copy()
    for copy, row in enumerate(counts):
        for layer, before in states.items():
            working.states[layer] = EventState.from_membrane(before.membrane[copy])
        some = np.flatnonzero(row)
        some = some[np.argsort(rank[some])]
        axons = np.repeat(some, row[some])
        sent = working.process(OrderedSpikes(np.zeros(len(axons), np.int64), axons))
        for layer, after in working.states.items():
            states[layer].membrane[copy] = after.membrane
            spikes = np.bincount(sent[layer].neuron, minlength=len(after.membrane))
            result = done[layer]
            # of a neuron's spikes in a timestep a raster holds so many
            result.spikes[copy] = np.minimum(spikes, rules.spikes_max)
            result.active[copy] = after.touched
            result.overflows[copy] = after.overflows + (spikes - result.spikes[copy])
    return done
