"""Recorded runs of ODIN and tinyODIN, from simulations of their RTL, replayed event by event."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

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
    EventResult,
    axons,
)
from spikedeploy.runtime.traces.fields import Fields, Integers
from spikedeploy.runtime.traces.verdict import (
    MOST_NUMBERS,
    TraceDifference,
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
_MOST_EVENTS = 1 << 18  # that are replayed
_HOSTS = ("wait", "step", "stream", "relays")
_ORDERS = ("index", "random")
_SPELLINGS = {"v": "membrane", "s": "spikes", "threshold": "thr"}
# given twice in the file, or by the weights
_REPEATED = {
    "reset", "leak_str", "leak_en", "inhibitory_axons", "inhibitory_neurons", "relayed_from_neuron",
}  # fmt: skip
_AS_SENT = "events are replayed in the order in which the host sent them"
_STREAMED = (
    "the host never waits, so a timestep ends at the next time reference, which overtakes what is "
    "queued"
)
_LOST_TOO = "; compared event by event, lost spikes included"


def crossbar_verdict(fields: Fields, chip: str) -> Verdict:
    """Compare the chip's neurons with a recorded run, event by event and in timesteps."""
    spec = fields.merged_with(fields.group("params")).spelled(_SPELLINGS)
    counts = spec.table("input_spikes", least=0, most=255)
    timesteps, width = counts.shape
    host, order = spec.choice("host", _HOSTS, "wait"), spec.choice("order", _ORDERS, "index")
    wired, start = _read_crossbar(spec, chip, width, host)
    recorded = _read_events(spec, timesteps, width, len(start))
    sent = _read_sent(spec, counts, recorded, order)
    tables = {_NEURONS: recorded_tables(spec, (timesteps, len(start)))}
    unread = unread_fields([spec], _REPEATED)
    if recorded is None and not tables[_NEURONS]:
        raise nothing_to_compare(fields, unread)
    crossbar = Crossbar(wired, start, most=min(_MOST_EVENTS, MOST_NUMBERS // len(start)))
    remarks = list(assumptions({_NEURONS: spec}, chip))
    if host == "relays":
        if recorded is None:
            raise spec.wrong("host", "relays", "Add the events in the order of the host.")
        for event in recorded.events:
            crossbar.process(event)
        steps = recorded.steps
        remarks.append(_AS_SENT)
    else:
        steps = _process(crossbar, sent, host)
        if host == "stream":
            is_told = recorded is not None and "lost spikes" in recorded.tables
            remarks.append(_STREAMED + _LOST_TOO * is_told)
    done = crossbar.done
    ends = {_NEURONS: _in_timesteps(done, steps, timesteps, len(start))}
    found = [first_difference(tables, ends)]
    if recorded is not None:
        found.insert(0, recorded.first_difference(done, steps))
    return Verdict(
        chip=chip,
        source=source_of(fields, chip),
        steps=timesteps,
        compared=count_numbers(tables) + (recorded.compared if recorded else 0),
        passed_over=0,
        why="",
        # of one timestep that of an event
        difference=min(filter(None, found), key=lambda each: each.step or 0, default=None),
        unread=unread,
        remarks=tuple(remarks),
    )


def _process(crossbar: Crossbar, sent: list[list[Event]], host: str) -> list[int]:
    """Give the chip the events that the host sends; the timestep of each that it processed."""
    steps, last = list[int](), len(sent) - 1
    for t, events in enumerate(sent):
        crossbar.timestep(events, host == "wait", drains=host != "stream" or t == last)
        steps += [t] * (len(crossbar.done) - len(steps))
    # while a queue is full, events of a timestep come before the time reference of the next
    references = np.cumsum([done.event == TREF for done in crossbar.done]) - 1
    return references.tolist() if host == "stream" else steps


def _in_timesteps(
    done: Sequence[EventResult], steps: Sequence[int], timesteps: int, size: int
) -> dict[str, Integers]:
    membrane, spikes = (np.zeros((timesteps, size), np.int64) for _ in range(2))
    for step, event in zip(steps, done, strict=True):
        membrane[step] = event.membrane
        spikes[step, list(event.spikes)] += 1
    return {"membrane": membrane, "spikes": spikes}


@dataclass(frozen=True, eq=False)
class _Events:
    """Events in the order in which a chip processed them, E of them.

    events, steps: what they are, and the timestep of each.
    tables: those of "membrane", "spikes" and "lost spikes" (E, N) that were recorded.
    """

    events: list[Event]
    steps: list[int]
    tables: dict[str, Integers]

    @property
    def compared(self) -> int:
        """Numbers that a comparison looks at: events, membranes, spikes and losses of each."""
        rows = (t.size if name == "membrane" else len(t) for name, t in self.tables.items())
        return len(self.events) + sum(rows)

    def first_difference(
        self, done: Sequence[EventResult], steps: list[int]
    ) -> TraceDifference | None:
        """The first event that was another one, or did something else."""
        mine = list(zip(self.steps, self.events, strict=True))
        ours = [(step, each.event) for step, each in zip(steps, done, strict=True)]
        pairs = enumerate(zip_longest(mine, ours))
        place = next((p for p, (one, other) in pairs if one != other), None)
        tables = {name: rows[:place] for name, rows in self.tables.items()}
        found = first_difference({"": tables}, {"": _effects(done[:place])})
        if found is None and place is not None:
            words = (_describe_event(each, place) for each in (mine, ours))
            found = TraceDifference(place, None, None, "event", *words)
        if found is None:
            return None
        at = min(found.step or 0, len(mine) - 1)
        kind, index = self.events[at]
        name = f"event {at} ({kind})" if kind == "tref" else f"event {at} ({kind} {index})"
        return replace(found, step=self.steps[at], layer=name)


def _describe_event(events: list[tuple[int, Event]], place: int) -> str:
    if place >= len(events):
        return "none"
    step, (kind, index) = events[place]
    return f"{kind} of step {step}" if kind == "tref" else f"{kind} {index} of step {step}"


def _effects(done: Sequence[EventResult]) -> dict[str, Integers]:
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


# reading


def _read_crossbar(
    spec: Fields, chip: str, width: int, host: str
) -> tuple[CrossbarNeurons, Integers]:
    """The neurons, and their membranes before the first event."""
    rules = datasheet(chip).arithmetic
    if not isinstance(rules, IntegrateAndFire):
        raise TypeError(type(rules).__name__)
    axon = _read_weights(spec, "weights", rules)
    size = axon.shape[1]
    if len(axon) != width:
        raise spec.wrong("weights", f"has {len(axon)} rows", f"Write {width}, one for each input.")
    weights = {"axon": axon, "neuron": np.zeros((size, size), np.int64)}
    if spec.has_content("weights_rec"):
        weights["neuron"] = _read_weights(spec, "weights_rec", rules)
    if max(size, width) > _ROWS or weights["neuron"].shape != (size, size):
        found = f"are for {width} axons, {size} neurons and {weights['neuron'].shape}"
        raise spec.wrong("weights and weights_rec", found, f"Write up to {_ROWS} and a square.")
    closed = spec.flag("closed_loop", False)
    if closed and host == "relays":
        raise spec.wrong("host", "relays in a closed loop", "Write closed_loop false, or wait.")
    spec.choice("reset", ("zero",), "zero")
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


def _read_events(spec: Fields, timesteps: int, width: int, size: int) -> _Events | None:
    if "events" not in spec:
        return None
    most = {"tref": 1, "axon": width, "neuron": size}
    rows = spec.rows("events")
    found = [_event(spec, place, row, timesteps, most) for place, row in enumerate(rows)]
    steps, events = [step for step, _ in found], [event for _, event in found]
    begins = [p for p, step in enumerate(steps) if not p or step != steps[p - 1]]
    references = [place for place, event in enumerate(events) if event == TREF]
    if begins != references or [steps[p] for p in references] != list(range(timesteps)):
        remedy = f"Write one tref at the beginning of each of {timesteps} timesteps, in order."
        raise spec.wrong("events", "are not divided into timesteps", remedy)
    tables: dict[str, Integers] = {}
    if "v_event" in spec:
        membranes = spec.array("v_event", axes=2, least=-1 << 16, most=1 << 16)
        if membranes.shape != (len(events), size):
            remedy = f"Write {len(events), size}."
            raise spec.wrong("v_event", f"has shape {membranes.shape}", remedy)
        tables["membrane"] = membranes
    if "s_event" in spec:
        spiking = spec.lists("s_event", count=len(events), most=size - 1)
        tables["spikes"] = _mark(spiking, size)
    if "dropped_by_full_fifo" in spec:
        tables["lost spikes"] = _read_lost(spec, len(events), size)
    return _Events(events, steps, tables)


def _event(
    spec: Fields,
    place: int,
    row: Any,  # noqa: ANN401
    timesteps: int,
    most: dict[str, int],
) -> tuple[int, Event]:
    """The timestep and the event of a row such as [0, "tref"] or [3, "axon", 7]."""
    if isinstance(row, list) and len(row) in (2, 3) and row[1] in [*most]:
        step, kind, index = (*row, 0)[:3]
        known = type(step) is int and type(index) is int and (len(row) == 2) == (kind == "tref")
        if known and 0 <= step < timesteps and 0 <= index < most[kind]:
            return step, (kind, index)
    wanted = "Write [timestep, 'tref'], [timestep, 'axon', m] or [timestep, 'neuron', n]."
    raise spec.wrong("events", f"has {str(row)[:40]!r} at {place}, out of range", wanted)


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
    spec: Fields, counts: Integers, recorded: _Events | None, order: str
) -> list[list[Event]]:
    """Events that the host sends in each timestep: by index, or in their recorded order."""
    sent = [axons(row) for row in counts]
    if recorded is None:
        if order == "random":
            raise spec.wrong("order", "is 'random'", "Add the events in their order.")
        return sent
    queue = deque(event for event in recorded.events if event[0] == "axon")
    if len(queue) != counts.sum():
        raise spec.wrong("events", f"has {len(queue)} of axons", f"Inputs have {counts.sum()}.")
    in_order = [[queue.popleft() for _ in row] for row in sent]
    for t, (row, expected) in enumerate(zip(in_order, sent, strict=True)):
        if (row if order == "index" else sorted(row)) != expected:
            found = f"has other axons than input_spikes in timestep {t}, or another order"
            raise spec.wrong("events", found, "Write each input where it was processed.")
    return in_order
