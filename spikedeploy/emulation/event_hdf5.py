"""Recordings of events in HDF5, by a table of the layouts in which tools write them.

Prophesee: Metavision's HDF5 Event File Format, docs.prophesee.ai. DSEC: Gehrig et al. 2021, "DSEC:
A Stereo Event Camera Dataset for Driving Scenarios"; our own recordings are alike. v2e:
v2ecore/emulator.py of SensorsINI/v2e. ESIM: the packages rpg_e2vid and event_utils read and write
it so. MVSEC: Zhu et al. 2018, "The Multi Vehicle Stereo Event Camera Dataset". M3ED: Chaney et al.
2023, "M3ED: Multi-Robot, Multi-Sensor, Multi-Environment Event Dataset".
"""

import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from spikedeploy.emulation.event_recording import (
    PART,
    Columns,
    Recording,
    Size,
    named_columns,
)
from spikedeploy.runtime.artifact.hdf5 import open_member
from spikedeploy.runtime.errors import ArtifactError, ObservationError


class _Layout(NamedTuple):
    """The place where a tool puts events.

    tool: name of the tool.
    place: place of a group of columns, of a dataset with fields, or of a table (N, 4).
    order: order of the columns of a table; empty for a group or for fields.
    """

    tool: str
    place: str
    order: str = ""


# the first that is in a file is read
_LAYOUTS = (
    _Layout("Prophesee", "CD/events"),
    _Layout("DSEC or ESIM", "events"),
    _Layout("v2e", "events", "txyp"),
    _Layout("v2e", "event", "txyp"),
    _Layout("columns", ""),
    _Layout("M3ED", "prophesee/left"),
    _Layout("M3ED", "prophesee/right"),
    _Layout("MVSEC", "davis/left/events", "xytp"),
    _Layout("MVSEC", "davis/right/events", "xytp"),
)
_ECF = 36559  # Prophesee's filter
_MOST_CHUNK = 1 << 28  # bytes that HDF5 unpacks at once
_MOST_NAMES = 8  # of a file whose layout is not known

# by x, y, t and p the path of a dataset, and what indexes the column in its rows
_Places = list[tuple[str, Any]]


def hdf5_recording(path: Path, camera: Size | None) -> Recording:
    """The recording in a file; ObservationError where it has no layout that is known."""
    with h5py.File(path) as file:
        if "nodes" in file:
            return _nir_recording(path, file, camera)
        there = [each for each in (*_LAYOUTS, *_with_fields(file)) if _columns(file, each)]
        if not there:
            raise _unknown(path, file)
        layout, *others = there
        columns = _columns(file, layout)
        members = _open(path, file, columns)
        for member in members.values():
            _check_filters(path, member)
        size, offset = _size(file, layout), _offset(file, layout)

    def parts() -> Iterator[Columns]:
        with h5py.File(path) as file:
            members = _open(path, file, columns)
            for first in range(0, max(map(len, members.values())), PART):
                rows = {place: member[first : first + PART] for place, member in members.items()}
                yield tuple(rows[place][index] for place, index in columns)

    aliases = {layout.place, *(each.place for each in others)} - {layout.place}
    remarks = [f"read is {layout.place or 'x, y, t, p'}; {place} is there too" for place in aliases]
    return Recording(path, size, parts, offset, tuple(remarks))


def _columns(file: h5py.File, layout: _Layout) -> _Places:
    """Places of x, y, t and p in a file; empty where it does not have the layout."""
    place, order = layout.place, layout.order
    member = file.get(place) if place else file
    if isinstance(member, h5py.Dataset) and order:
        is_table = member.ndim == 2 and member.shape[1] == 4
        return [(place, (slice(None), order.index(name))) for name in "xytp"] if is_table else []
    if order or not isinstance(member, h5py.Group | h5py.Dataset):
        return []
    is_group = isinstance(member, h5py.Group)
    names = named_columns(member if is_group else member.dtype.names or ())
    if len(names) < 4:
        return []
    if is_group:
        return [(f"{place}/{names[name]}".lstrip("/"), ...) for name in "xytp"]
    return [(place, names[name]) for name in "xytp"]


def _with_fields(file: h5py.File) -> list[_Layout]:
    """The only dataset with the fields x, y, t and p, anywhere in a file."""
    found = list[str]()

    def look(name: str, member: object) -> None:
        if isinstance(member, h5py.Dataset) and len(named_columns(member.dtype.names or ())) == 4:
            found.append(name)

    file.visititems(look)
    return [_Layout("fields", found[0])] if len(found) == 1 else []


def _unknown(path: Path, file: h5py.File) -> ObservationError:
    found = list[str]()
    file.visit(found.append)
    places = {each.place: each for each in _LAYOUTS}
    known = [
        f"{p} ({a.tool}{', ' + ', '.join(a.order) if a.order else ''})"
        for p, a in places.items()
        if p
    ]
    return ObservationError(
        f"{path} holds {', '.join(found[:_MOST_NAMES]) or 'nothing'}"
        f"{' ...' * (len(found) > _MOST_NAMES)}; known are x, y, t, p in a group or as fields of "
        f"one dataset, and {', '.join(known)}. Write it so (docs/event-camera.md)."
    )


