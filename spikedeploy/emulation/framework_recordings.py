"""Recordings that a framework made of a network, beside the float twin of the exported file.

Where they differ, other readings of the file are tried until one computes what was recorded: each
option of `load` with its choices, in the order in which options are usually to blame; rounding to
float32; and every combination of what a tool's files leave open.
"""

import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, get_args

import nir
import numpy as np

from spikedeploy.emulation.rasters import Raster, read_rasters
from spikedeploy.emulation.verification import RasterDifference, Verification, first_difference
from spikedeploy.runtime.artifact.artifact import Artifact, interpret, load, read_graph_of
from spikedeploy.runtime.convention import Floor, Integrator, Reset, SpikeCondition, State
from spikedeploy.runtime.dialects.tools import PRESETS, WRITERS
from spikedeploy.runtime.errors import ObservationError, SpikedeployError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import Port, ports

Options = dict[str, Any]  # of artifact.load

# every option of `load`, and None for a tool that is not named; dt of tools and their defaults:
# 1e-6 undoes Norse's, 1 is for time constants in timesteps
CHOICES: dict[str, tuple[Any, ...]] = {
    "reset": get_args(Reset),
    "delay": (0, 1),
    "dt": (1e-4, 1e-3, 1e-2, 1.0, 1e-6),
    "spikes": get_args(SpikeCondition),
    "floor": get_args(Floor),
    "integrator": get_args(Integrator),
    "state": get_args(State),
    "written_by": (*WRITERS, None),
    "like": (*PRESETS, None),
}
# of membranes, which no spike rounds, beside their largest: float32 against float64
_TOLERANCE = 1e-4
_LONGEST = 60.0  # [s] of a search


class Recorded(NamedTuple):
    """What was recorded: input (B, T, *shape), output (B, T, *shape), names of other arrays."""

    inputs: Raster
    outputs: Raster
    unread: list[str]


def compare_with_recording(path: Path, recorded: Path, **options: Any) -> Verification:  # noqa: ANN401
    """The float twin of a file against a recording of the network that it was exported from.

    recorded: .npz with `input` (T, *shape) or (B, T, *shape), and `output` likewise
    options: options of artifact.load
    """
    given = {name: value for name, value in options.items() if value is not None}
    try:
        artifact = load(path, **given)
    except SpikedeployError as error:
        hint = _writer_hint(path, given, recorded)
        raise type(error)(f"{error}{hint}") from error
    read = read_recorded(recorded, artifact)
    size, spikes = read.outputs.size, int(np.count_nonzero(read.outputs))
    first = find_difference(artifact, read)
    if first is None and not spikes:
        raise ObservationError(
            f"{recorded}: all {size:,} outputs are 0, and ours are: equal, which says nothing, as "
            "most readings of a network are silent alike. Record it with an input at which it puts "
            "something out."
        )
    lines = [artifact.convention.describe()]
    lines += [f"not compared: {', '.join(read.unread)}"] * bool(read.unread)
    found = None
    if first is None:
        lines.append(f"your framework = our float: equal, {size:,} outputs, {spikes:,} spikes")
    else:
        found = find_cause(path, given, artifact, read, first)
        neuron = ", ".join(map(str, first.neuron))
        lines += [
            f"your framework ≠ our float: inference {first.inference}, timestep {first.timestep}, "
            f"neuron {neuron}: your framework {first.recorded:g}, our float {first.found:g}",
            f"{first.count:,} of {size:,} outputs differ",
            _conclusion(found, given.get("written_by")),
        ]
    nearest = found.nearest if found else None
    record = {
        "equal": first is None,
        "convention": artifact.convention.describe(),
        "compared": size,
        "spikes": spikes,
        "difference": first and {**vars(first), "neuron": list(first.neuron)},
        "cause": list(found.cause) if found else [],
        "nearest": nearest and {"option": nearest[0], "differ": nearest[1]},
        "unread": read.unread,
    }
    return Verification(recorded, first is None, tuple(lines), record)


