"""The events of a recorded run of a crossbar, read from a file and compared one by one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spikedeploy.runtime.families.integrate_and_fire.spike_queue import Event, WorkedEvent
from spikedeploy.runtime.traces.fields import Fields, Integers
from spikedeploy.runtime.traces.verify import Difference

_KINDS = ("tref", "axon", "neuron")  # of events in a file


@dataclass(frozen=True, eq=False)
class RecordedEvents:
    """Events in the order in which a chip worked on them, E of them.

    events: what they are.
    steps: timestep of each.
    membranes: (E, N) after each; None where they were not recorded.
    spikes: neurons that spiked in each, by index; empty where not recorded.
    lost: those of them whose spikes the full queue lost.
    compares: names of the tables that are there: v_event, s_event, dropped_by_full_fifo.
    """

    events: list[Event]
    steps: list[int]
    membranes: Integers | None
    spikes: Sequence[tuple[int, ...]]
    lost: Sequence[tuple[int, ...]]
    compares: frozenset[str]

    @property
    def compared(self) -> int:
        """Numbers that a comparison looks at: events, membranes, spikes and losses of each."""
        each = ("s_event", "dropped_by_full_fifo")
        membranes = 0 if self.membranes is None else self.membranes.size
        return membranes + len(self.events) * (1 + sum(name in self.compares for name in each))

    def first(self, done: Sequence[WorkedEvent], steps: Sequence[int]) -> Difference | None:
        """The first event that was another one, or did something else."""
        for place, (event, found) in enumerate(zip(self.events, done, strict=False)):
            if event != found.event or self.steps[place] != steps[place]:
                expected = _said(self.steps[place], event)
                return self._differs(
                    place, None, "event", expected, _said(steps[place], found.event)
                )
            if (difference := self._inside(place, found)) is not None:
                return difference
        if len(self.events) == len(done):
            return None
        place = min(len(self.events), len(done)) - 1
        return self._differs(place, None, "events in all", len(self.events), len(done))

    def _inside(self, place: int, found: WorkedEvent) -> Difference | None:
        """What of one event differs: membranes, then spikes, then losses."""
        if self.membranes is not None:
            expected = self.membranes[place]
            if (wrong := np.flatnonzero(expected != found.membrane)).size:
                n = int(wrong[0])
                values = int(expected[n]), int(found.membrane[n])
                return self._differs(place, n, "membrane", *values)
        for name, quantity, mine, theirs in (
            ("s_event", "spikes", self.spikes[place], found.spikes),
            ("dropped_by_full_fifo", "lost spikes", self.lost[place], found.lost),
        ):
            if name in self.compares and mine != theirs:
                n = min(set(mine) ^ set(theirs))
                return self._differs(place, n, quantity, int(n in mine), int(n in theirs))
        return None

    def _differs(
        self,
        place: int,
        neuron: int | None,
        quantity: str,
        expected: int | str,
        found: int | str,
    ) -> Difference:
        kind, index = self.events[place]
        name = f"event {place} ({kind})" if kind == "tref" else f"event {place} ({kind} {index})"
        return Difference(self.steps[place], name, neuron, quantity, expected, found)


def _said(step: int, event: Event) -> str:
    kind, index = event
    return f"{kind} of step {step}" if kind == "tref" else f"{kind} {index} of step {step}"


def events_of(spec: Fields, shape: tuple[int, int, int]) -> RecordedEvents | None:
    """The events in the fields; None where there are none.

    shape: timesteps, axons and neurons.
    """
    timesteps, _, size = shape
    if spec.name("events") is None:
        return None
    found = [_event(spec, place, row, shape) for place, row in enumerate(spec.rows("events"))]
    steps = [step for step, _ in found]
    references = [step for step, (kind, _) in found if kind == "tref"]
    if references != list(range(timesteps)) or steps != sorted(steps) or found[0][1][0] != "tref":
        remedy = f"Write one tref at the beginning of each of {timesteps} timesteps, in order."
        raise spec.wrong("events", "are not divided into timesteps", remedy)
    if any(found[place][1][0] != "tref" for place in _changes(steps)):
        raise spec.wrong("events", "have a timestep that does not begin with tref", "Move it.")
    compares = {n for n in ("s_event", "dropped_by_full_fifo") if spec.name(n)}
    return RecordedEvents(
        events=[event for _, event in found],
        steps=steps,
        membranes=_membranes(spec, len(found), size),
        spikes=_spikes(spec, len(found), size),
        lost=_lost(spec, len(found), size),
        compares=frozenset(compares),
    )


def _changes(steps: Sequence[int]) -> list[int]:
    """Places where another timestep begins."""
    return [p for p in range(1, len(steps)) if steps[p] != steps[p - 1]]


def _event(spec: Fields, place: int, row: Any, shape: tuple[int, int, int]) -> tuple[int, Event]:  # noqa: ANN401
    """The timestep and the event of a row such as [0, "tref"] or [3, "axon", 7]."""
    timesteps, width, size = shape
    most = {"tref": 1, "axon": width, "neuron": size}
    wanted = "Write [timestep, 'tref'], [timestep, 'axon', m] or [timestep, 'neuron', n]."
    if not isinstance(row, list) or len(row) not in (2, 3) or row[1] not in _KINDS:
        raise spec.wrong("events", f"has {str(row)[:40]!r} at {place}", wanted)
    step, kind, *rest = row
    index = rest[0] if rest else 0
    known = type(step) is int and type(index) is int and (len(row) == 2) == (kind == "tref")
    if not known or not 0 <= step < timesteps or not 0 <= index < most[kind]:
        raise spec.wrong("events", f"has {str(row)[:40]!r} at {place}, out of range", wanted)
    return step, (kind, index)


def _membranes(spec: Fields, events: int, size: int) -> Integers | None:
    if spec.name("v_event") is None:
        return None
    found = spec.array("v_event", axes=2, least=-1 << 16, most=1 << 16)
    if found.shape != (events, size):
        raise spec.wrong("v_event", f"has shape {found.shape}", f"Write {events, size}.")
    return found


def _spikes(spec: Fields, events: int, size: int) -> Sequence[tuple[int, ...]]:
    if spec.name("s_event") is None:
        return [()] * events
    found = spec.lists("s_event", least=0, most=size - 1)
    if len(found) != events:
        raise spec.wrong("s_event", f"has {len(found)} lists", f"Write {events}, one an event.")
    return found


def _lost(spec: Fields, events: int, size: int) -> Sequence[tuple[int, ...]]:
    lost: list[tuple[int, ...]] = [()] * events
    if spec.name("dropped_by_full_fifo") is None:
        return lost
    for row in spec.rows("dropped_by_full_fifo"):
        pair = isinstance(row, list) and len(row) == 2 and isinstance(row[1], list)
        inside = pair and all(type(n) is int and 0 <= n < size for n in row[1])
        if not inside or type(row[0]) is not int or not 0 <= row[0] < events:
            remedy = "Write [place of the event, [neurons]]."
            raise spec.wrong("dropped_by_full_fifo", f"has {str(row)[:40]!r}", remedy)
        lost[row[0]] = tuple(row[1])
    return lost
