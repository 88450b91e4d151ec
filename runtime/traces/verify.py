"""Trace files: recorded runs of emulators or chips, replayed on our arithmetic and compared.

The format is in docs/traces.md. It follows what four emulators write, so quantities have several
names, and a file names its maker in prose. A verdict is the result of replaying a trace: the first
number that differs, or, of SANA-FE, whether the energies of a network are those of the ledger.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import LayerTrace, trace
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.metrics.energy import TABLES
from spikedeploy.runtime.traces.fields import Fields, Integers, read_json, shown_names

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
_READERS = {
    "loihi1": "spikedeploy.runtime.families.cuba.traces:loihi_trace",
    "loihi1-brian2": "spikedeploy.runtime.families.cuba.traces:loihi_trace",
    "loihi1-nengo": "spikedeploy.runtime.families.cuba.traces:loihi_trace",
    "loihi2": "spikedeploy.runtime.families.cuba.traces:loihi_trace",
    "xylo-a2": "spikedeploy.runtime.families.xylo_traces:xylo_trace",
    "xylo-a3": "spikedeploy.runtime.families.xylo_traces:xylo_trace",
    "xylo-imu": "spikedeploy.runtime.families.xylo_traces:xylo_trace",
}
# of an exported program, on any of the chips that it can be exported for
_OF_PROGRAMS = "spikedeploy.runtime.families.programs:program_trace"
# those that are replayed in a way of their own: event by event, or with an earlier reset
_VERDICTS = {
    "odin": "spikedeploy.runtime.families.integrate_and_fire.traces:crossbar_verdict",
    "tinyodin": "spikedeploy.runtime.families.integrate_and_fire.traces:crossbar_verdict",
    "spiker": "spikedeploy.runtime.families.integrate_and_fire.traces:spiker_verdict",
}
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
    recorded: layer -> quantity -> (B T, N), one inference behind the other; quantities as in
        QUANTITIES.
    blind_at_spikes: True if membranes are not to be compared in timesteps with a spike.
    unread: fields that the reader does not use.
    remarks: as in Verdict.
    """

    source: str
    program: Program
    raster: NDArray[np.uint8]
    recorded: Mapping[str, Mapping[str, Integers]]
    blind_at_spikes: bool
    unread: tuple[str, ...]
    remarks: tuple[str, ...] = ()


def _load(entry: str) -> Callable[..., Any]:
    """The reader of an entry "module:name" of the tables."""
    module, attribute = entry.split(":")
    found: Callable[..., Any] = getattr(import_module(module), attribute)
    return found


def trace_in(fields: Fields, stem: str) -> TraceFile:
    """The trace in the fields of a file of that name."""
    name = maker(fields, stem)
    if name not in _READERS:
        hint = "can be run but has no trace format" if name in CHIPS else "is not known"
        raise TraceError(
            f"{fields.where}: chip {name[:40]!r} {hint}. Traces may be of "
            f"{', '.join((*_READERS, *_VERDICTS))}."
        )
    found: TraceFile = _load(_READERS[name])(fields, name)
    return found


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


def recorded_tables(
    spec: Fields, ranges: Mapping[str, tuple[tuple[str, ...], int, int]], shape: tuple[int, int]
) -> dict[str, Integers]:
    """The tables (T, N) that are there, by quantity.

    ranges: quantity -> its names in files, its least and its largest number.
    """
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
        f"by that. Add a field chip; it may be {', '.join((*_READERS, *_VERDICTS))}."
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
        return _verdict(_load(_OF_PROGRAMS)(fields, path.parent))
    if (name := maker(fields, path.stem)) == MAKER:
        return energy_verdict(fields)
    if name in _VERDICTS:
        found: Verdict = _load(_VERDICTS[name])(fields, name)
        return found
    return _verdict(trace_in(fields, path.stem))


def _verdict(recorded: TraceFile) -> Verdict:
    """The verdict on a trace that is replayed by the interpreter."""
    ran = trace(recorded.program, recorded.raster)
    found = {name: _quantities(layer) for name, layer in ran.items()}
    masks = _masks(recorded, found)
    passed_over = sum(int((~mask).sum()) for mask in masks.values())
    return Verdict(
        chip=recorded.program.chip.name,
        source=recorded.source,
        steps=recorded.raster.shape[0] * recorded.raster.shape[1],
        compared=sum(int(mask.sum()) for mask in masks.values()),
        passed_over=passed_over,
        why=_BLIND if passed_over else "",
        difference=first_difference(recorded.recorded, found, masks),
        unread=recorded.unread,
        remarks=recorded.remarks,
    )


def _quantities(layer: LayerTrace) -> dict[str, Integers]:
    """States and spikes of a layer by quantity: (T, N), one inference behind the other."""
    current, membrane, spikes = (
        np.concatenate(each) for each in (layer.current, layer.membrane, layer.spikes)
    )
    currents = [current] if current.ndim == 2 else list(current.swapaxes(0, 1))
    named = dict(zip(QUANTITIES, currents, strict=False))
    return {**named, "membrane": membrane, "spikes": spikes.astype(np.int64)}