def _conclusion(found: "Found", tool: str | None) -> str:
    """A sentence on what makes both equal, or on what was tried in vain."""
    if found.cause:
        return f"likeliest cause: {' and '.join(found.cause)}, with which all are equal"
    said = "no option makes both equal"
    if not found.finished:
        said = f"no option that was tried in {_LONGEST:g} s makes both equal"
    if found.nearest:
        said += f"; {found.nearest[0]} comes nearest, {found.nearest[1]:,} differ"
    never = "; ".join(WRITERS[tool].always) if tool else ""
    unsaid = f" What {tool} does not write and no option says: {never}." if never else ""
    return (
        f"{said}.{unsaid} Was the input the same, from zero states, and the file exported from "
        "this network?"
    )


def read_recorded(path: Path, artifact: Artifact) -> Recorded:
    """The arrays of a file that are the network's one input and output."""
    arrays = read_rasters(path)
    if not isinstance(arrays, dict) or not {"input", "output"} <= arrays.keys():
        found = f"the arrays {', '.join(sorted(arrays))}" if isinstance(arrays, dict) else "one"
        raise ObservationError(
            f"{path} holds {found}; needed are `input` and `output`. Write it with "
            "np.savez(path, input=…, output=…)."
        )
    graph = artifact.graph
    inputs = _batch(path, "input", arrays["input"], ports(graph.inputs))
    outputs = _batch(path, "output", arrays["output"], ports(graph.outputs))
    if inputs.shape[:2] != outputs.shape[:2]:
        raise ObservationError(
            f"{path}: input has (B, T) = {inputs.shape[:2]}, output {outputs.shape[:2]}. Record "
            "both over the same timesteps."
        )
    return Recorded(inputs, outputs, sorted(arrays.keys() - {"input", "output"}))


def _batch(path: Path, name: str, rows: Raster, nodes: tuple[Port, ...]) -> Raster:
    """(B, T, *shape) of the one node, for rows that may have no axis for the batch."""
    if len(nodes) != 1:
        names = ", ".join(port.name for port in nodes)
        raise ObservationError(
            f"the network has the {name}s {names}; only networks with one of each are compared "
            "with a recording. Use emulate, and compare its files."
        )
    (port,) = nodes
    wanted = rows[None] if rows.ndim == len(port.shape) + 1 else rows
    shape = ", ".join(map(str, port.shape))
    if wanted.ndim != len(port.shape) + 2 or wanted.shape[2:] != port.shape:
        raise ObservationError(
            f"{path}: {name} has shape {rows.shape}; node {port.name!r} needs (T, {shape}) or "
            f"(B, T, {shape}). Reshape it, or give the recording of this network."
        )
    if wanted.shape[1] == 1 and len(wanted) > 1:
        raise ObservationError(
            f"{path}: {name} has shape {rows.shape}, that is {len(wanted)} inferences of one "
            f"timestep. If its first axis is time, give (T, {shape})."
        )
    return wanted


def find_difference(
    artifact: Artifact, read: Recorded, dtype: type[np.floating[Any]] = np.float64
) -> RasterDifference | None:
    """The first difference in time; membranes are compared within a tolerance.

    States that are kept go from each inference to the next.
    """
    rows, outputs = read.inputs, read.outputs
    if artifact.convention.state == "kept":
        rows = rows.reshape(1, -1, *rows.shape[2:])
    found = FloatGraph(artifact, dtype).run(rows)["output"].reshape(outputs.shape)
    spiking = all(np.array_equal(each, np.rint(each)) for each in (found, outputs))
    return first_difference(outputs, found, 0 if spiking else _TOLERANCE * np.abs(outputs).max())


# other readings of a file


