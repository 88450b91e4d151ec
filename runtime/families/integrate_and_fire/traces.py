"""Recorded runs of ODIN, tinyODIN and Spiker+, from simulations of their RTL.

Runs of a crossbar are replayed once more event by event.

A timestep of Spiker's RTL begins with firing, the emulator's ends with it: a spike of the emulator
leaves in the next timestep of the recording, and its membranes are those before any firing in both.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention, Reset
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.neurons import (
    IntegrateAndFireRules,
    PartialStep,
    begin,
    fires,
)
from spikedeploy.runtime.families.integrate_and_fire.spike_queue import (
    TREF,
    Crossbar,
    CrossbarNeurons,
    Event,
    WorkedEvent,
    axons,
)
from spikedeploy.runtime.traces.fields import MOST_NUMBERS, Fields, Integers, Work, shown_names
from spikedeploy.runtime.traces.verify import (
    PROSE,
    Difference,
    Verdict,
    first_difference,
    nothing_to_compare,
    recorded_tables,
    table_of,
    weights_of,
)

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
                expected = _describe_event(self.steps[place], event)
                return self._differs(
                    place, None, "event", expected, _describe_event(steps[place], found.event)
                )
            if (difference := self._inside(place, found)) is not None:
                return difference
        if len(self.events) == len(done):
            return None
        place = min(len(self.events), len(done)) - 1
        return self._differs(place, None, "events in all", len(self.events), len(done))

    def _inside(self, place: int, found: WorkedEvent) -> Difference | None:
        """The first difference in one event: membranes, then spikes, then losses."""
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


def _describe_event(step: int, event: Event) -> str:
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


_NEURONS = "neurons"  # name of the one layer
# quantity -> its name in the file, and what it may be
_TABLES = {"membrane": (("v",), -1 << 16, 1 << 20), "spikes": (("s",), 0, 1 << 20)}
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
    """Compare the chip's neurons with a recorded run, event by event and in timesteps."""
    spec = fields.merged_with(fields.group("params"))
    recorded = _read_run(spec, chip)
    unread = spec.unread - PROSE - _REPEATED
    if recorded.events is None and not recorded.tables:
        raise nothing_to_compare(fields, unread, "v, s, v_event or s_event")
    done, steps, remarks = _replay(spec, recorded)
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


def _read_run(spec: Fields, chip: str) -> _Recorded:
    rules = datasheet(chip).arithmetic
    if not isinstance(rules, IntegrateAndFire):
        raise spec.wrong("chip", f"{chip} has no crossbar of events", "Name odin or tinyodin.")
    counts = table_of(spec, ("input_spikes",), 0, 255, index="input_spikes_index")
    if counts.shape[1] > _ROWS:
        found = f"has {counts.shape[1]} axons"
        raise spec.wrong("input_spikes", found, f"A crossbar has {_ROWS} at most.")
    host, order = _choice(spec, "host", _HOSTS), _choice(spec, "order", _ORDERS)
    wired, start = _read_neurons(spec, rules, counts.shape[1], host)
    size = len(start)
    work = Work(spec, len(counts))
    work.add(size, 0)
    work.check_input(counts)
    events = events_of(spec, (len(counts), counts.shape[1], size))
    return _Recorded(
        wired=wired,
        start=start,
        sent=_read_sent(spec, counts, events, order),
        host=host,
        events=events,
        tables=recorded_tables(spec, _TABLES, (len(counts), size)),
    )


def _choice(spec: Fields, name: str, choices: tuple[str, ...]) -> str:
    found = spec.text(name) or choices[0]
    if found not in choices:
        raise spec.wrong(name, f"is {found[:40]!r}", f"Write one of {', '.join(choices)}.")
    return found


