"""Recordings of others beside ours: traces of emulators, spikes of a framework and of silicon.

`replay_trace` replays a trace file. `compare_with_recording` compares the float twin of an exported
file with what the framework computed. Where they differ other conventions are tried, in the order
in which they are usually to blame: reset, delay, dt, threshold rule, then integrator, the tool that
wrote the file, and rounding; then two of them together.

`against_activity` compares an emulated chip with spikes of layers that a chip was seen to send, in
the arrays of the NIR paper: (T, N) of one sample, (N, T) by one of its tools, and spike counts
(bins, B, *N) of several samples where a chip's events had no timesteps.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations, islice
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.open_loop import emulate_artifact
from spikedeploy.emulation.rasters import Raster, read_inputs, read_rasters
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.convention import Integrator, Reset, Spikes
from spikedeploy.runtime.dialects.tools import WRITERS
from spikedeploy.runtime.errors import ObservationError, SpikedeployError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import Port, ports
from spikedeploy.runtime.traces.fields import escape, shown_names
from spikedeploy.runtime.traces.verify import verify
from spikedeploy.user_errors import one_line

Options = dict[str, Any]  # of artifact.load
Counts = NDArray[np.int64]

# of membranes, which no spike rounds, beside their largest: float32 against float64
_TOLERANCE = 1e-4
# of tools and their defaults; 1e-6 undoes Norse's, 1 is for time constants in timesteps
_TIMESTEPS = (1e-4, 1e-3, 1e-2, 1.0, 1e-6)
_CHOICES: dict[str, tuple[Any, ...]] = {
    "reset": get_args(Reset),
    "delay": (0, 1),
    "dt": _TIMESTEPS,
    "spikes": get_args(Spikes),
    "integrator": get_args(Integrator),
    "written_by": tuple(WRITERS),
}
_MOST = 2**31  # spikes of a neuron in a row, which no recording reaches; sums stay below 2**63
_COUNTED = "times are not compared: the file has fewer rows than the input has timesteps"
_TURNED = "read as (neurons, timesteps)"


@dataclass(frozen=True)
class Verification:
    """A recording beside ours.

    path    of the recording
    equal   whether every number is the recorded one
    lines   the result; then the first difference, what was not compared, how it was read
    record  all of it as plain data
    failed  whether it could not be compared
    """

    path: Path
    equal: bool
    lines: tuple[str, ...]
    record: Mapping[str, Any] = field(default_factory=dict)
    failed: bool = False


def replay_trace(path: Path) -> Verification:
    """A trace file beside the emulator's arithmetic; one that cannot be replayed has failed."""
    try:
        found = verify(path)
    except Exception as error:
        line = one_line(error)
        if line is None:
            raise
        why = line.removeprefix(f"{path}: ")
        record = {"file": str(path), "equal": False, "error": why}
        return Verification(path, False, (f"not replayed: {why}",), record, failed=True)
    if found.difference is not None:
        lines = [f"differs on {found.chip}: {found.difference.describe()}"]
    else:
        what = f"{found.compared:,} numbers of {found.steps} timesteps"
        lines = [f"equal on {found.chip}: {what}; recorded by {escape(found.source, 200)}"]
    if found.passed_over:
        lines.append(f"not compared: {found.passed_over} {found.why}")
    if found.unread:
        lines.append(f"not compared: fields that are not used: {shown_names(found.unread)}")
    record = {"file": str(path), **found.as_json(), "error": None}
    return Verification(path, found.equal, (*lines, *found.remarks), record)


# what a framework recorded


@dataclass(frozen=True)
class RecordedDifference:
    """The first output that is not the recorded one.

    count: of outputs that differ.
    """

    inference: int
    timestep: int
    neuron: tuple[int, ...]
    expected: float
    found: float
    count: int


