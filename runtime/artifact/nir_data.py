"""NIRData: recorded spikes of a graph's nodes in HDF5, as other tools exchange them.

NIRGraphData holds observables of nodes, each (samples, T, N) on a grid of dt, or events with times
in seconds (nir.data_ir, since nir 1.0.8). Its own conversion of events loses those whose time
rounds to just below their timestep; here an event belongs to the nearest start of a timestep where
it is within a thousandth of dt.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.hdf5 import byte_budget, check_container
from spikedeploy.runtime.errors import ArtifactError, ObservationError

# bytes that a file may unpack to, and more for each of its own: spikes shrink two hundredfold
FREE, EXPANSION = 128 << 20, 20
_EVENT_BYTES = 128 << 20  # of all arrays of events, of which several copies are made
_EVENT_ROUNDING = 1e-3  # of a timestep
_SPIKES = "spikes"
_APPENDED = 4096  # numbers that are stored together in an array that grows


def is_nir_data(path: Path) -> bool:
    """True if a file is HDF5 and so may hold NIRData."""
    return bool(h5py.is_hdf5(path))


def read_nir_data(
    path: Path, shapes: Mapping[str, tuple[int, ...]], dt: float
) -> dict[str, NDArray[Any]]:
    """Values (T, *shape) of each node in `shapes`; of a single one the file's only node will do.

    dt: [s] of the network, on which events are laid and which a grid must have.
    """
    most = byte_budget(path, FREE, EXPANSION)
    try:
        check_container(path, most)
        nodes = nir.read_data(path).nodes
    except ArtifactError as error:
        raise ObservationError(f"{path} is HDF5 and no NIRData: {error}") from error
    # h5py and nir raise exceptions of many types for a damaged file
    except Exception as error:
        raise ObservationError(
            f"{path} is HDF5 and no NIRData: {error}. Write it with nir.write_data."
        ) from error
    if len(shapes) == len(nodes) == 1:
        nodes = dict(zip(shapes, nodes.values(), strict=True))
    if missing := sorted(shapes.keys() - nodes.keys()):
        raise ObservationError(
            f"{path} holds data of {', '.join(sorted(nodes)) or 'no node'}; node {missing[0]!r} of "
            "the network needs some. Name it so."
        )
    return {
        name: _node_grid(f"{path}: node {name!r}", nodes[name], dt, shape, most)
        for name, shape in shapes.items()
    }


def write_nir_data(
    path: Path, rows: Mapping[str, NDArray[Any]], dt: float, remark: str = ""
) -> None:
    """Write values (T, *N) of nodes on a grid: spikes, as bool where they are 0 or 1."""
    nodes = {}
    for name, values in rows.items():
        flat = values.reshape(1, len(values), -1)
        binary = flat.dtype.kind in "biu" and flat.min() >= 0 and flat.max() <= 1
        grid = nir.TimeGriddedData(flat.astype(bool) if binary else flat, dt)
        nodes[name] = nir.NIRNodeData({_SPIKES if flat.dtype.kind in "biu" else "output": grid})
    nir.write_data(path, nir.NIRGraphData(nodes))
    if remark:
        with h5py.File(path, "r+") as file:
            file.attrs["remark"] = remark


class EventDataWriter:
    """A file of NIRData that grows, as events of nodes and rows of an output; a context manager.

    duration: [s] of the whole recording.
    """

    def __init__(self, path: Path, duration: float) -> None:
        self._file, self._duration = h5py.File(path, "w"), duration
        self._file.attrs["__type__"] = "NIRGraphData"
        self._file.create_group("nodes")
        # of each array the parts that are not written yet, since a write takes a tenth of a
        # millisecond
        self._waiting: dict[str, list[NDArray[Any]]] = {}

    def __enter__(self) -> "EventDataWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, node: str, neurons: int, idx: NDArray[Any], time: NDArray[Any]) -> None:
        """Append spikes of a node of so many neurons: indices (k,) and times (k,) [s]."""
        place = f"nodes/{node}/observables/{_SPIKES}"
        if place not in self._file:
            self._create(node, _SPIKES, "EventData")
            self._file[place].attrs.update(n_neurons=neurons, t_max=self._duration)
        self._append(f"{place}/idx", idx[None].astype(np.int64))
        self._append(f"{place}/time", time[None].astype(np.float64))

    def add_output(self, node: str, values: NDArray[np.float64]) -> None:
        """Append a row (act,) of an output."""
        place = f"nodes/{node}/observables/output"
        if place not in self._file:
            self._create(node, "output", "TimeGriddedData")
        self._append(f"{place}/data", values.reshape(1, 1, -1))

    def close(self, remark: str, dt: float | None) -> None:
        """Complete the file. dt: [s] from row to row of outputs; None is the whole duration."""
        for place in self._waiting:
            self._flush(place)
        self._file.attrs["remark"] = remark
        for node in self._file["nodes"].values():
            if "output" in node["observables"]:
                node["observables/output"].attrs["dt"] = dt or self._duration

    def _create(self, node: str, name: str, kind: str) -> None:
        self._file.create_group(f"nodes/{node}/observables/{name}").attrs["__type__"] = kind
        self._file[f"nodes/{node}"].attrs["__type__"] = "NIRNodeData"

    def _append(self, place: str, values: NDArray[Any]) -> None:
        """Lengthen an array (1, E, …) by more of its second axis."""
        if place not in self._waiting:
            self._waiting[place] = []
            rest = values.shape[2:]
            chunks = (1, max(1, _APPENDED // int(np.prod(rest))), *rest)
            shape, most = (1, 0, *rest), (1, None, *rest)
            self._file.create_dataset(place, shape, values.dtype, maxshape=most, chunks=chunks)
        waiting = self._waiting[place]
        waiting.append(values)
        if len(waiting) >= 1000 or values.size >= _APPENDED:
            self._flush(place)

    def _flush(self, place: str) -> None:
        values = np.concatenate([self._file[place][:, :0], *self._waiting[place]], axis=1)
        self._waiting[place].clear()
        before = self._file[place].shape[1]
        self._file[place].resize(before + values.shape[1], 1)
        self._file[place][:, before:] = values


def _node_grid(
    where: str, node: object, dt: float, shape: tuple[int, ...], most: int
) -> NDArray[Any]:
    """(T, *shape) of the spikes of a node, or of its only observable, in at most so many bytes."""
    found = getattr(node, "observables", {})
    name = _SPIKES if _SPIKES in found else next(iter(found), "")
    if len(found) != 1 and name != _SPIKES:
        raise ObservationError(
            f"{where} has the observables {', '.join(sorted(found)) or 'none'}; call the one to "
            f"play {_SPIKES!r}."
        )
    data = found[name]
    gridded = isinstance(data, nir.TimeGriddedData)
    rows = data.data if gridded else _events_grid(where, data, dt, most)
    if gridded and not np.isclose(data.dt, dt, rtol=1e-3):
        raise ObservationError(
            f"{where} has a grid of dt = {data.dt:g} s, the network {dt:g} s. Give that dt to the "
            "network with --dt, or write the data anew."
        )
    if len(rows) != 1 or rows[0, 0].size != int(np.prod(shape)):
        raise ObservationError(
            f"{where} holds (samples, T, N) = {rows.shape}; needed are one sample and N = "
            f"{int(np.prod(shape))}. Write one sample of this network."
        )
    return np.asarray(rows[0].reshape(-1, *shape))


def _events_grid(where: str, data: nir.EventData, dt: float, most: int) -> NDArray[Any]:
    """(1, T, N) of events, or of their values, of one sample."""
    values = data.value if isinstance(data, nir.ValuedEventData) else None
    _check_events(where, data.idx, data.time, *(() if values is None else (values,)))
    ends = data.t_max / dt
    timesteps = max(1, round(ends)) if np.isfinite(ends) else 0
    size = timesteps * data.n_neurons
    if len(data.idx) != 1 or not 0 < size <= most // (8 if values is not None else 1):
        raise ObservationError(
            f"{where} holds events {data.idx.shape} of {data.n_neurons} neurons up to "
            f"{data.t_max:g} s, that is {timesteps} timesteps; needed are one sample, and of a "
            f"file of this size at most {most} bytes. Write one sample, or give the dt of the "
            "network."
        )
    there = data.idx[0] >= 0
    step = np.floor(data.time[0][there] / dt + _EVENT_ROUNDING)
    neuron = data.idx[0][there].astype(np.int64)
    if not ((step >= 0) & (step < timesteps) & (neuron < data.n_neurons)).all():
        raise ObservationError(
            f"{where} has an event after its t_max, before 0, or of a neuron that it has not. "
            "Correct the events."
        )
    cells = step.astype(np.int64) * data.n_neurons + neuron
    rows = _add_up(cells, None if values is None else values[0][there], size)
    return rows.reshape(1, timesteps, data.n_neurons)


def _add_up(cells: NDArray[Any], values: NDArray[Any] | None, size: int) -> NDArray[Any]:
    """Sum up each cell (size,); several events of a neuron in a timestep add up."""
    most = np.unique(cells, return_counts=True)[1].max(initial=0) if values is None else size
    rows = np.zeros(size, np.uint8 if values is None and most <= 255 else np.float64)
    np.add.at(rows, cells, 1 if values is None else values.astype(np.float64))
    return rows


def _check_events(where: str, *arrays: NDArray[Any]) -> None:
    """Refuse arrays of events, (samples, events) each, that are not numbers, or too long."""
    kinds = ("iu", "iuf", "iuf")  # of neurons, times and values
    found = [np.asarray(each) for each in arrays]
    known = all(each.dtype.kind in kind for each, kind in zip(found, kinds, strict=False))
    if not known or len({each.shape for each in found}) != 1 or found[0].ndim != 2:
        shown = ", ".join(f"{each.dtype} {each.shape}" for each in found)
        raise ObservationError(
            f"{where} holds events of {shown}; needed are whole numbers of neurons, times and "
            "values (samples, events). Write it with nir.write_data."
        )
    if (size := sum(each.nbytes for each in found)) > _EVENT_BYTES:
        raise ObservationError(
            f"{where} holds {size} bytes of events; at most {_EVENT_BYTES}. Split it."
        )
