"""What a recorded run is, its replay by the interpreter, and the first number that differs."""

from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.traces.fields import Fields, Integers, shown_names

# layer -> quantity -> (T, N)
Tables: TypeAlias = Mapping[str, Mapping[str, Integers]]

# quantities of a layer, in the order in which a neuron computes them
QUANTITIES = ("current", "current 2", "membrane after fire or leak", "membrane", "spikes")
# states beyond this are no chip's
STATE = 1 << 40
# additions that a replay computes at most: about five seconds of one core, and 500 MB. A neuron
# costs as much as 32 of them, an axon whose events a chip adds one by one 1,024, a layer 4,096
MOST_WORK = 1 << 27
MOST_NUMBERS = 1 << 24  # membranes after each event

# for readers, not compared
PROSE = {
    "name", "source", "kind", "note", "convention", "index", "trace_index", "input_spikes_index",
    "check", "seed", "license", "licence", "chip", "steps", "params", "layers",
}  # fmt: skip
_BLIND = "membranes at spikes, of which the board's probe shows something else"


@dataclass(frozen=True, eq=False)
class TraceFile:
    """A run that was recorded.

    source: who recorded it.
    program: what ran, on the chip as the source models it.
    raster: (B, T, M) spikes that went in; counts where the chip takes several in a timestep. Each
        of the B inferences begins from zero states.
    recorded: (B T, N) tables, one inference behind the other; quantities as in QUANTITIES.
    unread: fields that the reader does not use.
    remarks: as in Verdict.
    blind_at_spikes: True if membranes are not to be compared in timesteps with a spike.
    replay: computes tables like the recorded ones; None is the interpreter, in its timesteps.
    """

    source: str
    program: Program
    raster: NDArray[np.uint8]
    recorded: Tables
    unread: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    blind_at_spikes: bool = False
    replay: Callable[[Program, NDArray[np.uint8]], Tables] | None = None


@dataclass(frozen=True)
class TraceDifference:
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
        """Describe the difference in one line."""
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
    difference: TraceDifference | None
    unread: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def equal(self) -> bool:
        """True if every compared number is as recorded."""
        return self.difference is None

    def as_json(self) -> dict[str, Any]:
        """Return all fields as plain data."""
        return {"equal": self.equal, **asdict(self)}


# what readers share


def check_work(fields: Fields, program: Program, timesteps: int, inference: int = 0) -> None:
    """Refuse a replay that would take too long or too much memory.

    inference: timesteps of each of those that are computed side by side; 0 where there is one.
    """
    layers = program.layers
    synapses = [each for layer in layers for each in layer.synapses]
    neurons = program.width + sum(layer.size for layer in layers)
    weights = sum(
        s.weight.size if s.window is None else s.shape[1] * s.weight[0].size for s in synapses
    )
    axons = 0
    if not isinstance(program.chip.arithmetic, CubaFixedPoint):
        aliases = sum(map(len, (each for layer in layers for each in layer.aliases)))
        axons = aliases + sum(len(s.weight) for s in synapses)
    serial = (inference or timesteps) * (4096 * len(layers) + 1024 * axons)
    if (found := serial + timesteps * (32 * neurons + weights)) > MOST_WORK:
        remedy = f"At most {MOST_WORK} are replayed: record less, or in parts."
        raise fields.wrong("replay", f"has {found} operations", remedy)


def layers_trace(
    fields: Fields,
    specs: Sequence[Fields],
    program: Program,
    counts: Integers,
    ignored: AbstractSet[str],
    **more: Any,  # noqa: ANN401
) -> TraceFile:
    """The trace of a program whose layers have fields of their own, recorded quantities included.

    counts: (T, M) spikes that went in.
    ignored: fields without a meaning of their own, beside PROSE.
    more: further fields of TraceFile.
    """
    check_work(fields, program, len(counts))
    named = {layer.name: spec for layer, spec in zip(program.layers, specs, strict=True)}
    recorded = {
        layer.name: recorded_tables(named[layer.name], (len(counts), layer.size))
        for layer in program.layers
    }
    unread = unread_fields(specs, ignored)
    if not any(recorded.values()):
        raise nothing_to_compare(fields, unread)
    return TraceFile(
        source=source_of(fields, program.chip.name),
        program=program,
        raster=counts.astype(np.uint8)[None],
        recorded=recorded,
        unread=unread,
        remarks=(*assumptions(named, program.chip.name), *more.pop("remarks", ())),
        **more,
    )


def recorded_tables(spec: Fields, shape: tuple[int, int]) -> dict[str, Integers]:
    """The tables (T, N) that are there, by quantity."""
    tables = {}
    for quantity in (each for each in QUANTITIES if each in spec):
        tables[quantity] = table = spec.table(quantity, least=-STATE, most=STATE)
        if table.shape != shape:
            remedy = f"The inputs and the weights ask for {shape}."
            raise spec.wrong(quantity, f"has shape {table.shape}", remedy)
    return tables


def assumptions(specs: Mapping[str, Fields], chip: str) -> tuple[str, ...]:
    """Return remarks on values assumed for missing fields, one for layers that share them."""
    takers: dict[tuple[str, ...], list[str]] = {}
    for name, spec in specs.items():
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


def nothing_to_compare(fields: Fields, unread: Sequence[str]) -> TraceError:
    """The error of a trace in which nothing is recorded under a name that is known."""
    others = f" Unknown fields: {shown_names(unread)}." if unread else ""
    return TraceError(
        f"{fields.where}: there is nothing to compare.{others} Record currents, membranes or "
        "spikes by the names of docs/traces.md."
    )


# the comparison


def verdict_on(recorded: TraceFile) -> Verdict:
    """The verdict on a trace that is replayed."""
    found = (recorded.replay or replay_tables)(recorded.program, recorded.raster)
    tables, masks = recorded.recorded, {}
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
) -> TraceDifference | None:
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
                first = TraceDifference(step, layer, neuron, quantity, *values)
    return first
