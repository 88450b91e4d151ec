"""Spikes and outputs of a run over a recording, written while it runs."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_input import EventInput
from spikedeploy.emulation.event_stream import Listener, node_shape
from spikedeploy.emulation.raster_emulation import NIR_DATA
from spikedeploy.emulation.rasters import write_rasters
from spikedeploy.outputs import mark
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.artifact.nir_data import EventDataWriter
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing, suffix

_LARGEST = 1 << 30  # bytes of rasters in memory


@contextmanager
def write_spikes(path: Path, artifact: Artifact, given: EventInput) -> Iterator[Listener]:
    """Yield the listener that writes spikes and output to a file, complete at the end of the block.

    .h5 is NIRData: of each layer its spikes as events, with times [s], and the output as rows. .npz
    holds rasters (T, *N).
    """
    step = given.step_us
    if suffix(path) in NIR_DATA:
        with replacing(path) as part, EventDataWriter(part, given.duration / 1e6) as writer:
            yield _Events(writer, artifact)
            writer.close(mark("emulate"), step and step / 1e6)
        return
    sizes = (int(np.prod(node_shape(artifact, name))) for name in artifact.neurons)
    size = given.timesteps * sum(sizes)
    if step is None or size > _LARGEST:
        why = f"takes {size} bytes; at most {_LARGEST}" if step else "has no timesteps"
        raise ConfigError(
            f"-o {path}: a raster of this recording {why}. Name a .h5, which holds events."
        )
    rasters = _Rasters(artifact, step, given.timesteps)
    yield rasters
    write_rasters(path, rasters.rows, mark("emulate"))


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
    """Spikes as rasters; a Listener.

    rows: node -> (T, *N).
    """

    def __init__(self, artifact: Artifact, step_us: float, timesteps: int) -> None:
        self._artifact, self._step, self._timesteps = artifact, step_us, timesteps
        self.rows: dict[str, NDArray[Any]] = {}

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Write spikes of layers into the row of their timestep."""
        if name not in self._artifact.graph.inputs:
            kind = np.int64 if name in self._artifact.sigma_delta else np.uint8
            rows = self._raster(name, node_shape(self._artifact, name), kind)
            flat = rows.reshape(self._timesteps, -1)
            flat[np.rint(at / self._step).astype(np.int64), neurons] = counts

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Write a row of the output."""
        self._raster("output", values.shape, np.float64)[round(at / self._step)] = values

    def _raster(self, name: str, shape: tuple[int, ...], kind: type) -> NDArray[Any]:
        if name not in self.rows:
            self.rows[name] = np.zeros((self._timesteps, *shape), kind)
        return self.rows[name]
