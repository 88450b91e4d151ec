"""Recorded runs of ODIN and tinyODIN, from simulations of their RTL, replayed event by event."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import plain_layer
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules
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
    Difference,
    Verdict,
    assumptions,
    count_numbers,
    first_difference,
    nothing_to_compare,
    recorded_tables,
    source_of,
    unread_fields,
)

_NEURONS = "neurons"  # name of the one layer
_ROWS = 256  # of the crossbar, of axons and of neurons
_HOSTS = ("wait", "step", "stream", "relays")
_ORDERS = ("index", "random")
_SPELLINGS = {"v": "membrane", "s": "spikes", "threshold": "thr"}
# given twice in the file, or by the weights
_REPEATED = {
    "reset",
    "leak_str",
    "leak_en",
    "inhibitory_axons",
    "inhibitory_neurons",
    "relayed_from_neuron",
}
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
# effects of events one after another, and the timestep of each
_Replayed: TypeAlias = tuple[list[WorkedEvent], list[int]]


def crossbar_verdict(fields: Fields, chip: str) -> Verdict:
    """Compare the chip's neurons with a recorded run, event by event and in timesteps."""
    spec = fields.merged_with(fields.group("params")).spelled(_SPELLINGS)
    rules = datasheet(chip).arithmetic
    if not isinstance(rules, IntegrateAndFire):
        raise spec.wrong("chip", f"{chip} has no crossbar of events", "Name odin or tinyodin.")
    counts = spec.table("input_spikes", least=0, most=255)
    timesteps, width = counts.shape
    if width > _ROWS:
        remedy = f"A crossbar has {_ROWS} at most."
        raise spec.wrong("input_spikes", f"has {width} axons", remedy)
    host, order = spec.choice("host", _HOSTS), spec.choice("order", _ORDERS)
    wired, start = _read_crossbar(spec, rules, width, host)
    work = Work(spec, timesteps)
    work.add(len(start), 0)
    work.check_input(counts)
    events = _read_events(spec, timesteps, width, len(start))
    sent = _read_sent(spec, counts, events, order)
    tables = {_NEURONS: recorded_tables(spec, (timesteps, len(start)))}
    unread = unread_fields([spec], _REPEATED)
    if events is None and not tables[_NEURONS]:
        raise nothing_to_compare(fields, unread)
    crossbar = Crossbar(wired, start, most=MOST_NUMBERS // len(start))
    (done, steps), remarks = _replay(spec, events, crossbar, sent, host)
    ends = {_NEURONS: _in_timesteps(done, steps, timesteps, len(start))}
    found = [None if events is None else events.first_difference(done, steps)]
    found.append(first_difference(tables, ends))
    return Verdict(
        chip=chip,
        source=source_of(fields, chip),
        steps=timesteps,
        compared=count_numbers(tables) + (0 if events is None else events.compared),
        passed_over=0,
        why="",
        # of one timestep that of an event
        difference=min(filter(None, found), key=lambda each: each.step or 0, default=None),
        unread=unread,
        remarks=(*assumptions({_NEURONS: spec}, chip), *remarks),
    )


def _read_crossbar(
    spec: Fields, rules: IntegrateAndFireRules, width: int, host: str
) -> tuple[CrossbarNeurons, Integers]:
    """The neurons, and their membranes before the first event."""
    axon = _read_weights(spec, "weights", rules)
    if len(axon) != width:
        raise spec.wrong("weights", f"has {len(axon)} rows", f"Write {width}, one for each input.")
    size = axon.shape[1]
    weights = {"axon": axon, "neuron": np.zeros((size, size), np.int64)}
    if spec.has_content("weights_rec"):
        weights["neuron"] = _read_weights(spec, "weights_rec", rules)
    if size > _ROWS or weights["neuron"].shape != (size, size):
        found = f"are for {size} neurons and {weights['neuron'].shape}"
        raise spec.wrong("weights and weights_rec", found, f"Write up to {_ROWS} and a square.")
    closed = spec.flag("closed_loop", False)
    if closed and host == "relays":
        raise spec.wrong("host", "relays in a closed loop", "Write closed_loop false, or wait.")
    spec.choice("reset", ("zero",))
    # tinyODIN has one bit of a threshold more than a membrane can reach
    most = (1 << (rules.threshold_bits + (rules.signs == "weight"))) - 1
    threshold = spec.row("thr", size=size, least=0, most=most)
    leak = spec.row("leak", size=size, default=0, least=0, most=rules.leak_max)
    low, high = (0 if rules.floor == 0 else -rules.membrane.limit - 1), rules.membrane.limit
    wired = CrossbarNeurons(
        rules=rules,
        convention=Convention(1e-3, source="the trace"),
        neurons=replace(plain_layer(_NEURONS, (), threshold), membrane_decay=leak),
        weights=weights,
        entries=rules.queue_entries if closed else 0,
        muted=spec.row("disabled", size=size, default=0, least=0, most=1) > 0,
    )
    return wired, spec.row("start", size=size, default=0, least=low, most=high)


def _read_weights(spec: Fields, name: str, rules: IntegrateAndFireRules) -> Integers:
    """(M, N)."""
    spec.refuse_axes("index", r"^\[post\]")
    low, high = rules.weight_range
    found = spec.array(name, axes=2, least=low, most=high)
    if found.ndim < 2:
        raise spec.wrong(name, f"has shape {found.shape}", "Write [pre][post].")
    return found


@dataclass(frozen=True, eq=False)
class _Events:
    """Events in the order in which a chip worked on them, E of them.

    events, steps: what they are, and the timestep of each.
    membranes: (E, N) after each; None where they were not recorded, as the next two.
    spikes: (E, N) of neurons that spiked in each.
    lost: (E, N) those of them whose spikes the full queue lost.
    """

    events: list[Event]
    steps: list[int]
    membranes: Integers | None
    spikes: Integers | None
    lost: Integers | None

    @property
    def compared(self) -> int:
        """Numbers that a comparison looks at: events, membranes, spikes and losses of each."""
        membranes = 0 if self.membranes is None else self.membranes.size
        each = 1 + (self.spikes is not None) + (self.lost is not None)
        return membranes + len(self.events) * each

    def first_difference(self, done: Sequence[WorkedEvent], steps: list[int]) -> Difference | None:
        """The first event that was another one, or did something else."""
        both = min(len(self.events), len(done))
        pairs = zip(self.events, self.steps, (each.event for each in done), steps, strict=False)
        others = (p for p, (event, t, other, u) in enumerate(pairs) if (event, t) != (other, u))
        other = next(others, None)
        recorded = {
            "membrane": self.membranes,
            "spikes": self.spikes,
            "lost spikes": self.lost,
        }
        tables = {name: rows[:both] for name, rows in recorded.items() if rows is not None}
        inside = first_difference({"": tables}, {"": _effects(done[:both])})
        if inside is not None and (other is None or (inside.step or 0) < other):
            return self._at(inside.step or 0, inside)
        if other is not None:
            words = (
                _describe_event(self.steps[other], self.events[other]),
                _describe_event(steps[other], done[other].event),
            )
            return self._at(other, Difference(None, None, None, "event", *words))
        if len(self.events) == len(done):
            return None
        lengths = len(self.events), len(done)
        return self._at(both - 1, Difference(None, None, None, "events in all", *lengths))

    def _at(self, place: int, difference: Difference) -> Difference:
        """The difference with the timestep and the name of its event."""
        kind, index = self.events[place]
        name = f"event {place} ({kind})" if kind == "tref" else f"event {place} ({kind} {index})"
        return replace(difference, step=self.steps[place], layer=name)


def _describe_event(step: int, event: Event) -> str:
    kind, index = event
    return f"{kind} of step {step}" if kind == "tref" else f"{kind} {index} of step {step}"


def _effects(done: Sequence[WorkedEvent]) -> dict[str, Integers]:
    size = len(done[0].membrane) if done else 0
    return {
        "membrane": np.array([each.membrane for each in done]).reshape(len(done), size),
        "spikes": _mark([each.spikes for each in done], size),
        "lost spikes": _mark([each.lost for each in done], size),
    }


def _mark(rows: Sequence[Sequence[int]], size: int) -> Integers:
    """(E, N) of 1 for the neurons of each list."""
    marked = np.zeros((len(rows), size), np.int64)
    for row, neurons in zip(marked, rows, strict=True):
        row[list(neurons)] = 1
    return marked


def _in_timesteps(
    done: Sequence[WorkedEvent], steps: Sequence[int], timesteps: int, size: int
) -> dict[str, Integers]:
    membrane, spikes = (np.zeros((timesteps, size), np.int64) for _ in range(2))
    for step, event in zip(steps, done, strict=True):
        membrane[step] = event.membrane
        spikes[step, list(event.spikes)] += 1
    return {"membrane": membrane, "spikes": spikes}


def _read_events(spec: Fields, timesteps: int, width: int, size: int) -> _Events | None:
    if "events" not in spec:
        return None
    most = {"tref": 1, "axon": width, "neuron": size}
    found = [
        _event(spec, place, row, timesteps, most) for place, row in enumerate(spec.rows("events"))
    ]
    steps, events = [step for step, _ in found], [event for _, event in found]
    references = [place for place, event in enumerate(events) if event == TREF]
    # each timestep begins with its time reference
    begins = [p for p, step in enumerate(steps) if not p or step != steps[p - 1]]
    if steps != sorted(steps) or [steps[p] for p in references] != list(range(timesteps)):
        remedy = f"Write one tref at the beginning of each of {timesteps} timesteps, in order."
        raise spec.wrong("events", "are not divided into timesteps", remedy)
    if begins != references:
        raise spec.wrong("events", "have a timestep that does not begin with tref", "Move it.")
    membranes = spikes = lost = None
    if "v_event" in spec:
        membranes = spec.array("v_event", axes=2, least=-1 << 16, most=1 << 16)
        if membranes.shape != (len(events), size):
            remedy = f"Write {len(events), size}."
            raise spec.wrong("v_event", f"has shape {membranes.shape}", remedy)
    if "s_event" in spec:
        rows = spec.lists("s_event", least=0, most=size - 1)
        if len(rows) != len(events):
            remedy = f"Write {len(events)}, one an event."
            raise spec.wrong("s_event", f"has {len(rows)} lists", remedy)
        spikes = _mark(rows, size)
    if "dropped_by_full_fifo" in spec:
        lost = _read_lost(spec, len(events), size)
    return _Events(events, steps, membranes, spikes, lost)


def _event(
    spec: Fields,
    place: int,
    row: Any,  # noqa: ANN401
    timesteps: int,
    most: dict[str, int],
) -> tuple[int, Event]:
    """The timestep and the event of a row such as [0, "tref"] or [3, "axon", 7]."""
    wanted = "Write [timestep, 'tref'], [timestep, 'axon', m] or [timestep, 'neuron', n]."
    if not isinstance(row, list) or len(row) not in (2, 3) or row[1] not in [*most]:
        raise spec.wrong("events", f"has {str(row)[:40]!r} at {place}", wanted)
    step, kind, index = (*row, 0)[:3]
    known = type(step) is int and type(index) is int and (len(row) == 2) == (kind == "tref")
    if not known or not 0 <= step < timesteps or not 0 <= index < most[kind]:
        raise spec.wrong("events", f"has {str(row)[:40]!r} at {place}, out of range", wanted)
    return step, (kind, index)


def _read_lost(spec: Fields, events: int, size: int) -> Integers:
    """(E, N) of the neurons whose spikes the full queue lost."""
    lost = np.zeros((events, size), np.int64)
    for row in spec.rows("dropped_by_full_fifo"):
        pair = isinstance(row, list) and len(row) == 2 and isinstance(row[1], list)
        inside = pair and all(type(n) is int and 0 <= n < size for n in row[1])
        if not inside or type(row[0]) is not int or not 0 <= row[0] < events:
            remedy = "Write [place of the event, [neurons]]."
            raise spec.wrong("dropped_by_full_fifo", f"has {str(row)[:40]!r}", remedy)
        lost[row[0], row[1]] = 1
    return lost


def _read_sent(
    spec: Fields, counts: Integers, events: _Events | None, order: str
) -> list[list[Event]]:
    """Events that the host sends in each timestep: by index, or in their recorded order."""
    sent = [axons(row) for row in counts]
    if events is None:
        if order == "random":
            raise spec.wrong("order", "is 'random'", "Add the events in their order.")
        return sent
    recorded = deque(event for event in events.events if event[0] == "axon")
    if len(recorded) != counts.sum():
        raise spec.wrong("events", f"has {len(recorded)} of axons", f"Inputs have {counts.sum()}.")
    in_order = [[recorded.popleft() for _ in row] for row in sent]
    for t, (row, expected) in enumerate(zip(in_order, sent, strict=True)):
        if (row if order == "index" else sorted(row)) != expected:
            found = f"has other axons than input_spikes in timestep {t}, or another order"
            raise spec.wrong("events", found, "Write each input where it was worked on.")
    return in_order


def _replay(
    spec: Fields, events: _Events | None, crossbar: Crossbar, sent: list[list[Event]], host: str
) -> tuple[_Replayed, list[str]]:
    """The effect of every event, and remarks on how it was replayed."""
    again = Crossbar(replace(crossbar.wired, entries=0), crossbar.membrane, crossbar.most)
    if host == "relays":
        if events is None:
            raise spec.wrong("host", "relays", "Add the events in the order of the host.")
        _check_relayed(spec, events)
        return _replay_as_recorded(events, again), [_AS_SENT]
    done, steps = _replay_as_modelled(crossbar, sent, host)
    if events is None or host == "wait" or [d.event for d in done] == events.events:
        lost_too = events is not None and events.lost is not None
        return (done, steps), [_STREAMED + _LOST_TOO * lost_too] if host == "stream" else []
    # the handshake of another host took other turns with the queue
    _check_queued(spec, events, crossbar.wired.entries > 0)
    return _replay_as_recorded(events, again), [_OTHER_TURNS]


def _replay_as_modelled(crossbar: Crossbar, sent: list[list[Event]], host: str) -> _Replayed:
    """The events that the host sends, worked on as the chip does."""
    steps, last = list[int](), len(sent) - 1
    for t, events in enumerate(sent):
        crossbar.timestep(events, host == "wait", settles=host != "stream" or t == last)
        steps += [t] * (len(crossbar.done) - len(steps))
    # while a queue is full, events of a timestep come before the time reference of the next
    references = np.cumsum([done.event == TREF for done in crossbar.done]) - 1
    return crossbar.done, references.tolist() if host == "stream" else steps


def _replay_as_recorded(events: _Events, crossbar: Crossbar) -> _Replayed:
    for event in events.events:
        crossbar.work(event)
    return crossbar.done, events.steps


def _check_relayed(spec: Fields, events: _Events) -> None:
    """Refuse spikes of neurons that nobody sent, where spikes were recorded."""
    if events.spikes is None:
        return
    sent = np.zeros(events.spikes.shape[1], np.int64)
    for (kind, index), spikes in zip(events.events, events.spikes, strict=True):
        if kind == "neuron":
            sent[index] -= 1
            if sent[index] < 0:
                found = f"has more of neuron {index} than it spiked"
                raise spec.wrong("events", found, "Write what the host sent back.")
        sent += spikes


def _check_queued(spec: Fields, events: _Events, has_queue: bool) -> None:
    """Refuse spikes of neurons in another order than that of the queue, where it can be told."""
    if events.spikes is None:
        return
    queue = deque[int]()
    kept = events.spikes if events.lost is None else events.spikes & ~events.lost
    for (kind, index), spikes in zip(events.events, kept, strict=True):
        if kind == "neuron" and (not queue or queue.popleft() != index):
            found = f"has neuron {index} where its spike is not the first in the queue"
            raise spec.wrong("events", found, "Write the events in the order of the chip.")
        if has_queue:
            queue.extend(np.flatnonzero(spikes).tolist())
