"""Trace files: recorded runs of emulators or chips, replayed on our arithmetic and compared.

The format is in docs/traces.md. All files go the same way: the reader of a chip makes a TraceFile
of the fields, with a program, its input and what was recorded; the program is replayed; the verdict
is the first number that differs. Readers stand beside the arithmetic of their chip.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import CHIPS
from spikedeploy.runtime.chips.layer import Layer, Numbers, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.traces.fields import Fields, Integers, read_json, shown_names

# layer -> quantity -> (T, N)
Tables: TypeAlias = Mapping[str, Mapping[str, Integers]]
# quantity -> its names in files, its least and its largest number
Ranges: TypeAlias = Mapping[str, tuple[tuple[str, ...], int, int]]

# who wrote a trace, by what its name, source and kind say -> the chip as that tool models it
_MAKERS = (
    (r"sana-?fe", "sanafe"),
    # before lava's simulations, to which prose compares boards
    (r"loihi[ _-]?2[ _-]?(hw|board|chip|hardware)|hw[ _-]loihi[ _-]?2", "loihi2"),
    (r"xylo", "xylo-a2"),
    (r"tinyodin", "tinyodin"),
    (r"\bodin\b", "odin"),
    (r"\bspiker\b", "spiker"),
    (r"brian2", "loihi1-brian2"),
    (r"nengo", "loihi1-nengo"),
    (r"loihi1simcfg|loihi2simcfg", "loihi1"),
    (r"loihi[ _-]?2", "loihi2"),
    (r"lava", "loihi1"),
)
_FAMILIES = "spikedeploy.runtime.families"
_LOIHI = f"{_FAMILIES}.cuba.traces:loihi_trace"
_XYLO = f"{_FAMILIES}.xylo_traces:xylo_trace"
_CROSSBAR = f"{_FAMILIES}.integrate_and_fire.traces:crossbar_verdict"
# "module:function", which makes a TraceFile or, of what is replayed in another way, a Verdict
_READERS = {
    **dict.fromkeys(("loihi1", "loihi1-brian2", "loihi1-nengo", "loihi2"), _LOIHI),
    **dict.fromkeys(("xylo-a2", "xylo-a3", "xylo-imu"), _XYLO),
    **dict.fromkeys(("odin", "tinyodin"), _CROSSBAR),
    "spiker": f"{_FAMILIES}.integrate_and_fire.traces:spiker_trace",
    "sanafe": "spikedeploy.runtime.traces.sanafe:sanafe_verdict",
}
_SPECK = f"{_FAMILIES}.integrate_and_fire.speck_traces:speck_verdict"
# of an exported program, on any of the chips that it can be exported for
_OF_PROGRAMS = f"{_FAMILIES}.programs:program_trace"
# letters of a text in which makers are looked for
_MOST_PROSE = 1000
# what is for people
PROSE = {
    "name", "source", "kind", "note", "convention", "index", "trace_index", "input_spikes_index",
    "check", "seed", "license", "licence",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class TraceFile:
    """A run that was recorded.

    source: who recorded it.
    program: what ran, on the chip as the source models it.
    raster: (B, T, M) spikes that went in; counts where the chip takes several in a timestep. Each
        of the B inferences begins from zero states.
    recorded: (B T, N) tables, one inference behind the other; quantities as in QUANTITIES.
    blind_at_spikes: True if membranes are not to be compared in timesteps with a spike.
    unread: fields that the reader does not use.
    remarks: as in Verdict.
    replay: computes tables like the recorded ones; None is the interpreter, in its timesteps.
    """

    source: str
    program: Program
    raster: NDArray[np.uint8]
    recorded: Tables
    blind_at_spikes: bool
    unread: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    replay: Callable[[Program, NDArray[np.uint8]], Tables] | None = None


def trace_in(fields: Fields, stem: str) -> "TraceFile | Verdict":
    """The TraceFile in the fields of a file of that name; a Verdict where there is no program."""
    name = maker(fields, stem)
    if name not in _READERS:
        hint = "can be run but has no trace format" if name in CHIPS else "is not known"
        raise TraceError(
            f"{fields.where}: chip {name[:40]!r} {hint}. Traces may be of {', '.join(_READERS)}."
        )
    found: TraceFile | Verdict = _load(_READERS[name])(fields, name)
    return found


def _load(entry: str) -> Callable[..., Any]:
    module, attribute = entry.split(":")
    found: Callable[..., Any] = getattr(import_module(module), attribute)
    return found


def chain_trace(
    fields: Fields,
    specs: Sequence[Fields],
    program: Program,
    counts: Integers,
    ranges: Sequence[Ranges],
    ignored: AbstractSet[str],
) -> TraceFile:
    """The trace of a program of which each layer has fields and ranges of its own.

    counts: (T, M) spikes that went in.
    ignored: fields without a meaning of their own, beside PROSE.
    """
    recorded = {
        layer.name: recorded_tables(spec, each, (len(counts), layer.size))
        for layer, spec, each in zip(program.layers, specs, ranges, strict=True)
    }
    unread = unread_fields(specs, ignored)
    if not any(recorded.values()):
        raise nothing_to_compare(fields, {*unread}, _first_names(ranges))
    return TraceFile(
        source=source_of(fields, program.chip.name),
        program=program,
        raster=counts.astype(np.uint8)[None],
        recorded=recorded,
        blind_at_spikes=False,
        unread=unread,
        remarks=assumptions(zip(recorded, specs, strict=True), program.chip.name),
    )


def assumptions(layers: Iterable[tuple[str, Fields]], chip: str) -> tuple[str, ...]:
    """What was taken for fields that are missing: a remark for layers that take the same."""
    takers: dict[tuple[str, ...], list[str]] = {}
    for name, spec in layers:
        takers.setdefault(tuple(spec.assumed), []).append(name)
    return tuple(
        f"{shown_names(names)}: not in the file, so taken as {chip} has it: {', '.join(assumed)}"
        for assumed, names in takers.items()
        if assumed
    )


def unread_fields(specs: Sequence[Fields], ignored: AbstractSet[str]) -> tuple[str, ...]:
    """Fields that no layer used, less those that mean nothing."""
    return tuple(sorted(set.intersection(*(spec.unread for spec in specs)) - PROSE - ignored))


def source_of(fields: Fields, chip: str) -> str:
    """The tool that recorded the trace."""
    return fields.text("source") or fields.text("name") or chip


def _first_names(ranges: Sequence[Ranges]) -> str:
    *others, last = dict.fromkeys(names[0] for each in ranges for names, _, _ in each.values())
    return f"{', '.join(others)} or {last}"


def layer_of(
    name: str,
    synapses: Sequence[Synapses],
    threshold: Numbers,
    membrane_decay: Numbers,
    **given: Any,  # noqa: ANN401
) -> Layer:
    """A layer whose biases and currents are 0 where they are not given."""
    none = np.zeros(threshold.size, np.int64)
    layer = Layer(
        name, tuple(synapses), none, none, threshold, none, membrane_decay, scale=1.0, start=0
    )
    return replace(layer, **given)


def table_of(spec: Fields, names: tuple[str, ...], least: int, most: int, index: str) -> Integers:
    """(T, N) of the first name that is there; a list of numbers is that of a single neuron.

    index: the field that says which way the tables stand, as in `[neuron][t]`.
    """
    found = spec.array(*names, axes=2, least=least, most=most)
    if found.ndim == 0:
        name = spec.name(*names) or names[0]
        raise spec.wrong(name, "is a single number", "Write a row for each timestep.")
    if found.ndim == 1:
        return found[:, None]
    return found.T if spec.text(index).rstrip().endswith("][t]") else found


def weights_of(spec: Fields, name: str, least: int, most: int) -> Integers:
    """(M, N) weights; an index that starts with `[post]` turns them round."""
    found = spec.array(name, axes=2, least=least, most=most)
    if found.ndim < 2:
        raise spec.wrong(name, f"has shape {found.shape}", "Write [pre][post].")
    return found.T if spec.text("index").startswith("[post]") else found


def recorded_tables(spec: Fields, ranges: Ranges, shape: tuple[int, int]) -> dict[str, Integers]:
    """The tables (T, N) that are there, by quantity."""
    tables = {}
    for quantity, (names, least, most) in ranges.items():
        if (name := spec.name(*names)) is None:
            continue
        tables[quantity] = table = table_of(spec, (name,), least, most, index="trace_index")
        if table.shape != shape:
            found = f"has shape {table.shape}"
            raise spec.wrong(name, found, f"The inputs and the weights ask for {shape}.")
    return tables


def nothing_to_compare(fields: Fields, unread: set[str], wanted: str) -> TraceError:
    """The error of a trace in which nothing is recorded under a name that is known."""
    others = f" Unknown fields: {shown_names(sorted(unread))}." if unread else ""
    return TraceError(f"{fields.where}: there is nothing to compare.{others} Record {wanted}.")


def maker(fields: Fields, stem: str) -> str:
    """The chip that the file names, or that of the emulator which its prose names."""
    prose = {key: fields.text(key)[:_MOST_PROSE] for key in ("chip", "name", "source", "kind")}
    if prose["chip"]:
        return prose["chip"]
    # the name of the file is a last resort
    for text in (" ".join(prose.values()), stem):
        for pattern, name in _MAKERS:
            if re.search(pattern, text, re.IGNORECASE):
                return name
    raise TraceError(
        f"{fields.where}: its source is {prose['source'][:60]!r}, and no emulator or chip is known "
        f"by that. Add a field chip; it may be {', '.join(_READERS)}."
    )


# in the order in which a neuron computes them
QUANTITIES = ("current", "current 2", "membrane after fire or leak", "membrane", "spikes")


@dataclass(frozen=True)
class Difference:
    """The first number that is not as recorded.

    step: row of the trace, counted from 0.
    layer, neuron: where it is; neurons are counted from 0. An event may stand for the layer, and
        what an event is has no neuron.
    quantity: one of QUANTITIES, or what was summed up over the run, which has no place.
    expected, found: in the trace, and here; of events words.
    """

    step: int | None
    layer: str | None
    neuron: int | None
    quantity: str
    expected: float | str
    found: float | str

    def describe(self) -> str:
        """One line for people."""
        neuron = "" if self.neuron is None else f"neuron {self.neuron}, "
        place = "" if self.step is None else f"step {self.step}, {self.layer}, {neuron}"
        return f"{place}{self.quantity}: expected {self.expected}, found {self.found}"


@dataclass(frozen=True)
class Verdict:
    """The result of replaying a trace.

    chip: the one that it was replayed on.
    source: who recorded it.
    steps: T.
    compared: numbers that were compared.
    passed_over: recorded numbers that were not compared.
    why: they were not; empty where all were.
    difference: None where all numbers are equal.
    unread: fields of the file that the reader does not use.
    remarks: how it was replayed, where that is not plain; sentences.
    """

    chip: str
    source: str
    steps: int
    compared: int
    passed_over: int
    why: str
    difference: Difference | None
    unread: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def equal(self) -> bool:
        """True if every compared number is as recorded."""
        return self.difference is None

    def as_json(self) -> dict[str, Any]:
        """Everything, for machines."""
        return {"equal": self.equal, **asdict(self)}


_BLIND = "membranes at spikes, of which the board's probe shows something else"


def verify(path: Path) -> Verdict:
    """Replay a trace file by the specification of the arithmetic."""
    fields = read_json(path)
    if fields.name("program") is not None:
        # beside the file of its program
        found: TraceFile | Verdict = _load(_OF_PROGRAMS)(fields, path.parent)
    elif fields.name("format") is not None:
        # beside its arrays
        found = _load(_SPECK)(fields, path)
    else:
        found = trace_in(fields, path.stem)
    return found if isinstance(found, Verdict) else verdict_on(found)


def verdict_on(recorded: TraceFile) -> Verdict:
    """The verdict on a trace that is replayed."""
    found = (recorded.replay or replay_tables)(recorded.program, recorded.raster)
    tables = recorded.recorded
    masks = {}
    if recorded.blind_at_spikes:
        for layer in (layer for layer in tables if "membrane" in tables[layer]):
            masks[layer, "membrane"] = tables[layer].get("spikes", found[layer]["spikes"]) == 0
    passed_over = sum(int((~mask).sum()) for mask in masks.values())
    return Verdict(
        chip=recorded.program.chip.name,
        source=recorded.source,
        steps=recorded.raster.shape[0] * recorded.raster.shape[1],
        compared=count_numbers(tables) - passed_over,
        passed_over=passed_over,
        why=_BLIND if passed_over else "",
        difference=first_difference(tables, found, masks),
        unread=recorded.unread,
        remarks=recorded.remarks,
    )


def count_numbers(tables: Tables) -> int:
    """Number of the numbers in tables."""
    return sum(table.size for quantities in tables.values() for table in quantities.values())


def replay_tables(program: Program, raster: NDArray[np.uint8]) -> Tables:
    """States and spikes of the interpreter, one inference behind the other."""
    tables = {}
    for name, layer in trace(program, raster).items():
        current, membrane, spikes = (
            np.concatenate(each) for each in (layer.current, layer.membrane, layer.spikes)
        )
        currents = [current] if current.ndim == 2 else list(current.swapaxes(0, 1))
        named = dict(zip(QUANTITIES, currents, strict=False))
        tables[name] = {**named, "membrane": membrane, "spikes": spikes.astype(np.int64)}
    return tables


def first_difference(
    recorded: Tables,
    found: Tables,
    masks: Mapping[tuple[str, str], NDArray[np.bool_]] | None = None,
) -> Difference | None:
    """The earliest difference; within a timestep in the order of layers and quantities.

    masks: where to compare, by layer and quantity; everywhere where there is none.
    """
    first, masks = None, masks or {}
    for layer, quantities in recorded.items():
        for quantity, expected in quantities.items():
            ours = found[layer][quantity]
            wrong = np.argwhere((expected != ours) & masks.get((layer, quantity), True))
            if len(wrong) and (first is None or wrong[0][0] < (first.step or 0)):
                step, neuron = (int(i) for i in wrong[0])
                values = int(expected[step, neuron]), int(ours[step, neuron])
                first = Difference(step, layer, neuron, quantity, *values)
    return first