def compare_with_recording(path: Path, recorded: Path, **options: Any) -> Verification:  # noqa: ANN401
    """The float twin of a file against a recording of the network that it was exported from.

    recorded  .npz with `input` (T, *shape) or (B, T, *shape), and `output` likewise
    options   of artifact.load
    """
    given = {name: value for name, value in options.items() if value is not None}
    try:
        artifact = load(path, **given)
    except SpikedeployError as error:
        hint = _writer_hint(path, given, recorded)
        raise type(error)(f"{error}{hint}") from error
    inputs, outputs, unread = read_recorded(recorded, artifact)
    first = find_difference(artifact, inputs, outputs)
    cause: tuple[str, ...] = ()
    nearest = None
    lines = [artifact.convention.describe()]
    if unread:
        lines.append(f"not compared: {', '.join(unread)}")
    if first is None:
        counts = f"{outputs.size:,} outputs, {np.count_nonzero(outputs):,} spikes"
        lines.append(f"your framework = our float: equal, {counts}")
    else:
        cause, nearest = _find_cause(path, given, artifact, inputs, outputs, first)
        neuron = ", ".join(map(str, first.neuron))
        lines += [
            f"your framework ≠ our float: inference {first.inference}, timestep {first.timestep}, "
            f"neuron {neuron}: your framework {first.expected:g}, our float {first.found:g}",
            f"{first.count:,} of {outputs.size:,} outputs differ",
        ]
    if cause:
        lines.append(f"likeliest cause: {' and '.join(cause)}, with which all are equal")
    elif first is not None:
        near = f"; {nearest[0]} comes nearest, {nearest[1]:,} differ" if nearest else ""
        lines.append(
            f"no option makes both equal{near}. Was the input the same, from zero states, "
            "and the file exported from this network?"
        )
    record = {
        "equal": first is None,
        "convention": artifact.convention.describe(),
        "compared": outputs.size,
        "spikes": int(np.count_nonzero(outputs)),
        "difference": first and {**vars(first), "neuron": list(first.neuron)},
        "cause": list(cause),
        "nearest": nearest and {"option": nearest[0], "differ": nearest[1]},
        "unread": unread,
    }
    return Verification(recorded, first is None, tuple(lines), record)


def read_recorded(path: Path, artifact: Artifact) -> tuple[Raster, Raster, list[str]]:
    """Input (B, T, *shape) and output (B, T, *shape), and the names of other arrays."""
    arrays = read_rasters(path)
    if not isinstance(arrays, dict) or not {"input", "output"} <= arrays.keys():
        found = f"the arrays {', '.join(sorted(arrays))}" if isinstance(arrays, dict) else "one"
        raise ObservationError(
            f"{path} holds {found}; needed are `input` and `output`. Write it with "
            "np.savez(path, input=…, output=…)."
        )
    inputs, outputs = (
        _batch(path, name, arrays[name], ports(nodes))
        for name, nodes in (("input", artifact.graph.inputs), ("output", artifact.graph.outputs))
    )
    if inputs.shape[:2] != outputs.shape[:2]:
        raise ObservationError(
            f"{path}: input has (B, T) = {inputs.shape[:2]}, output {outputs.shape[:2]}. Record "
            "both over the same timesteps."
        )
    return inputs, outputs, sorted(arrays.keys() - {"input", "output"})


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
    artifact: Artifact,
    inputs: Raster,
    outputs: Raster,
    dtype: type[np.floating[Any]] = np.float64,
) -> RecordedDifference | None:
    """The first difference in time; membranes are compared within a tolerance."""
    found = FloatGraph(artifact, dtype).run(inputs)["output"]
    spiking = all(np.array_equal(rows, np.rint(rows)) for rows in (found, outputs))
    tolerance = 0.0 if spiking else _TOLERANCE * float(np.abs(outputs).max())
    places = np.argwhere(np.abs(found - outputs.astype(np.float64)) > tolerance)
    if not len(places):
        return None
    place = tuple(int(n) for n in _first_in_time(places))
    return RecordedDifference(
        place[0], place[1], place[2:], float(outputs[place]), float(found[place]), len(places)
    )


def _first_in_time(places: NDArray[np.intp]) -> NDArray[np.intp]:
    """The place of the smallest timestep, the second axis, of places (n, axes)."""
    first: NDArray[np.intp] = places[np.lexsort((places[:, 0], places[:, 1]))[0]]
    return first


def _find_cause(
    path: Path,
    given: Options,
    artifact: Artifact,
    inputs: Raster,
    outputs: Raster,
    first: RecordedDifference,
) -> tuple[tuple[str, ...], tuple[str, int] | None]:
    """The options that make both equal; or else the nearest one, and how many outputs differ."""
    counts: dict[str, int] = {}
    singles = list(_single_changes(given, artifact))
    for changes in singles:
        if (other := _read_with(path, given, changes)) is None:
            continue
        found = find_difference(other, inputs, outputs)
        if found is None:
            return _as_typed(changes), None
        counts[_as_typed(changes)[0]] = found.count
    if find_difference(artifact, inputs, outputs, np.float32) is None:
        return ("rounding to float32",), None
    # most pairs fail at the timestep of the first difference already
    upto = first.timestep + 1
    for one, two in combinations(singles, 2):
        if one.keys() & two.keys() or (other := _read_with(path, given, one | two)) is None:
            continue
        if find_difference(other, inputs[:, :upto], outputs[:, :upto]) is None and (
            find_difference(other, inputs, outputs) is None
        ):
            return _as_typed(one | two), None
    nearest = min(counts, key=lambda words: counts[words], default=None)
    better = nearest is not None and counts[nearest] < first.count
    return (), (nearest, counts[nearest]) if nearest is not None and better else None


