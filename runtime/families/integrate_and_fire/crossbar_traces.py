"""Recorded runs of ODIN and tinyODIN, from simulations of their RTL, once more event by event."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.recorded_events import (
    RecordedEvents,
    events_of,
)
from spikedeploy.runtime.families.integrate_and_fire.rules import IntegrateAndFireRules
from spikedeploy.runtime.families.integrate_and_fire.spike_queue import (
    TREF,
    Crossbar,
    CrossbarNeurons,
    Event,
    WorkedEvent,
    axons,
)
from spikedeploy.runtime.traces.fields import MOST_NUMBERS, Fields, Integers, Work
from spikedeploy.runtime.traces.verify import (
    PROSE,
    Verdict,
    first_difference,
    nothing_to_compare,
    recorded_tables,
    table_of,
    weights_of,
)

_NEURONS = "neurons"  # name of the one layer
# quantity -> its name in the file, and what it may be
_TABLES = {"membrane": ("v", -1 << 16, 1 << 20), "spikes": ("s", 0, 1 << 20)}
_HOSTS = ("wait", "step", "stream", "relays")
_ORDERS = ("index", "random")
_ROWS = 256  # of the crossbar, of axons and of neurons
# given twice in the file, or by the weights
_REPEATED = {
    "chip", "params", "steps", "reset", "leak_str", "leak_en", "inhibitory_axons",
    "inhibitory_neurons", "relayed_from_neuron",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Recorded:
    """A recorded run.

    wired: the neurons as the file describes them.
    start: (N,) membranes before the first event.
    sent: what the host sends in each timestep, in its order.
    host: how, one of _HOSTS.
    events: as the chip worked on them; None where the file does not say.
    tables: quantity -> (T, N) at the end of each timestep.
    """

    wired: CrossbarNeurons
    start: Integers
    sent: Sequence[Sequence[Event]]
    host: str
    events: RecordedEvents | None
    tables: dict[str, Integers]


def crossbar_verdict(fields: Fields, chip: str) -> Verdict:
    """Whether the neurons of the chip do what the file says, event by event and in timesteps."""
    spec = fields.under(fields.group("params"))
    recorded = _recorded(spec, chip)
    unread = spec.unread - PROSE - _REPEATED
    if recorded.events is None and not recorded.tables:
        raise nothing_to_compare(fields, unread, "v, s, v_event or s_event")
    done, steps, remarks = _replayed(spec, recorded)
    difference = None if recorded.events is None else recorded.events.first(done, steps)
    found = _in_timesteps(done, steps, len(recorded.sent), len(recorded.start))
    of_tables = first_difference({_NEURONS: recorded.tables}, {_NEURONS: found}, {})
    if difference is None or (of_tables and (of_tables.step or 0) < (difference.step or 0)):
        difference = of_tables
    compared = 0 if recorded.events is None else recorded.events.compared
    return Verdict(
        chip=chip,
        source=fields.text("source") or fields.text("name") or chip,
        steps=len(recorded.sent),
        compared=compared + sum(table.size for table in recorded.tables.values()),
        passed_over=0,
        why="",
        difference=difference,
        unread=tuple(sorted(unread)),
        remarks=tuple(remarks),
    )


def _recorded(spec: Fields, chip: str) -> _Recorded:
    rules = datasheet(chip).arithmetic
    if not isinstance(rules, IntegrateAndFire):
        raise spec.wrong("chip", f"{chip} has no crossbar of events", "Name odin or tinyodin.")
    counts = table_of(spec, ("input_spikes",), 0, 255, index="input_spikes_index")
    if counts.shape[1] > _ROWS:
        found = f"has {counts.shape[1]} axons"
        raise spec.wrong("input_spikes", found, f"A crossbar has {_ROWS} at most.")
    host, order = _choice(spec, "host", _HOSTS), _choice(spec, "order", _ORDERS)
    wired, start = _wired(spec, rules, counts.shape[1], host)
    size = len(start)
    work = Work(spec, len(counts))
    work.add(size, 0)
    work.check_input(counts)
    events = events_of(spec, (len(counts), counts.shape[1], size))
    return _Recorded(
        wired=wired,
        start=start,
        sent=_sent(spec, counts, events, order),
        host=host,
        events=events,
        tables=recorded_tables(spec, _TABLES, (len(counts), size)),
    )


def _choice(spec: Fields, name: str, choices: tuple[str, ...]) -> str:
    found = spec.text(name) or choices[0]
    if found not in choices:
        raise spec.wrong(name, f"is {found[:40]!r}", f"Write one of {', '.join(choices)}.")
    return found


def _wired(
    spec: Fields, rules: IntegrateAndFireRules, width: int, host: str
) -> tuple[CrossbarNeurons, Integers]:
    """The neurons, and their membranes before the first event."""
    axon = weights_of(spec, "weights", *rules.weight_range)
    if len(axon) != width:
        raise spec.wrong("weights", f"has {len(axon)} rows", f"Write {width}, one for each input.")
    size = axon.shape[1]
    weights = {"axon": axon, "neuron": np.zeros((size, size), np.int64)}
    if spec.name("weights_rec"):
        weights["neuron"] = weights_of(spec, "weights_rec", *rules.weight_range)
    if size > _ROWS or weights["neuron"].shape != (size, size):
        found = f"are for {size} neurons and {weights['neuron'].shape}"
        raise spec.wrong("weights and weights_rec", found, f"Write up to {_ROWS} and a square.")
    closed = spec.flag("closed_loop") or False
    if closed and host == "relays":
        raise spec.wrong("host", "relays in a closed loop", "Write closed_loop false, or wait.")
    low, high = (0 if rules.floor == 0 else -rules.membrane.limit - 1), rules.membrane.limit
    wired = CrossbarNeurons(
        rules=rules,
        convention=Convention(1e-3, source="the trace"),
        neurons=_neurons(spec, rules, size),
        weights=weights,
        entries=rules.queue_entries if closed else 0,
        muted=spec.row("disabled", size=size, default=0, least=0, most=1) > 0,
    )
    return wired, spec.row("start", size=size, default=0, least=low, most=high)


def _neurons(spec: Fields, rules: IntegrateAndFireRules, size: int) -> Layer:
    if (reset := spec.text("reset") or "zero") != "zero":
        raise spec.wrong("reset", f"is {reset[:40]!r}", "Neurons of the chip are reset to zero.")
    none = np.zeros(size, np.int64)
    # tinyODIN has one bit of a threshold more than a membrane can reach
    most = (1 << (rules.threshold_bits + (rules.signs == "weight"))) - 1
    return Layer(
        name=_NEURONS,
        synapses=(),
        bias=none,
        voltage_bias=none,
        threshold=spec.row("thr", "threshold", size=size, least=0, most=most),
        current_decay=none,
        membrane_decay=spec.row("leak", size=size, default=0, least=0, most=rules.leak_max),
        scale=1.0,
        start=0,
    )


def _sent(
    spec: Fields, counts: Integers, events: RecordedEvents | None, order: str
) -> list[list[Event]]:
    """What the host sends in each timestep: by index, or in the order of the recorded events."""
    sent = [axons(row) for row in counts]
    if events is None:
        if order == "random":
            raise spec.wrong("order", "is 'random'", "Add the events in their order.")
        return sent
    heard = deque(event for event in events.events if event[0] == "axon")
    if len(heard) != counts.sum():
        raise spec.wrong("events", f"has {len(heard)} of axons", f"Inputs have {counts.sum()}.")
    in_order = [[heard.popleft() for _ in row] for row in sent]
    for t, (row, expected) in enumerate(zip(in_order, sent, strict=True)):
        if (row if order == "index" else sorted(row)) != expected:
            found = f"has other axons than input_spikes in timestep {t}, or another order"
            raise spec.wrong("events", found, "Write each input where it was worked on.")
    return in_order


def _replayed(spec: Fields, recorded: _Recorded) -> tuple[list[WorkedEvent], list[int], list[str]]:
    """What every event did, the timestep of each, and remarks on how it was replayed."""
    events, host = recorded.events, recorded.host
    if host == "relays":
        if events is None:
            raise spec.wrong("host", "relays", "Add the events in the order of the host.")
        _check_relayed(spec, events, recorded.wired)
        return *_as_recorded(recorded, events), [_AS_SENT]
    done, steps = _as_modelled(recorded)
    if events is None or host == "wait" or [d.event for d in done] == events.events:
        return done, steps, _streamed(events) if host == "stream" else []
    # the handshake of another host took other turns with the queue
    _check_queued(spec, events, recorded.wired)
    return *_as_recorded(recorded, events), [_OTHER_TURNS]


_AS_SENT = "events are replayed in the order in which the host sent them"
_STREAMED = (
    "the host never waits, so a timestep ends at the next time reference, which overtakes what is "
    "queued"
)
_LOST_TOO = "; compared event by event, lost spikes included"
_OTHER_TURNS = (
    "not compared: which events took turns with the queue, and which spikes it lost; the events "
    "are replayed in the recorded order"
)


def _streamed(events: RecordedEvents | None) -> list[str]:
    lost_too = events is not None and "dropped_by_full_fifo" in events.compares
    return [_STREAMED + _LOST_TOO * lost_too]


def _as_modelled(recorded: _Recorded) -> tuple[list[WorkedEvent], list[int]]:
    """What the chip does with what the host sends."""
    crossbar, steps = _crossbar(recorded, recorded.wired), list[int]()
    waits, last = recorded.host == "wait", len(recorded.sent) - 1
    for t, sent in enumerate(recorded.sent):
        crossbar.timestep(sent, waits, settles=recorded.host != "stream" or t == last)
        steps += [t] * (len(crossbar.done) - len(steps))
    # while a queue is full, events of a timestep come before the time reference of the next
    references = np.cumsum([done.event == TREF for done in crossbar.done]) - 1
    return crossbar.done, references.tolist() if recorded.host == "stream" else steps


def _crossbar(recorded: _Recorded, wired: CrossbarNeurons) -> Crossbar:
    return Crossbar(wired, recorded.start, most=MOST_NUMBERS // len(recorded.start))


def _as_recorded(
    recorded: _Recorded, events: RecordedEvents
) -> tuple[list[WorkedEvent], list[int]]:
    """What the events do one after another, as they were recorded."""
    crossbar = _crossbar(recorded, replace(recorded.wired, entries=0))
    for event in events.events:
        crossbar.work(event)
    return crossbar.done, events.steps


def _check_relayed(spec: Fields, events: RecordedEvents, wired: CrossbarNeurons) -> None:
    """Refuse spikes of neurons that nobody sent, where spikes were recorded."""
    if "s_event" not in events.compares:
        return
    sent = np.zeros(len(wired.muted), np.int64)
    for (kind, index), spikes in zip(events.events, events.spikes, strict=True):
        if kind == "neuron":
            sent[index] -= 1
            if sent[index] < 0:
                found = f"has more of neuron {index} than it spiked"
                raise spec.wrong("events", found, "Write what the host sent back.")
        sent[list(spikes)] += 1


def _check_queued(spec: Fields, events: RecordedEvents, wired: CrossbarNeurons) -> None:
    """Refuse spikes of neurons in another order than that of the queue, where it can be told."""
    if "s_event" not in events.compares:
        return
    queue = deque[int]()
    each = zip(events.events, events.spikes, events.lost, strict=True)
    for (kind, index), spikes, lost in each:
        if kind == "neuron" and (not queue or queue.popleft() != index):
            found = f"has neuron {index} where its spike is not the first in the queue"
            raise spec.wrong("events", found, "Write the events in the order of the chip.")
        if wired.entries:
            queue.extend(neuron for neuron in spikes if neuron not in lost)


def _in_timesteps(
    done: Sequence[WorkedEvent], steps: Sequence[int], timesteps: int, size: int
) -> dict[str, Integers]:
    """Quantity -> (T, N) of the events at the end of each timestep."""
    membrane, spikes = (np.zeros((timesteps, size), np.int64) for _ in range(2))
    for step, event in zip(steps, done, strict=True):
        membrane[step] = event.membrane
        spikes[step, list(event.spikes)] += 1
    return {"membrane": membrane, "spikes": spikes}
