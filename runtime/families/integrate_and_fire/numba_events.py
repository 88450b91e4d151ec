"""The compiled kernel of a layer and its queue of events, equal to `events.process_queue`."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Numbers, Synapses
from spikedeploy.runtime.families import numba_frame as frame
from spikedeploy.runtime.families.integrate_and_fire.event_queues import (
    EventLayer,
    EventQueue,
    EventState,
    OrderedSpikes,
    window_of,
)
from spikedeploy.runtime.families.numba_frame import Array, Number
from spikedeploy.runtime.families.numba_pipeline import describe, edges

# entries of Arrays.rules
LOW, HIGH, SINGLE, SUBTRACT, MOST, CHANNELS_FIRST, EACH = range(7)

# spikes for which there is room at first; more where one event may cause more
_ROOM = 1 << 14


class Arrays(NamedTuple):
    """A layer as the kernel takes it.

    wires: (P, 16) a row for each of its synapses, columns as of Wiring, of which some are not used.
    weights: (W,) by channel of the source; elements of the kernel inside the channels of the
        target where spikes leave channel after channel, outside where place after place.
    tables: (R,) position that a row, or column, reaches by each element of a kernel; or -1.
    threshold, floor: (N,) where neurons differ, else (1,).
    rules: entries above.
    """

    wires: Array
    weights: Array
    tables: Array
    threshold: Array
    floor: Array
    rules: Array


@lru_cache(maxsize=64)
def arrays(each: EventLayer) -> tuple[Arrays, int]:
    """A layer as arrays, and the spikes that one event can cause in it."""
    rules, layer = each.rules, each.layer
    channels_first = rules.event_order == "cyx"
    wires = np.zeros((len(layer.synapses), len(frame.WIRE)), np.int64)
    weights: list[Numbers] = []
    tables: list[Numbers] = []
    for wire, synapses in zip(wires, layer.synapses, strict=True):
        wire[frame.WEIGHT] = sum(map(len, weights))
        wire[frame.SOURCE_Y :] = describe(window_of(synapses), tables)
        weights.append(_ordered_weights(synapses, channels_first))
    same = bool(
        (layer.threshold == layer.threshold[0]).all() and (each.floor == each.floor[0]).all()
    )
    kept = slice(0, 1 if same else None)
    low, high = edges(rules.membrane) or (0, 0)
    several = 1
    if rules.event_spikes == "multi":
        several = min(rules.spikes_max, max(high // max(int(layer.threshold.min()), 1), 1))
    fan_out = max(_fan_out(synapses) for synapses in layer.synapses)
    single, subtract = rules.event_spikes == "single", each.convention.reset == "subtract"
    table = [low, high, single, subtract, rules.spikes_max, channels_first, not same]
    made = Arrays(
        wires,
        np.concatenate(weights),
        np.concatenate(tables),
        layer.threshold[kept].astype(np.int64),
        each.floor[kept],
        np.array(table, np.int64),
    )
    return made, fan_out * several


def _ordered_weights(synapses: Synapses, channels_first: bool) -> Numbers:
    """The kernel by channel of the source, (C, O / G, ky, kx), or (C, ky, kx, O / G), in a row."""
    groups = window_of(synapses).groups
    parted = synapses.weight.reshape(groups, -1, *synapses.weight.shape[1:])
    moved = parted.transpose(0, 2, 1, 3, 4) if channels_first else parted.transpose(0, 2, 3, 4, 1)
    return np.ravel(moved)


def _fan_out(synapses: Synapses) -> int:
    """Neurons that an event can reach, zeros in the kernel included."""
    window = window_of(synapses)
    rows, columns = ((places >= 0).sum(axis=1).max(initial=0) for places in window.reach)
    return int(rows * columns) * (window.target[0] // window.groups)


def process_queue(each: EventLayer, queue: EventQueue, state: EventState) -> OrderedSpikes:
    """Work on the queue of a layer, event after event; return its spikes."""
    layer, most = arrays(each)
    cause, neuron = _rows(max(_ROOM, most))
    causes: list[NDArray[np.int64]] = []
    neurons: list[NDArray[np.int64]] = []
    first = 0
    while first < len(queue.axon):
        done, sent = process_events(
            *layer, *queue, state.membrane, state.touched, state.overflows, cause, neuron, first,
            len(cause) - most,
        )  # fmt: skip
        first = done
        causes.append(cause[:sent].copy())
        neurons.append(neuron[:sent].copy())
    if not causes:
        return OrderedSpikes(*_rows(0))
    return OrderedSpikes(np.concatenate(causes), np.concatenate(neurons))


def _rows(size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return np.empty(size, np.int64), np.empty(size, np.int64)


@frame.kept_on_disk
def process_events(
    wires: Array,
    weights: Array,
    tables: Array,
    threshold: Array,
    floor: Array,
    rules: Array,
    causes: Array,
    places: Array,
    axons: Array,
    membrane: Array,
    touched: Array,
    overflows: Array,
    sent_causes: Array,
    sent: Array,
    first: Number,
    room: Number,
) -> Any:  # noqa: ANN401
    """Events from `first` on, until all are done or more than `room` spikes were sent.

    Returns the number of the first event that was not processed, and the spikes sent.
    """
    layer = Arrays(wires, weights, tables, threshold, floor, rules)
    count = 0
    for event in range(first, len(axons)):
        if count > room:
            return event, count
        wire = wires[places[event]]
        channel, rows, columns = frame.locate(wire, axons[event])
        features, height, width = wire[frame.FEATURES], wire[frame.KERNEL_Y], wire[frame.KERNEL_X]
        begin = wire[frame.WEIGHT] + channel * features * height * width
        # neuron of the first feature of the group at the place (0, 0), and neurons of a feature
        size = wire[frame.TARGET_Y] * wire[frame.TARGET_X]
        target = channel // wire[frame.CHANNELS] * features * size
        was = count
        # one of the two loops over features runs once
        outer, inner = (features, 1) if rules[CHANNELS_FIRST] else (1, features)
        for first_feature in range(outer):
            for ky in range(height - 1, -1, -1):
                row = tables[rows + ky]
                if row < 0:
                    continue
                for kx in range(width - 1, -1, -1):
                    column = tables[columns + kx]
                    if column < 0:
                        continue
                    element = (first_feature * height + ky) * width + kx
                    place = row * wire[frame.TARGET_X] + column
                    for more in range(inner):
                        neuron = target + (first_feature + more) * size + place
                        weight = weights[begin + element * inner + more]
                        n = touch(layer, neuron, weight, membrane, touched, overflows)
                        for _ in range(n):
                            sent[count] = neuron
                            count += 1
        for spike in range(was, count):
            sent_causes[spike] = causes[event]
    return len(axons), count


@frame.jit
def touch(
    layer: Arrays, neuron: Number, weight: Number, membrane: Array, touched: Array, overflows: Array
) -> Number:
    """Add a weight to a membrane; return how often the neuron spikes."""
    rules = layer.rules
    raised = membrane[neuron] + weight
    v = min(max(raised, rules[LOW]), rules[HIGH])
    threshold = layer.threshold[neuron * rules[EACH]]
    floor = layer.floor[neuron * rules[EACH]]
    touched[neuron] += 1
    if v != raised:
        overflows[neuron] += 1
    n = 0
    if v >= threshold:
        n = 1
        if not rules[SINGLE]:
            wanted = v // threshold if threshold > 0 else rules[MOST]
            n = min(wanted, rules[MOST])
            overflows[neuron] += wanted - n
        v = v - n * threshold if rules[SUBTRACT] else 0
    membrane[neuron] = max(v, floor)
    return n
