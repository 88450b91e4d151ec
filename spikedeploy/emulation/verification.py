"""Recordings of others beside ours: traces of emulators, and spikes of silicon.

`replay_trace` replays a trace file.

`against_activity` compares an emulated chip with spikes of layers that a chip was seen to send, in
the arrays of the NIR paper: (T, N) of one sample, (N, T) by one of its tools, and spike counts
(bins, B, *N) of several samples where a chip's events had no timesteps.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.raster_emulation import emulate_artifact
from spikedeploy.emulation.rasters import Raster, read_inputs, read_rasters
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.graph.ports import ports
from spikedeploy.runtime.traces.fields import escape, shown_names
from spikedeploy.runtime.traces.verify import verify
from spikedeploy.user_errors import one_line

Counts = NDArray[np.int64]

_MOST = 2**31  # spikes of a neuron in a row, which no recording reaches; sums stay below 2**63
_COUNTED = "times are not compared: the file has fewer rows than the input has timesteps"
_TURNED = "read as (neurons, timesteps)"


@dataclass(frozen=True)
class Verification:
    """A recording beside ours.

    path: path of the recording
    equal: whether every number is the recorded one
    lines: the result; then the first difference, what was not compared, how it was read
    record: all of it as plain data
    failed: whether it could not be compared
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


@dataclass(frozen=True)
class RasterDifference:
    """The first number that is not the recorded one.

    count: number of those that differ.
    """

    inference: int
    timestep: int
    neuron: tuple[int, ...]
    recorded: float
    found: float
    count: int


def first_difference(
    recorded: NDArray[Any], found: NDArray[Any], tolerance: float = 0
) -> RasterDifference | None:
    """The first difference in time of two arrays (B, T, *N); None where there is none."""
    places = np.argwhere(np.abs(found - recorded.astype(np.float64)) > tolerance)
    if not len(places):
        return None
    place = tuple(map(int, places[np.lexsort((places[:, 0], places[:, 1]))[0]]))
    numbers = float(recorded[place]), float(found[place])
    return RasterDifference(place[0], place[1], place[2:], *numbers, len(places))


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

    recording: .npy of one layer, or .npz of arrays by the names of their nodes
    inputs: .npy, (T, *shape) or, of several samples, (B, T, *shape)
    layer: of a .npy, without it the only one of that shape; or the only one of a .npz
    convention: options of artifact.load
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
        found.append(_compare_layer(recording, chip, name, rows, spikes, remarks))
        remarks = ()
    if not any(each.record["recorded"] or each.record["emulated"] for each in found):
        raise ObservationError(
            f"{recording}: no neuron spikes, neither recorded nor emulated: equal, which says "
            "nothing. Record the chip with an input at which its neurons spike."
        )
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


def _compare_layer(
    path: Path,
    chip: str,
    name: str | None,
    rows: Raster,
    spikes: Mapping[str, NDArray[Any]],
    remarks: tuple[str, ...],
) -> Verification:
    """Compare a recorded array with the layer of that name, or the only one that it fits."""
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
    first, neurons = first_difference(there, here), there.shape[2]
    agree = there.size - (first.count if first else 0)
    sent = [int(each.sum()) for each in (there, here, np.minimum(there, here))]
    more = f" in {samples} samples" if samples > 1 else ""
    text = (
        f"layer {layer!r} on {chip}, {timesteps:,} timesteps of {neurons:,} neurons{more}: "
        f"{agree:,} of {there.size:,} numbers agree; {sent[0]:,} spikes recorded, {sent[1]:,} "
        f"emulated, {sent[2]:,} the same"
    )
    said = ""
    if first:
        said = f"sample {first.inference}, " if samples > 1 else ""
        said += f"timestep {first.timestep}, " if there.shape[1] > 1 else ""
        said += f"neuron {first.neuron[0]}: recorded {first.recorded:g}, emulated {first.found:g}"
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
        "difference": said,
        "reading": [*reading, *remarks],
        "file": str(path),
        "equal": first is None,
        "error": None,
    }
    differs = (f"first difference: {said}",) if first else ()
    return Verification(path, first is None, (text, *differs, *reading, *remarks), record)


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
