"""Trace files: what an emulator or a chip did, with everything that is needed to do it again.

The format is in docs/traces.md. It follows what four emulators write, so quantities have several
names, and a file names its maker in prose. A verdict is the result of replaying a trace.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import CHIPS
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.traces.fields import Fields, Integers, shown_names

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
    "loihi1": "spikedeploy.runtime.families.cuba.loihi_traces:loihi_trace",
    "loihi1-brian2": "spikedeploy.runtime.families.cuba.loihi_traces:loihi_trace",
    "loihi1-nengo": "spikedeploy.runtime.families.cuba.loihi_traces:loihi_trace",
    "loihi2": "spikedeploy.runtime.families.cuba.loihi_traces:loihi_trace",
    "xylo-a2": "spikedeploy.runtime.families.xylo.xylosim_traces:xylo_trace",
    "xylo-a3": "spikedeploy.runtime.families.xylo.xylosim_traces:xylo_trace",
    "xylo-imu": "spikedeploy.runtime.families.xylo.xylosim_traces:xylo_trace",
}
# of an exported program, on any of the chips that it can be exported for
_OF_PROGRAMS = "spikedeploy.runtime.families.program_traces:program_trace"
# those that are replayed in a way of their own: event by event, or with an earlier reset
_VERDICTS = {
    "odin": "spikedeploy.runtime.families.integrate_and_fire.crossbar_traces:crossbar_verdict",
    "tinyodin": "spikedeploy.runtime.families.integrate_and_fire.crossbar_traces:crossbar_verdict",
    "spiker": "spikedeploy.runtime.families.integrate_and_fire.spiker_traces:spiker_verdict",
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
    blind_at_spikes: whether membranes are not to be compared in timesteps with a spike.
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


Reader: TypeAlias = Callable[[Fields, str], TraceFile]


def own_verdict(fields: Fields, chip: str) -> "Verdict | None":
    """The verdict on a trace of a chip that is replayed in a way of its own; None of the others."""
    if chip not in _VERDICTS:
        return None
    module, attribute = _VERDICTS[chip].split(":")
    verdict: Verdict = getattr(import_module(module), attribute)(fields, chip)
    return verdict


def trace_in(fields: Fields, stem: str) -> TraceFile:
    """The trace in the fields of a file of that name."""
    chip = maker(fields, stem)
    if chip not in _READERS:
        hint = "can be run but has no trace format" if chip in CHIPS else "is not known"
        raise TraceError(
            f"{fields.where}: chip {chip[:40]!r} {hint}. Traces may be of "
            f"{', '.join((*_READERS, *_VERDICTS))}."
        )
    module, attribute = _READERS[chip].split(":")
    reader: Reader = getattr(import_module(module), attribute)
    return reader(fields, chip)


def program_trace_in(fields: Fields, folder: Path) -> TraceFile:
    """The trace in the fields of a file in that folder, where the file of its program lies too."""
    module, attribute = _OF_PROGRAMS.split(":")
    found: TraceFile = getattr(import_module(module), attribute)(fields, folder)
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
    spec: Fields, ranges: Mapping[str, tuple[str, int, int]], shape: tuple[int, int]
) -> dict[str, Integers]:
    """The tables (T, N) that are there, by quantity.

    ranges: quantity -> its name in the file, its least and its largest number.
    """
    tables = {}
    for quantity, (name, least, most) in ranges.items():
        if spec.name(name) is None:
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
        for pattern, chip in _MAKERS:
            if re.search(pattern, text, re.IGNORECASE):
                return chip
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
        """Whether every compared number is as recorded."""
        return self.difference is None

    def as_json(self) -> dict[str, Any]:
        """Everything, for machines."""
        return {"equal": self.equal, **asdict(self)}
