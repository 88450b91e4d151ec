"""Spikes and outputs of a run over a recording, written while it runs."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_stream import Listener, node_shape
from spikedeploy.emulation.open_loop import LARGEST, NIR_DATA
from spikedeploy.files import replacing
from spikedeploy.outputs import mark
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.artifact.nir_data import EventDataWriter
from spikedeploy.runtime.errors import ConfigError


@contextmanager
def write_spikes(
    path: Path, artifact: Artifact, step: float | None, timesteps: int, duration: float
) -> Iterator[Listener]:
    """Yield the listener that writes spikes and output to a file, complete at the end of the block.

    .h5 is NIRData: of each layer its spikes as events, with times [s], and the output as rows. .npz
    holds rasters (T, *N).

    step: a timestep [us]; None where there are none.
    duration: of the recording [us].
    """
    if path.suffix in NIR_DATA:
        with replacing(path) as part, EventDataWriter(part, duration / 1e6) as writer:
            yield _Events(writer, artifact)
            writer.close(mark("emulate"), None if step is None else step / 1e6)
        return
    size = timesteps * sum(int(np.prod(node_shape(artifact, name))) for name in artifact.neurons)
    if step is None or size > LARGEST:
        found = "has no timesteps" if step is None else f"takes {size} bytes; at most {LARGEST}"
        raise ConfigError(
            f"-o {path}: a raster of this recording {found}. Name a .h5, which holds events."
        )
    with (
        replacing(path) as part,
        TemporaryDirectory(prefix=f".{path.name}.", dir=part.parent) as folder,
    ):
        rasters = _Rasters(Path(folder), artifact, step, timesteps)
        yield rasters
        rasters.save(part)


class _Events:
    """Spikes as events of NIRData; a Listener."""

    def __init__(self, writer: EventDataWriter, artifact: Artifact) -> None:
        self._writer, self._artifact = writer, artifact

    def hear(self, name: str, at: float, neurons: NDArray[Any], counts: NDArray[Any]) -> None:
        """Write spikes of layers, each as often as it was sent."""
        if name not in self._artifact.graph.inputs:
            size = int(np.prod(node_shape(self._artifact, name)))
            sent = np.repeat(neurons, np.abs(counts).astype(np.int64))
            self._writer.add(name, size, sent, at / 1e6)

    def hear_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Write a row of the output."""
        self._writer.add_output("output", values)


class _Rasters:
    """Spikes as rasters, in temporary files until all of them are there; a Listener."""

    def __init__(self, folder: Path, artifact: Artifact, step: float, timesteps: int) -> None:
        self._folder, self._artifact, self._step = folder, artifact, step
        self._timesteps = timesteps
        self._rows: dict[str, NDArray[Any]] = {}

    def hear(self, name: str, at: float, neurons: NDArray[Any], counts: NDArray[Any]) -> None:
        """Write spikes of layers into the row of their timestep."""
        if name not in self._artifact.graph.inputs:
            kind = np.int64 if name in self._artifact.sigma_delta else np.uint8
            self._row(name, at, node_shape(self._artifact, name), kind)[neurons] = counts

    def hear_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Write a row of the output."""
        self._row("output", at, values.shape, np.float64)[:] = values.ravel()

    def _row(self, name: str, at: float, shape: tuple[int, ...], kind: type) -> NDArray[Any]:
        if name not in self._rows:
            place = self._folder / str(len(self._rows))
            self._rows[name] = np.memmap(place, kind, "w+", shape=(self._timesteps, *shape))
        row: NDArray[Any] = self._rows[name][round(at / self._step)].reshape(-1)
        return row

    def save(self, path: Path) -> None:
        """Write all rasters to a .npz file."""
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive:
            archive.comment = mark("emulate").encode()
            for name, rows in self._rows.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(rows), allow_pickle=False)
