"""Spikes of layers that were recorded on silicon, against the same network on an emulated chip.

The arrays are those of the NIR paper: (T, N) of one sample, (N, T) by one of its tools, and spike
counts (bins, B, *N) of several samples where a chip's events had no timesteps.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.open_loop import emulate_artifact
from spikedeploy.emulation.rasters import Raster, read_inputs, read_rasters
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.graph.ports import ports

_MOST = 2**31  # spikes of a neuron in a row, which no recording reaches; sums stay below 2**63
_COUNTED = "times are not compared: the file has fewer rows than the input has timesteps"
_TURNED = "read as (neurons, timesteps)"


@dataclass(frozen=True)
class RecordedActivity:
    """A layer of a recording beside the emulated one.

    path: of the recording.
    samples, timesteps: of the input.
    numbers: compared, spikes of a neuron in a timestep or, where times are not compared, in all.
    agree: of them.
    recorded, emulated, common: spikes there, here, and of the same neuron and timestep.
    difference: the first, in words; empty where there is none.
    """

    path: Path
    chip: str
    layer: str
    samples: int
    timesteps: int
    neurons: int
    numbers: int
    agree: int
    recorded: int
    emulated: int
    common: int
    difference: str
    reading: tuple[str, ...] = ()

    @property
    def equal(self) -> bool:
        """Whether all numbers agree."""
        return self.agree == self.numbers

    def describe(self) -> str:
        """The comparison in one sentence."""
        of = f"{self.timesteps:,} timesteps of {self.neurons:,} neurons"
        samples = f" in {self.samples} samples" if self.samples > 1 else ""
        return (
            f"layer {self.layer!r} on {self.chip}, {of}{samples}: {self.agree:,} of "
            f"{self.numbers:,} numbers agree; {self.recorded:,} spikes recorded, "
            f"{self.emulated:,} emulated, {self.common:,} the same"
        )

    def remarks(self) -> list[str]:
        """The first difference, how the array was read, where the chip departs from the file."""
        first = [f"first difference: {self.difference}"] if self.difference else []
        return [*first, *self.reading]

    def as_json(self) -> dict[str, Any]:
        """The fields as plain data."""
        found = {**vars(self), "file": str(self.path), "equal": self.equal, "error": None}
        return {**found, "reading": list(self.reading), "path": str(self.path)}


def against_activity(
    recording: Path,
    network: Path,
    inputs: Path,
    chip: str,
    layer: str | None = None,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
    **convention: Any,  # noqa: ANN401
) -> list[RecordedActivity]:
    """Every recorded layer beside the emulated one.

    recording  .npy of one layer, or .npz of arrays by the names of their nodes
    inputs     .npy, (T, *shape) or, of several samples, (B, T, *shape)
    layer      of a .npy, without it the only one of that shape; or the only one of a .npz
    convention  options of artifact.load
    """
    wanted = _wanted(recording, _recorded(recording), layer)
    artifact = load(network, **convention)
    samples = _samples(inputs, artifact)
    played = [
        emulate_artifact(artifact, chip, rows, limits=limits, quantisation=quantisation)
        for rows in samples
    ]
    names = played[0].spikes
    spikes = {name: np.stack([each.spikes[name] for each in played]) for name in names}
    first, *others = (_layer(recording, chip, name, rows, spikes) for name, rows in wanted)
    # of the network, so once
    return [replace(first, reading=(*first.reading, *played[0].remarks)), *others]


def _recorded(path: Path) -> Raster | dict[str, Raster]:
    """The arrays of a recording, whose numbers are spikes or counts of them."""
    found = read_rasters(path)
    for rows in found.values() if isinstance(found, dict) else [found]:
        wrong = rows[(rows < 0) | (rows > _MOST) | (rows != np.rint(rows))]
        if wrong.size:
            raise ObservationError(
                f"{path} holds numbers such as {wrong[0]:g}; spikes are 0, 1 or counts of them, "
                f"at most {_MOST:,}"
            )
    return found


def _wanted(
    path: Path, found: Raster | dict[str, Raster], layer: str | None
) -> Sequence[tuple[str | None, Raster]]:
    """The arrays to be compared, by the name of a layer; None where the shape has to tell it."""
    if not isinstance(found, dict):
        return [(layer, found)]
    if layer is None:
        return list(found.items())
    if layer not in found:
        first = ", ".join(islice(found, 8))
        raise ObservationError(
            f"{path}: no array is called {layer!r}, as --layer says; it begins with {first}"
        )
    return [(layer, found[layer])]


def _samples(path: Path, artifact: Artifact) -> Raster:
    """(B, T, *shape) of the network's one Input."""
    found = ports(artifact.graph.inputs)
    rows = read_inputs(path, artifact)
    if len(found) != 1 or isinstance(rows, dict):
        raise ObservationError(
            f"{path}: recordings are compared of networks with one Input, whose input is one "
            f"array; the network has {len(found)}"
        )
    return rows[None] if rows.ndim == len(found[0].shape) + 1 else rows


