"""Other readings of a file, tried until one computes what a framework recorded.

An option of `load` is tried with each of its choices, in the order in which options are usually to
blame; then rounding to float32, every combination of what a tool's files leave open, and options
two at a time. A recording whose spikes all have one height other than 1 is compared with spikes
of that height, in the last layer and in all: snnTorch's graded_spikes_factor, which no file holds.
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any, NamedTuple, get_args

import nir
import numpy as np

from spikedeploy.emulation.rasters import Raster
from spikedeploy.emulation.verification import first_in_time
from spikedeploy.runtime.artifact.artifact import Artifact, interpret, read_graph_of
from spikedeploy.runtime.convention import Floor, Integrator, Reset, Spikes, State
from spikedeploy.runtime.dialects.tools import PRESETS, WRITERS
from spikedeploy.runtime.errors import SpikedeployError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.neurons import SPIKING

Options = dict[str, Any]  # of artifact.load

# every option of `load`, and None for a tool that is not named; dt of tools and their defaults:
# 1e-6 undoes Norse's, 1 is for time constants in timesteps
CHOICES: dict[str, tuple[Any, ...]] = {
    "reset": get_args(Reset),
    "delay": (0, 1),
    "dt": (1e-4, 1e-3, 1e-2, 1.0, 1e-6),
    "spikes": get_args(Spikes),
    "floor": get_args(Floor),
    "integrator": get_args(Integrator),
    "state": get_args(State),
    "written_by": (*WRITERS, None),
    "like": (*PRESETS, None),
}
_TOOLS = ("written_by", "like")  # of which one can be given
_EARLY = ("dt", *_TOOLS)  # without which a file cannot be interpreted

# of membranes, which no spike rounds, beside their largest: float32 against float64
_TOLERANCE = 1e-4
LONGEST = 60.0  # [s] of a search


@dataclass(frozen=True)
class RecordedDifference:
    """The first output that is not the recorded one.

    count: number of outputs that differ.
    """

    inference: int
    timestep: int
    neuron: tuple[int, ...]
    expected: float
    found: float
    count: int


def find_difference(
    artifact: Artifact,
    inputs: Raster,
    outputs: Raster,
    dtype: type[np.floating[Any]] = np.float64,
) -> RecordedDifference | None:
    """The first difference in time; membranes are compared within a tolerance.

    States that are kept go from each inference to the next.
    """
    rows = inputs
    if artifact.convention.state == "kept":
        rows = inputs.reshape(1, -1, *inputs.shape[2:])
    found = FloatGraph(artifact, dtype).run(rows)["output"].reshape(outputs.shape)
    spiking = all(np.array_equal(rows, np.rint(rows)) for rows in (found, outputs))
    tolerance = 0.0 if spiking else _TOLERANCE * float(np.abs(outputs).max())
    places = np.argwhere(np.abs(found - outputs.astype(np.float64)) > tolerance)
    if not len(places):
        return None
    place = tuple(int(n) for n in first_in_time(places))
    return RecordedDifference(
        place[0], place[1], place[2:], float(outputs[place]), float(found[place]), len(places)
    )


class Found(NamedTuple):
    """The result of a search.

    cause: words for the options that make both equal; empty where none was found.
    nearest: words for the single change with the fewest differences, and their number, if fewer
        differ than without it.
    tried: readings that were compared.
    left: readings that the time did not suffice for.
    """

    cause: tuple[str, ...]
    nearest: tuple[str, int] | None
    tried: int
    left: int


def find_cause(
    path: Path,
    given: Options,
    artifact: Artifact,
    inputs: Raster,
    outputs: Raster,
    first: RecordedDifference,
    longest: float = LONGEST,
) -> Found:
    """The options that make a file's float twin equal to a recording.

    given: options with which the file was read as `artifact`.
    first: difference that was found so.
    longest: [s] after which no further reading is tried.
    """
    end, tried, counts = time.monotonic() + longest, 0, dict[str, int]()
    graph, upto = read_graph_of(path), first.timestep + 1
    readings = list(_readings(given, artifact, outputs))
    for number, reading in enumerate(readings):
        if time.monotonic() > end:
            return Found((), _nearest(counts, first), tried, len(readings) - number)
        if (other := read_with(graph, given, reading.changes)) is None:
            continue
        network, words = other
        if reading.factor is not None:
            network = _with_height(network, reading.factor, reading.everywhere)
        tried += 1
        # most pairs fail at the timestep of the first difference already
        early = reading.pair and network.convention.state != "kept"
        if early and find_difference(network, inputs[:, :upto], outputs[:, :upto]) is not None:
            continue
        found = find_difference(network, inputs, outputs, reading.dtype)
        words = (*words, *reading.words)
        if found is None:
            return Found(words, None, tried, 0)
        if not reading.pair and reading.changes:
            counts[words[0]] = found.count
    return Found((), _nearest(counts, first), tried, 0)


def _nearest(counts: Mapping[str, int], first: RecordedDifference) -> tuple[str, int] | None:
    nearest = min(counts, key=lambda words: counts[words], default=None)
    if nearest is None or counts[nearest] >= first.count:
        return None
    return nearest, counts[nearest]


class _Reading(NamedTuple):
    """Changes to the options, and what no option chooses; a None takes an option away."""

    changes: Options
    pair: bool = False
    factor: float | None = None
    everywhere: bool = False
    dtype: type[np.floating[Any]] = np.float64
    words: tuple[str, ...] = ()


def _readings(given: Options, artifact: Artifact, outputs: Raster) -> Iterator[_Reading]:
    """All readings, the likeliest first."""
    singles = [
        {option: choice}
        for option, choices in CHOICES.items()
        for choice in choices
        if choice != given.get(option, getattr(artifact.convention, option, None))
        and (option != "state" or len(outputs) > 1)
    ]
    likes = [changes for changes in singles if "like" in changes]
    others = [changes for changes in singles if "like" not in changes]
    yield from (_Reading(changes) for changes in others)
    yield _Reading({}, dtype=np.float32, words=("rounding to float32",))
    for tool in _tools(given):
        yield from (_Reading(changes, pair=True) for changes in left_open(tool, given))
    yield from (_Reading(changes) for changes in likes)
    if (factor := _height(outputs)) is not None:
        for everywhere, layers in ((False, "the last layer"), (True, "every layer")):
            words = (f"spikes of height {factor:g} in {layers}, which no file of a tool holds",)
            for changes in ({}, *singles):
                yield _Reading(changes, True, factor, everywhere, words=words)
    for one, two in combinations(others, 2):
        if not one.keys() & two.keys():
            yield _Reading(one | two, pair=True)


def _tools(given: Options) -> tuple[str, ...]:
    """Tools that may have written the file."""
    if given.get("like"):
        return ()
    return (given["written_by"],) if given.get("written_by") else tuple(WRITERS)


def left_open(tool: str, given: Options) -> Iterator[Options]:
    """Every combination of what the files of a tool leave open, as changes to the options given."""
    left = WRITERS[tool].open
    named = {} if given.get("written_by") == tool else {"written_by": tool}
    for choices in product(*(each.choices for each in left.values())):
        now = {name: given.get(name, each.choices[0]) for name, each in left.items()}
        chosen = dict(zip(left, choices, strict=True))
        yield named | {name: each for name, each in chosen.items() if each != now[name]}


def _height(outputs: Raster) -> float | None:
    """The height of all spikes of a recording, if they have one other than 1."""
    heights = np.unique(outputs[outputs != 0])
    return float(heights[0]) if len(heights) == 1 and heights[0] != 1 else None


def _with_height(artifact: Artifact, factor: float, everywhere: bool) -> Artifact:
    """The network whose spikes have this height, of all layers or of those before an Output."""
    graph = artifact.graph
    last = {source for source, target in graph.edges if target in graph.outputs}
    nodes, edges = dict(graph.nodes), set(graph.edges)
    for name, node in graph.nodes.items():
        if isinstance(node, SPIKING) and (everywhere or name in last):
            after = f"{name}.height"
            nodes[after] = nir.Scale(np.full(node.r.shape, factor))
            moved = {edge for edge in edges if edge[0] == name}
            edges = edges - moved | {(after, target) for _, target in moved} | {(name, after)}
    return replace(artifact, graph=nir.NIRGraph(nodes, sorted(edges), type_check=False))


def read_with(
    graph: nir.NIRGraph, given: Options, changes: Options
) -> tuple[Artifact, tuple[str, ...]] | None:
    """The graph of a file read with other options, and words for them; None where it cannot be."""
    wanted = {n: value for n, value in {**given, **changes}.items() if value is not None}
    for named, rival in (_TOOLS, _TOOLS[::-1]):
        # a tool that is named takes the place of the other one
        if changes.get(named) is not None and given.get(rival) is not None:
            wanted.pop(rival)
    try:
        return interpret(graph, wanted), _as_typed(given, changes)
    except SpikedeployError:
        pass
    # what no option of the tool says can still be to blame; dt and gains go together
    late = {name: wanted.pop(name) for name in changes if name in wanted and name not in _EARLY}
    if not late:
        return None
    try:
        read = interpret(graph, wanted)
        changed = read.with_convention(read.convention.with_options(late))
    except SpikedeployError:
        return None
    tool = wanted.get("written_by") or wanted.get("like")
    refused = f"which {tool} does not do" if tool else "which the file contradicts"
    typed = _as_typed(given, changes)
    return changed, (*typed[:-1], f"{typed[-1]} ({refused})")


def typed_name(option: str) -> str:
    """The option of `load` as it is typed."""
    return f"--{'from' if option == 'written_by' else option}"


def _as_typed(given: Options, changes: Options) -> tuple[str, ...]:
    """Options as they are typed."""
    typed = []
    for name, value in changes.items():
        option = typed_name(name)
        if value is None:
            typed.append(f"without {option} {given[name]}")
        else:
            typed.append(f"{option} {f'{value:g}' if isinstance(value, float) else value}")
    return tuple(typed)