def _single_changes(given: Options, artifact: Artifact) -> Iterator[Options]:
    """Every other choice of every option, one at a time."""
    for option, choices in _CHOICES.items():
        if option == "written_by" and {"like", "written_by"} & given.keys():
            continue
        now = given.get(option, getattr(artifact.convention, option, None))
        yield from ({option: choice} for choice in choices if choice != now)


def _read_with(path: Path, given: Options, changes: Options) -> Artifact | None:
    """The file read with other options; None where they contradict it, or one another."""
    try:
        return load(path, **{**given, **changes})
    except SpikedeployError:
        pass
    # what no option of the tool says can still be to blame; dt and gains go together
    late = {name: value for name, value in changes.items() if name not in ("dt", "written_by")}
    early = {name: value for name, value in changes.items() if name not in late}
    try:
        read = load(path, **{**given, **early})
        return replace(read, convention=read.convention.with_options(late)) if late else None
    except SpikedeployError:
        return None


def _as_typed(changes: Options) -> tuple[str, ...]:
    """Options as they are typed."""
    return tuple(
        f"--{'from' if name == 'written_by' else name} "
        f"{f'{value:g}' if isinstance(value, float) else value}"
        for name, value in changes.items()
    )


def _writer_hint(path: Path, given: Options, recorded: Path) -> str:
    """A sentence on the tool with whose meaning the file equals the recording, if there is one."""
    for tool in () if {"like", "written_by"} & given.keys() else WRITERS:
        artifact = _read_with(path, given, {"written_by": tool})
        if artifact is not None:
            inputs, outputs, _ = read_recorded(recorded, artifact)
            if find_difference(artifact, inputs, outputs) is None:
                return f" With --from {tool} your framework = our float: equal."
    return ""


# what silicon sent


def against_activity(
    recording: Path,
    network: Path,
    inputs: Path,
    chip: str,
    layer: str | None = None,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
    **convention: Any,  # noqa: ANN401
) -> list[Verification]:
    """Every recorded layer beside the emulated one.

    recording  .npy of one layer, or .npz of arrays by the names of their nodes
    inputs     .npy, (T, *shape) or, of several samples, (B, T, *shape)
    layer      of a .npy, without it the only one of that shape; or the only one of a .npz
    convention  options of artifact.load
    """
    wanted = _read_layers(recording, layer)
    artifact = load(network, **convention)
    played = [
        emulate_artifact(artifact, chip, rows, limits=limits, quantisation=quantisation)
        for rows in _read_samples(inputs, artifact)
    ]
    spikes = {name: np.stack([each.spikes[name] for each in played]) for name in played[0].spikes}
    remarks = played[0].remarks  # of the network, so with the first layer alone
    found = []
    for name, rows in wanted.items():
        found.append(_beside(recording, chip, name, rows, spikes, remarks))
        remarks = ()
    return found


def _read_layers(path: Path, layer: str | None) -> Mapping[str | None, Raster]:
    """Recorded spikes, or counts of them, by the name of a layer; None where the shape tells it."""
    found = read_rasters(path)
    for rows in found.values() if isinstance(found, dict) else [found]:
        wrong = rows[(rows < 0) | (rows > _MOST) | (rows != np.rint(rows))]
        if wrong.size:
            raise ObservationError(
                f"{path} holds numbers such as {wrong[0]:g}; spikes are 0, 1 or counts of them, "
                f"at most {_MOST:,}"
            )
    if not isinstance(found, dict):
        return {layer: found}
    if layer is None:
        return {name: rows for name, rows in found.items()}
    if layer not in found:
        raise ObservationError(
            f"{path}: no array is called {layer!r}, as --layer says; it begins with "
            f"{', '.join(islice(found, 8))}"
        )
    return {layer: found[layer]}