def _layer(
    path: Path, chip: str, name: str | None, rows: Raster, spikes: Mapping[str, NDArray[Any]]
) -> RecordedActivity:
    """A recorded array beside the layer of that name, or beside the only one that it fits."""
    if name is not None and name not in spikes:
        raise ObservationError(
            f"{path}: no layer {name!r} spikes in this network; there are {', '.join(spikes)}"
        )
    fits = [
        (layer, *pair)
        for layer, seen in spikes.items()
        if name in (None, layer) and (pair := next(_readings(rows, seen), None))
    ]
    if len(fits) != 1:
        raise ObservationError(_unclear(path, name, rows, spikes, [layer for layer, *_ in fits]))
    layer, there, here, reading = fits[0]
    seen = spikes[layer]
    return RecordedActivity(
        path,
        chip,
        layer,
        len(seen),
        seen.shape[1],
        int(np.prod(seen.shape[2:])),
        there.size,
        int((there == here).sum()),
        int(there.sum()),
        int(here.sum()),
        int(np.minimum(there, here).sum()),
        _first(there, here),
        reading,
    )


def _readings(
    rows: Raster, seen: NDArray[Any]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], tuple[str, ...]]]:
    """Recorded and emulated (B, T, N), or counts (B, 1, N), in the ways in which shapes fit."""
    samples, timesteps, *shape = seen.shape
    neurons = int(np.prod(shape))
    flat = seen.reshape(samples, timesteps, neurons).astype(np.int64)
    counts = flat.sum(axis=1, keepdims=True)
    whole, single = rows.astype(np.int64), samples == 1
    for tail in (tuple(shape), (neurons,)):
        if rows.shape == (samples, timesteps, *tail) or (
            single and rows.shape == (timesteps, *tail)
        ):
            yield whole.reshape(flat.shape), flat, ()
    if single and rows.shape == (neurons, timesteps):
        yield whole.T[None], flat, (_TURNED,)
    for tail in (tuple(shape), (neurons,)):
        batched = rows.shape[1:] == (samples, *tail)
        if rows.shape[0] < timesteps and (batched or (single and rows.shape[1:] == tail)):
            yield whole.sum(axis=0).reshape(counts.shape), counts, (_COUNTED,)


def _first(there: NDArray[np.int64], here: NDArray[np.int64]) -> str:
    """The first difference in time."""
    places = np.argwhere(there != here)
    if not len(places):
        return ""
    sample, t, n = places[np.lexsort((places[:, 0], places[:, 1]))[0]]
    when = f"timestep {t}, " if there.shape[1] > 1 else ""
    which = f"sample {sample}, " if len(there) > 1 else ""
    both = f"recorded {there[sample, t, n]}, emulated {here[sample, t, n]}"
    return f"{which}{when}neuron {n}: {both}"


def _unclear(
    path: Path,
    name: str | None,
    rows: Raster,
    spikes: Mapping[str, NDArray[Any]],
    fits: list[str],
) -> str:
    if fits:
        return f"{path}: {' and '.join(fits)} have that shape. Name one with --layer."
    known = spikes if name is None else {name: spikes[name]}
    shapes = ", ".join(f"{each} {seen.shape}" for each, seen in known.items())
    told = "and no layer fits" if name is None else f"which layer {name!r} does not have"
    return (
        f"{path} has shape {rows.shape}, {told}; emulated, as (samples, timesteps, "
        f"neurons): {shapes}. Record the layer over the input's timesteps, a row for each, or its "
        "counts as (bins, samples, neurons)."
    )
