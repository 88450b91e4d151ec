"""Spikes and outputs of a run over a recording, written while it runs."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_input import Survey, TimeSteps
from spikedeploy.emulation.event_stream import Listener, node_shape
from spikedeploy.emulation.raster_emulation import LARGEST, NIR_DATA
from spikedeploy.outputs import mark
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.artifact.nir_data import EventDataWriter
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing, suffix


@contextmanager
def write_spikes(
    path: Path, artifact: Artifact, found: Survey, steps: TimeSteps | None
) -> Iterator[Listener]:
    """Yield the listener that writes spikes and output to a file, complete at the end of the block.

    .h5 is NIRData: of each layer its spikes as events, with times [s], and the output as rows. .npz
    holds rasters (T, *N).

    found: the survey of the recording.
    steps: timesteps; None where there are none.
    """
    if suffix(path) in NIR_DATA:
        seconds = found.duration(steps) / 1e6
        with replacing(path) as part, EventDataWriter(part, seconds) as writer:
            yield _Events(writer, artifact)
            writer.close(mark("emulate"), steps.us_each / 1e6 if steps else None)
        return
    size = (steps.count if steps else 0) * sum(
        int(np.prod(node_shape(artifact, name))) for name in artifact.neurons
    )
    if steps is None or size > LARGEST:
        why = f"takes {size} bytes; at most {LARGEST}" if steps else "has no timesteps"
        raise ConfigError(
            f"-o {path}: a raster of this recording {why}. Name a .h5, which holds events."
        )
    with (
        replacing(path) as part,
        TemporaryDirectory(prefix=f".{path.name}.", dir=part.parent) as folder,
    ):
        rasters = _Rasters(Path(folder), artifact, steps)
        yield rasters
        rasters.save(part)


class _Events:
    """Spikes as events of NIRData; a Listener."""

    def __init__(self, writer: EventDataWriter, artifact: Artifact) -> None:
        self._writer, self._artifact = writer, artifact

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Write spikes of layers, each as often as it was sent."""
        if name not in self._artifact.graph.inputs:
            size = int(np.prod(node_shape(self._artifact, name)))
            times = np.abs(counts).astype(np.int64)
            self._writer.add(name, size, np.repeat(neurons, times), np.repeat(at / 1e6, times))

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Write a row of the output."""
        self._writer.add_output("output", values)


class _Rasters:
    """Spikes as rasters, in temporary files until all of them are there; a Listener."""

    def __init__(self, folder: Path, artifact: Artifact, steps: TimeSteps) -> None:
        self._folder, self._artifact = folder, artifact
        self._step, self._timesteps = steps.us_each, steps.count
        self._rasters: dict[str, NDArray[Any]] = {}

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Write spikes of layers into the row of their timestep."""
        if name not in self._artifact.graph.inputs:
            kind = np.int64 if name in self._artifact.sigma_delta else np.uint8
            rows = self._raster(name, node_shape(self._artifact, name), kind)
            rows[np.rint(at / self._step).astype(np.int64), neurons] = counts

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Write a row of the output."""
        rows = self._raster("output", values.shape, np.float64)
        rows[round(at / self._step)] = values

    def _raster(self, name: str, shape: tuple[int, ...], kind: type) -> NDArray[Any]:
        """(T, N) of a node."""
        if name not in self._rasters:
            place = self._folder / str(len(self._rasters))
            self._rasters[name] = np.memmap(place, kind, "w+", shape=(self._timesteps, *shape))
        flat: NDArray[Any] = self._rasters[name].reshape(self._timesteps, -1)
        return flat

    def save(self, path: Path) -> None:
        """Write all rasters to a .npz file."""
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive:
            archive.comment = mark("emulate").encode()
            for name, rows in self._rasters.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(rows), allow_pickle=False)