class Found(NamedTuple):
    """The result of a search.

    cause: words for the options that make both equal; empty where none was found.
    nearest: words for the single option with the fewest differences, and their number, if fewer
        differ than without it.
    finished: whether all readings were tried.
    """

    cause: tuple[str, ...]
    nearest: tuple[str, int] | None = None
    finished: bool = True


def find_cause(
    path: Path,
    given: Options,
    artifact: Artifact,
    read: Recorded,
    first: RasterDifference,
    longest: float = _LONGEST,
) -> Found:
    """The options that make a file's float twin equal to a recording.

    given: options with which the file was read as `artifact`.
    first: difference that was found so.
    longest: [s] after which no further reading is tried.
    """
    end, graph, finished = time.monotonic() + longest, read_graph_of(path), True
    counts = {"": first.count}
    if find_difference(artifact, read, np.float32) is None:
        return Found(("rounding to float32",))
    for changes in _readings(given, artifact, len(read.outputs)):
        if time.monotonic() > end:
            finished = False
            break
        if (other := _read_with(graph, given, changes)) is None:
            continue
        words = _typed(given, changes)
        found = find_difference(other, read)
        if found is None:
            return Found(words)
        if len(changes) == 1:
            counts[words[0]] = found.count
    nearest = min(counts, key=lambda words: counts[words])
    return Found((), (nearest, counts[nearest]) if nearest else None, finished)


def _readings(given: Options, artifact: Artifact, inferences: int) -> Iterator[Options]:
    """Changes to the options given, the likeliest first; a None takes an option away."""
    singles = [
        {option: choice}
        for option, choices in CHOICES.items()
        for choice in choices
        if choice != given.get(option, getattr(artifact.convention, option, None))
        and (option != "state" or inferences > 1)
    ]
    yield from (changes for changes in singles if "like" not in changes)
    if not given.get("like"):
        for tool in [given["written_by"]] if given.get("written_by") else WRITERS:
            yield from _left_open(tool, given)
    yield from (changes for changes in singles if "like" in changes)


def _left_open(tool: str, given: Options) -> Iterator[Options]:
    """Every combination of what the files of a tool leave open, as changes to the options given."""
    left = WRITERS[tool].open
    named = {} if given.get("written_by") == tool else {"written_by": tool}
    for choices in product(*(each.choices for each in left.values())):
        now = {name: given.get(name, each.choices[0]) for name, each in left.items()}
        chosen = dict(zip(left, choices, strict=True))
        yield named | {name: each for name, each in chosen.items() if each != now[name]}


def _read_with(graph: nir.NIRGraph, given: Options, changes: Options) -> Artifact | None:
    """The graph of a file read with other options; None where it cannot be."""
    wanted = {**given, **changes}
    # a tool that is named takes the place of the other one
    for named, rival in (("written_by", "like"), ("like", "written_by")):
        if changes.get(named) is not None:
            wanted[rival] = None
    try:
        return interpret(graph, wanted)
    except SpikedeployError:
        return None


def _typed(given: Options, changes: Options) -> tuple[str, ...]:
    """Options as they are typed."""
    typed = []
    for name, value in changes.items():
        option = f"--{'from' if name == 'written_by' else name}"
        if value is None:
            typed.append(f"without {option} {given[name]}")
        else:
            typed.append(f"{option} {f'{value:g}' if isinstance(value, float) else value}")
    return tuple(typed)


def _writer_hint(path: Path, given: Options, recorded: Path) -> str:
    """A sentence on the tool with whose meaning the file equals the recording, if there is one."""
    if {"like", "written_by"} & given.keys():
        return ""
    graph = read_graph_of(path)
    for tool in WRITERS:
        for changes in _left_open(tool, given):
            if (artifact := _read_with(graph, given, changes)) is not None:
                read = read_recorded(recorded, artifact)
                if read.outputs.any() and find_difference(artifact, read) is None:
                    words = " ".join(_typed(given, changes))
                    return f" With {words} your framework = our float: equal."
    return ""