def _masks(
    recorded: TraceFile, found: Mapping[str, Mapping[str, Integers]]
) -> dict[tuple[str, str], NDArray[np.bool_]]:
    """(T, N) of each layer and quantity: where to compare."""
    masks = {}
    for layer, quantities in recorded.recorded.items():
        for quantity, expected in quantities.items():
            mask = np.ones(expected.shape, np.bool_)
            if recorded.blind_at_spikes and quantity == "membrane":
                mask = quantities.get("spikes", found[layer]["spikes"]) == 0
            masks[layer, quantity] = mask
    return masks


def first_difference(
    recorded: Mapping[str, Mapping[str, Integers]],
    found: Mapping[str, Mapping[str, Integers]],
    masks: Mapping[tuple[str, str], NDArray[np.bool_]],
) -> Difference | None:
    """The earliest difference; within a timestep in the order of layers and quantities.

    recorded, found: layer -> quantity -> (T, N).
    masks: where to compare, by layer and quantity; everywhere where there is none.
    """
    first, earliest = None, None
    for layer, quantities in recorded.items():
        for quantity in (q for q in QUANTITIES if q in quantities):
            expected, ours = quantities[quantity], found[layer][quantity]
            wrong = np.argwhere((expected != ours) & masks.get((layer, quantity), True))
            if len(wrong) and (earliest is None or wrong[0][0] < earliest):
                step, neuron = (int(i) for i in wrong[0])
                values = int(expected[step, neuron]), int(ours[step, neuron])
                first, earliest = Difference(step, layer, neuron, quantity, *values), step
    return first


MAKER = "sanafe"
_NUMBER = r"([1-9]\d{0,2})"
_SETUP = re.compile(
    rf"{_NUMBER} input neurons spiking \[([01](?:, *[01])*)\] *-> *all-to-all *-> *"
    rf"{_NUMBER} loihi_lif neurons \(threshold 1e9\), one core, {_NUMBER} steps"
)
# what SANA-FE calls a part of the energy -> our events
_ENERGIES = {
    "synapse": ("sop", "bias_sop"),
    "dendrite": (),
    "soma": ("neuron_update", "neuron_idle", "spike_out"),
    "network": ("message",),
}
_COUNTS = {
    "spikes(synops)": ("sop",),
    "packets_sent": ("message",),
    "neurons_fired": ("spike_in", "spike_out"),
    "neurons_updated": ("neuron_update", "spike_in"),
}
_NEVER = ((1 << 17) - 1) << 6  # a threshold that so few inputs do not reach
_TOLERANCE = 1e-6


def energy_verdict(fields: Fields) -> Verdict:
    """The verdict on SANA-FE's counts and energies of a network, by our ledger and its table."""
    setup = _SETUP.fullmatch(fields.text("setup").strip())
    if setup is None:
        raise TraceError(
            f"{fields.where}: setup is {fields.text('setup')[:60]!r}, which cannot be read. "
            "docs/traces.md has the sentence that can."
        )
    inputs, bits, neurons, steps = setup.groups()
    spikes = [int(bit) for bit in bits.split(",")]
    if len(spikes) != int(steps):
        raise fields.wrong("setup", f"has {len(spikes)} spikes", "Write one for each step.")
    if int(inputs) * sum(spikes) << 6 > _NEVER:
        raise fields.wrong(
            "setup", f"has {sum(spikes)} spikes", "Neurons would spike; write fewer."
        )
    ledger = _run(int(inputs), int(neurons), spikes)
    result = fields.group("result")
    expected = {**result.numbers(*_COUNTS), **result.group("energy").numbers("total", *_ENERGIES)}
    if not expected:
        raise TraceError(f"{fields.where}: there is nothing to compare. Record result.energy.")
    return Verdict(
        chip="loihi1",
        source=fields.text("source"),
        steps=len(spikes),
        compared=len(expected),
        passed_over=len(result.numbers("sim_time")),
        why="time, of which ours is an upper bound",
        difference=_first(expected, _found(ledger)),
        unread=(),
    )


def _run(inputs: int, neurons: int, spikes: list[int]) -> Ledger:
    weight, ones = np.ones((inputs, neurons), np.int16), np.ones(neurons, np.int64)
    layer = Layer(
        name="lif",
        synapses=(Synapses("input", weight, 1),),
        bias=0 * ones,
        voltage_bias=0 * ones,
        threshold=_NEVER * ones,
        current_decay=0 * ones,
        membrane_decay=4096 * ones,
        scale=1.0,
        start=1,
    )
    machine = Machine(
        Program(chip("loihi1"), Convention(1e-3), "input", inputs, (layer,), "lif", None)
    )
    for spiking in spikes:
        machine.step(np.full((1, inputs), spiking, np.uint8))
    return machine.ledger


def _found(ledger: Ledger) -> dict[str, float]:
    """Counts, and energies [J]; SANA-FE's inputs send messages and cost nothing else."""
    prices = TABLES["sanafe"].joules
    counts = {name: sum(map(ledger.total, events)) for name, events in _COUNTS.items()}
    parts = {
        name: sum(ledger.total(event) * prices[event] for event in events)
        for name, events in _ENERGIES.items()
    }
    return {**counts, **parts, "total": sum(parts.values())}


def _first(expected: dict[str, float], found: dict[str, float]) -> Difference | None:
    for name, value in expected.items():
        if not math.isclose(value, found[name], rel_tol=_TOLERANCE, abs_tol=1e-15):
            return Difference(None, None, None, name, value, found[name])
    return None