def _open(path: Path, file: h5py.File, columns: _Places) -> dict[str, h5py.Dataset]:
    """The datasets that hold the columns, by their paths."""
    try:
        return {place: open_member(file, place) for place, _ in columns}
    except ArtifactError as error:
        raise ObservationError(f"{path}: {error}") from error


def _size(file: h5py.File, layout: _Layout) -> Size | None:
    """(height, width) of the camera, where the file says it."""
    attributes = file[layout.place or "/"].attrs
    resolution = file.get(f"{layout.place}/calib/resolution")  # M3ED's, width and height
    if "height" in attributes and "width" in attributes:
        return int(attributes["height"]), int(attributes["width"])
    if found := re.fullmatch(r"(\d+)x(\d+)", str(file.attrs.get("geometry", ""))):
        return int(found[2]), int(found[1])  # Prophesee's, width x height
    if isinstance(resolution, h5py.Dataset) and resolution.shape == (2,):
        return int(resolution[1]), int(resolution[0])
    return None


def _offset(file: h5py.File, layout: _Layout) -> int:
    """[us] from which DSEC's times count, beside or in the group of the columns."""
    for holder in (file.get(layout.place or "/"), file):
        if isinstance(holder, h5py.Group) and "t_offset" in holder:
            return int(np.asarray(holder["t_offset"][()]).item())
    return 0


def _check_filters(path: Path, column: h5py.Dataset) -> None:
    """Refuse what would unpack to too much at once, or by a filter that is not installed."""
    if (found := int(np.prod(column.chunks or (0,))) * column.dtype.itemsize) > _MOST_CHUNK:
        raise ObservationError(
            f"{path}: {column.name} unpacks {found} bytes at once; at most {_MOST_CHUNK}. Write it "
            "in smaller chunks."
        )
    properties = column.id.get_create_plist()
    filters = [properties.get_filter(k)[0] for k in range(properties.get_nfilters())]
    if importlib.util.find_spec("hdf5plugin"):
        import hdf5plugin  # noqa: F401 (it registers filters, such as DSEC's blosc)
    missing = [code for code in filters if not h5py.h5z.filter_avail(code)]
    if _ECF in missing:
        raise ObservationError(
            f"{path} is a recording of Prophesee whose {column.name} is compressed by ECF, filter "
            f"{_ECF}, which HDF5 here has not. Where Metavision is installed, "
            "metavision_file_to_dat -i FILE writes a .dat, which is read; or build the filter, "
            "github.com/prophesee-ai/hdf5_ecf, and set HDF5_PLUGIN_PATH to its folder."
        )
    if missing:
        raise ObservationError(
            f"{path}: {column.name} is compressed by filter {missing[0]}, which HDF5 here has not: "
            'pip install "spikedeploy[dsec]", or write it with gzip.'
        )


def _nir_recording(path: Path, file: h5py.File, camera: Size | None) -> Recording:
    """Events of NIRData's only node: neuron ((p H) + y) W + x at a time [s]."""
    nodes = list(file["nodes"])
    place = f"nodes/{nodes[0]}/observables/spikes" if len(nodes) == 1 else ""
    data = file.get(place) if place else None
    if data is None or "idx" not in data or "time" not in data or len(data["idx"]) != 1:
        raise ObservationError(
            f"{path} is NIRData of {', '.join(nodes) or 'no node'}; needed are events, one sample "
            "of one node, called spikes. Write them so; rasters go to --input."
        )
    neurons = int(data.attrs["n_neurons"])
    if camera is None or neurons not in (camera[0] * camera[1], 2 * camera[0] * camera[1]):
        shown = f"{camera[0]}x{camera[1]}" if camera else "of unknown size"
        raise ObservationError(
            f"{path} holds events of {neurons} neurons; a camera {shown} has one for each pixel or "
            "two. Give the size of its camera with --camera HxW."
        )
    _, width = camera
    pixels = camera[0] * width
    columns: _Places = [(f"{place}/idx", 0), (f"{place}/time", 0)]
    for member in _open(path, file, columns).values():
        _check_filters(path, member)

    def parts() -> Iterator[Columns]:
        with h5py.File(path) as file:
            idx, time = _open(path, file, columns).values()
            for first in range(0, idx.shape[1], PART):
                neuron = idx[0, first : first + PART].astype(np.int64)
                there = neuron >= 0  # samples of fewer events are filled with -1
                neuron, seconds = neuron[there], time[0, first : first + PART][there]
                # of one channel every event is one of rising light
                p = neuron // pixels if neurons > pixels else np.ones(len(neuron), np.int64)
                yield neuron % width, neuron % pixels // width, seconds.astype(np.float64), p

    return Recording(path, camera, parts)