def _read_samples(path: Path, artifact: Artifact) -> Raster:
    """(B, T, *shape) of the network's one Input."""
    found = ports(artifact.graph.inputs)
    rows = read_inputs(path, artifact)
    if len(found) != 1 or isinstance(rows, dict):
        raise ObservationError(
            f"{path}: recordings are compared of networks with one Input, whose input is one "
            f"array; the network has {len(found)}"
        )
    return rows[None] if rows.ndim == len(found[0].shape) + 1 else rows


def _beside(
    path: Path,
    chip: str,
    name: str | None,
    rows: Raster,
    spikes: Mapping[str, NDArray[Any]],
    remarks: tuple[str, ...],
) -> Verification:
    """A recorded array beside the layer of that name, or beside the only one that it fits."""
    if name is not None and name not in spikes:
        raise ObservationError(
            f"{path}: no layer {name!r} spikes in this network; there are {', '.join(spikes)}"
        )
    known = spikes if name is None else {name: spikes[name]}
    fits = {n: pair for n, seen in known.items() if (pair := next(_readings(rows, seen), None))}
    if len(fits) > 1:
        layers = " and ".join(fits)
        raise ObservationError(f"{path}: {layers} have that shape. Name one with --layer.")
    if not fits:
        shapes = ", ".join(f"{each} {seen.shape}" for each, seen in known.items())
        missing = "and no layer fits" if name is None else f"which layer {name!r} does not have"
        raise ObservationError(
            f"{path} has shape {rows.shape}, {missing}; emulated, as (samples, timesteps, "
            f"neurons): {shapes}. Record the layer over the input's timesteps, a row for each, or "
            "its counts as (bins, samples, neurons)."
        )
    ((layer, (there, here, reading)),) = fits.items()
    samples, timesteps, *_ = spikes[layer].shape
    neurons = there.shape[2]
    agree, first = int((there == here).sum()), _describe_first(there, here)
    sent = [int(each.sum()) for each in (there, here, np.minimum(there, here))]
    more = f" in {samples} samples" if samples > 1 else ""
    text = (
        f"layer {layer!r} on {chip}, {timesteps:,} timesteps of {neurons:,} neurons{more}: "
        f"{agree:,} of {there.size:,} numbers agree; {sent[0]:,} spikes recorded, {sent[1]:,} "
        f"emulated, {sent[2]:,} the same"
    )
    record = {
        "path": str(path),
        "chip": chip,
        "layer": layer,
        "samples": samples,
        "timesteps": timesteps,
        "neurons": neurons,
        "numbers": there.size,
        "agree": agree,
        **dict(zip(("recorded", "emulated", "common"), sent, strict=True)),
        "difference": first,
        "reading": [*reading, *remarks],
        "file": str(path),
        "equal": agree == there.size,
        "error": None,
    }
    differs = (f"first difference: {first}",) if first else ()
    return Verification(path, not first, (text, *differs, *reading, *remarks), record)


def _readings(rows: Raster, seen: NDArray[Any]) -> Iterator[tuple[Counts, Counts, tuple[str, ...]]]:
    """Recorded and emulated (B, T, N), or counts (B, 1, N), in the ways in which shapes fit."""
    samples, timesteps, *shape = seen.shape
    neurons = int(np.prod(shape))
    flat = seen.reshape(samples, timesteps, neurons).astype(np.int64)
    counts = flat.sum(axis=1, keepdims=True)
    whole, single = rows.astype(np.int64), samples == 1
    tails = (tuple(shape), (neurons,))
    fitting = {(samples, timesteps, *tail) for tail in tails}
    if rows.shape in fitting or (single and (1, *rows.shape) in fitting):
        yield whole.reshape(flat.shape), flat, ()
    if single and rows.shape == (neurons, timesteps):
        yield whole.T[None], flat, (_TURNED,)
    batched = {(samples, *tail) for tail in tails}
    if rows.shape[0] < timesteps and (
        rows.shape[1:] in batched or (single and (1, *rows.shape[1:]) in batched)
    ):
        yield whole.sum(axis=0).reshape(counts.shape), counts, (_COUNTED,)


def _describe_first(there: Counts, here: Counts) -> str:
    """The first difference in time; empty where there is none."""
    places = np.argwhere(there != here)
    if not len(places):
        return ""
    sample, t, n = _first_in_time(places)
    when = f"timestep {t}, " if there.shape[1] > 1 else ""
    which = f"sample {sample}, " if len(there) > 1 else ""
    both = f"recorded {there[sample, t, n]}, emulated {here[sample, t, n]}"
    return f"{which}{when}neuron {n}: {both}"