def _read_neurons(
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


def _read_sent(
    spec: Fields, counts: Integers, events: RecordedEvents | None, order: str
) -> list[list[Event]]:
    """Events that the host sends in each timestep: by index, or in their recorded order."""
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


def _replay(spec: Fields, recorded: _Recorded) -> tuple[list[WorkedEvent], list[int], list[str]]:
    """The effect of every event, its timestep, and remarks on how it was replayed."""
    events, host = recorded.events, recorded.host
    if host == "relays":
        if events is None:
            raise spec.wrong("host", "relays", "Add the events in the order of the host.")
        _check_relayed(spec, events, recorded.wired)
        return *_replay_as_recorded(recorded, events), [_AS_SENT]
    done, steps = _replay_as_modelled(recorded)
    if events is None or host == "wait" or [d.event for d in done] == events.events:
        return done, steps, _stream_remarks(events) if host == "stream" else []
    # the handshake of another host took other turns with the queue
    _check_queued(spec, events, recorded.wired)
    return *_replay_as_recorded(recorded, events), [_OTHER_TURNS]


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


def _stream_remarks(events: RecordedEvents | None) -> list[str]:
    lost_too = events is not None and "dropped_by_full_fifo" in events.compares
    return [_STREAMED + _LOST_TOO * lost_too]


def _replay_as_modelled(recorded: _Recorded) -> tuple[list[WorkedEvent], list[int]]:
    """The events that the host sends, worked on as the chip does, and their timesteps."""
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


def _replay_as_recorded(
    recorded: _Recorded, events: RecordedEvents
) -> tuple[list[WorkedEvent], list[int]]:
    """The events worked on one after another, as they were recorded."""
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


_BEGUN = "membrane after fire or leak"
# quantity -> its name in the file, and what it may be
_SPIKER_TABLES = {
    _BEGUN: (("v_begun",), -1 << 32, 1 << 32),
    "membrane": (("v",), -1 << 32, 1 << 32),
    "spikes": (("s",), 0, 1),
}
# given twice in the file, or by the weights
_SPIKER_REPEATED = {"params", "layers", "steps", "input_spikes", "chip"}
# of a layer; of an FPGA there is no limit, a trace of more is a mistake
_MOST_NEURONS = 1 << 12


def spiker_verdict(fields: Fields, chip: str) -> Verdict:
    """Compare the layers with a recorded run, in every timestep."""
    specs = fields.layers()
    counts = table_of(specs[0], ("input_spikes",), 0, 255, index="input_spikes_index")
    program = _program(specs, datasheet(chip), counts.shape[1])
    work = Work(fields, len(counts))
    work.check_input(counts)
    for layer in program.layers:
        weights = [synapses.weight for synapses in layer.synapses]
        work.add(layer.size, sum(each.size for each in weights), sum(map(len, weights)))
    recorded = {
        layer.name: recorded_tables(spec, _SPIKER_TABLES, (len(counts), layer.size))
        for layer, spec in zip(program.layers, specs, strict=True)
    }
    unread = set.intersection(*(spec.unread for spec in specs)) - PROSE - _SPIKER_REPEATED
    if not any(recorded.values()):
        raise nothing_to_compare(fields, unread, "v, v_begun or s")
    found = _replay_spiker(program, counts)
    return Verdict(
        chip=chip,
        source=fields.text("source") or fields.text("name") or chip,
        steps=len(counts),
        compared=sum(table.size for tables in recorded.values() for table in tables.values()),
        passed_over=0,
        why="",
        difference=first_difference(recorded, found, {}),
        unread=tuple(sorted(unread)),
    )


def _program(specs: list[Fields], chip: Chip, width: int) -> Program:
    """The layers one after another, on the chip with the widths that they name."""
    arithmetic = chip.arithmetic
    if not isinstance(arithmetic, IntegrateAndFire):
        raise specs[0].wrong("chip", f"{chip.name} does not leak by shifts", "Name spiker.")
    bits = _same(specs, "weight_bits", arithmetic.weight_bits, most=16)
    neuron_bits = _same(specs, "neuron_bits", arithmetic.membrane.bits, most=32)
    register = Register(neuron_bits, arithmetic.membrane.overflow)
    rules = replace(arithmetic, weight_bits=bits, membrane=register)
    resets = {spec.text("reset") or "subtract" for spec in specs}
    if len(resets) > 1 or not resets <= {"subtract", "fixed"}:
        found = f"is {shown_names(sorted(resets))}"
        raise specs[0].wrong("reset", found, "Write 'subtract' or 'fixed', in all layers the same.")
    reset: Reset = "subtract" if resets == {"subtract"} else "zero"
    layers = list[Layer]()
    for place, spec in enumerate(specs):
        source, fan_in = (layers[-1].name, layers[-1].size) if layers else ("input", width)
        layers.append(_layer(spec, f"layer{place}", rules, source, fan_in))
    convention = Convention(1e-3, reset=reset, source="the trace")
    used = replace(chip, arithmetic=rules)
    return Program(used, convention, "input", width, tuple(layers), layers[-1].name, None)


def _same(specs: list[Fields], name: str, default: int, most: int) -> int:
    """A width that all layers share."""
    found = {spec.integer(name, default=default, least=2, most=most) for spec in specs}
    if len(found) > 1:
        raise specs[0].wrong(name, "differs from layer to layer", "Split the trace in two.")
    return found.pop()


def _layer(spec: Fields, name: str, rules: IntegrateAndFire, source: str, fan_in: int) -> Layer:
    weights = weights_of(spec, "weights", *rules.weight_range)
    size, limit = weights.shape[1], rules.membrane.limit
    if len(weights) != fan_in or size > _MOST_NEURONS:
        remedy = f"Write {fan_in} rows, one for each input, of {_MOST_NEURONS} neurons at most."
        raise spec.wrong("weights", f"has shape {weights.shape}", remedy)
    synapses = [Synapses(source, weights, 0 if source == "input" else 2)]
    if spec.name("weights_rec"):
        # their width is a parameter of its own, which no field names
        recurrent = weights_of(spec, "weights_rec", *replace(rules, weight_bits=16).weight_range)
        if recurrent.shape != (size, size):
            found = f"has shape {recurrent.shape}"
            raise spec.wrong("weights_rec", found, f"Write {size} rows of {size} neurons.")
        synapses.append(Synapses(name, recurrent, 2))
    none = np.zeros(size, np.int64)
    return Layer(
        name=name,
        synapses=tuple(synapses),
        bias=none,
        voltage_bias=none,
        threshold=spec.row("threshold", size=size, least=-limit - 1, most=limit),
        current_decay=none,
        membrane_decay=spec.row("shift", size=size, least=0, most=62),
        scale=1.0,
        start=0,
        v_reset=spec.row("v_reset", size=size, default=0, least=-limit - 1, most=limit),
    )


def _replay_spiker(program: Program, counts: Integers) -> dict[str, dict[str, Integers]]:
    """Layer -> quantity -> (T, N), in the timesteps of the RTL."""
    rules = program.chip.arithmetic
    if not isinstance(rules, IntegrateAndFire):
        raise TypeError(type(rules).__name__)
    interpreter = Interpreter(program, 1)
    for layer in program.layers:
        # what is above a negative threshold at first was so before
        interpreter.tails[layer.name][:, -1:] = fires(rules, layer, np.zeros(layer.size, np.int64))
    ran = interpreter.run(counts.astype(np.uint8)[None])
    found = {}
    for layer in program.layers:
        membrane = ran[layer.name].membrane[0]
        before = np.concatenate([np.zeros((1, layer.size), np.int64), membrane[:-1]])
        begun = PartialStep.of(before)
        begin(rules, program.convention, layer, begun)
        spikes = fires(rules, layer, before).astype(np.int64)
        found[layer.name] = {_BEGUN: begun.membrane, "membrane": membrane, "spikes": spikes}
    return found
