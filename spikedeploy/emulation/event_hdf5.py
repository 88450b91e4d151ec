"""Recordings of events in HDF5, by a table of the layouts in which tools write them.

Prophesee: Metavision's HDF5 Event File Format, docs.prophesee.ai. DSEC: Gehrig et al. 2021, "DSEC:
A Stereo Event Camera Dataset for Driving Scenarios"; our own recordings are alike. v2e:
v2ecore/emulator.py of SensorsINI/v2e. ESIM: the packages rpg_e2vid and event_utils read and write
it so. MVSEC: Zhu et al. 2018, "The Multi Vehicle Stereo Event Camera Dataset". M3ED: Chaney et al.
2023, "M3ED: Multi-Robot, Multi-Sensor, Multi-Environment Event Dataset".
"""

import importlib.util
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from spikedeploy.emulation.event_columns import (
    LATEST,
    PART,
    Columns,
    Size,
    check_kinds,
    check_names,
    check_shapes,
    microseconds,
    named_columns,
    to_microseconds,
    whole_times,
)
from spikedeploy.runtime.artifact.hdf5 import check_container, open_member
from spikedeploy.runtime.errors import ArtifactError, ObservationError

Parts = Callable[[], Iterator[Columns]]


@dataclass(frozen=True)
class _Layout:
    """The place where a tool puts events.

    name: name of the tool.
    place: place of a group of columns, of a dataset with fields, or of a table (N, 4).
    shown: place and columns in words.
    order: order of the columns of a table; empty for a group or for fields.
    seconds: whether times are in seconds where they are no whole numbers.
    """

    name: str
    place: str
    shown: str
    order: str = ""
    seconds: bool = False


# the first that is in a file is read
_LAYOUTS = (
    _Layout("Prophesee", "CD/events", "CD/events with the fields x, y, p, t"),
    _Layout("DSEC or ESIM", "events", "events/x, y, t, p or xs, ys, ts, ps", seconds=True),
    _Layout("v2e", "events", "events (N, 4) of t, x, y, p", order="txyp"),
    _Layout("v2e", "event", "", order="txyp"),
    _Layout("plain columns", "", "x, y, t, p or xs, ys, ts, ps", seconds=True),
    _Layout("M3ED", "prophesee/left", "prophesee/left/x, y, t, p"),
    _Layout("M3ED", "prophesee/right", ""),
    _Layout(
        "MVSEC", "davis/left/events", "davis/left/events (N, 4) of x, y, t, p", "xytp", seconds=True
    ),
    _Layout("MVSEC", "davis/right/events", "", "xytp", seconds=True),
)
_OTHERS = ("NIRData", "one dataset anywhere with the fields x, y, t, p")
_ECF = 36559  # Prophesee's filter
_MOST_CHUNK = 1 << 28  # bytes that HDF5 unpacks at once
_MOST_NAMES = 8  # of a file whose layout is not known
_MOST_MEMBERS = 10_000  # that are looked through for a dataset with the fields


def hdf5_recording(path: Path, camera: Size | None) -> tuple[Size | None, Parts, tuple[str, ...]]:
    """Size of the camera, parts and remarks of a file; ObservationError where it has no layout."""
    with h5py.File(path) as file:
        if "nodes" in file:
            _check_nir(path)
            return camera, _nir_parts(path, file, camera), ()
        layout = _layout_of(path, file)
        columns, remarks = _Source(path, layout), []
        columns.check(file)
        size = _size(path, file, layout)
        offset = _offset(path, file, layout)
        if columns.in_seconds:
            remarks.append(f"times are read as seconds, as {layout.name} writes them")
        if others := _others(file, layout):
            more = " ..." * (len(others) > _MOST_NAMES)
            shown = f"{', '.join(others[:_MOST_NAMES])}{more}"
            verb = "is" if len(others) == 1 else "are"
            remarks.append(f"read is {layout.place or 'x, y, t, p'}; {shown} {verb} there too")
    return size, lambda: columns.parts(offset), tuple(remarks)


def _layout_of(path: Path, file: h5py.File) -> _Layout:
    """The layout of a file; ObservationError where it has none that is known."""
    for layout in _LAYOUTS:
        if _is_there(file, layout):
            if layout.order and not layout.seconds:
                _check_table(path, file[layout.place])
            return layout
    places = [name for name, member in _members(file) if _has_fields(member)]
    if len(places) == 1:
        return _Layout("its fields", places[0], "")
    found = places or [_shown(name, member) for name, member in _members(file)]
    more = " ..." * (len(found) > _MOST_NAMES)
    missing = named_columns(_names(file.get("events")))[1]
    raise ObservationError(
        f"{path} holds {', '.join(found[:_MOST_NAMES]) or 'nothing'}{more}"
        + (f", and events/{missing[0]} is missing" if 0 < len(missing) < 4 else "")
        + f"{'; which of them is it?' if places else ''}; known are "
        + "; ".join([f"{a.shown} ({a.name})" for a in _LAYOUTS if a.shown] + list(_OTHERS))
        + ". Write it so."
    )


def _others(file: h5py.File, layout: _Layout) -> list[str]:
    """Other places in a file with columns of events, which no layout names."""
    read = file[layout.place or "/"]
    known = {each.place: file[each.place or "/"] for each in _LAYOUTS if _is_there(file, each)}
    leaves = dict(_members(file))
    groups = {name.rpartition("/")[0]: file[name.rpartition("/")[0] or "/"] for name in leaves}
    fields = {name: each for name, each in leaves.items() if _has_fields(each)}
    columns = {name: each for name, each in groups.items() if not named_columns(_names(each))[1]}
    found = {**known, **fields, **columns}
    return [name or "x, y, t, p" for name, each in found.items() if each != read]


def _is_there(file: h5py.File, layout: _Layout) -> bool:
    member = file.get(layout.place) if layout.place else file
    if isinstance(member, h5py.Dataset) and layout.order:
        return member.ndim == 2 and member.shape[1] == 4 and member.dtype.kind in "biuf"
    return not layout.order and not named_columns(_names(member))[1]


def _check_table(path: Path, table: h5py.Dataset) -> None:
    """Refuse a table that does not hold whole numbers, as v2e's does."""
    if table.dtype.kind == "f":
        raise ObservationError(
            f"{path} holds {table.name.strip('/')} {table.shape} of {table.dtype}, which is no "
            "layout that is known: v2e writes t [us], x, y, p in whole numbers. Write them so."
        )


def _has_fields(member: object) -> bool:
    return isinstance(member, h5py.Dataset) and not named_columns(_names(member))[1]


def _names(member: object) -> list[str]:
    """Names of the members of a group, or of the fields of a dataset."""
    if isinstance(member, h5py.Dataset):
        return list(member.dtype.names or ())
    return list(member) if isinstance(member, h5py.Group) else []


def _members(file: h5py.File) -> Iterator[tuple[str, Any]]:
    """Groups without members and datasets by their paths; links to elsewhere are left out."""
    waiting, count = [("", file["/"])], 0
    while waiting and count < _MOST_MEMBERS:
        path, group = waiting.pop(0)
        for name in group:
            count += 1
            if group.get(name, getclass=True, getlink=True) is not h5py.HardLink:
                continue
            member = group[name]
            if isinstance(member, h5py.Group) and len(member):
                waiting.append((f"{path}{name}/", member))
            else:
                yield f"{path}{name}", member


def _shown(name: str, member: object) -> str:
    if not isinstance(member, h5py.Dataset):
        return name
    fields = member.dtype.names
    return f"{name} {member.shape}{' of ' + ', '.join(fields) if fields else ''}"


class _Source:
    """The datasets of a layout in a file. in_seconds: whether times are."""

    def __init__(self, path: Path, layout: _Layout) -> None:
        self._path, self._layout = path, layout
        self.in_seconds = False

    def check(self, file: h5py.File) -> None:
        """Refuse what cannot be read; nothing else in the file is looked at."""
        path, place = self._path, file[self._layout.place or "/"]
        if not self._layout.order:
            check_names(path, _names(place))
        members = self._open(file)
        for member in {each.name: each for each in members}.values():
            _check_column(path, member)
        if len(members) == 4:
            kinds = [each.dtype for each in members]
            check_shapes(path, [each.shape for each in members])
        else:
            (only,) = members
            if self._layout.order:
                kinds = [only.dtype] * 4
            else:
                named, _ = named_columns(only.dtype.names)
                kinds = [only.dtype[named[each]] for each in "xytp"]
                check_shapes(path, [only.shape])
        seconds = self._layout.seconds
        if not self._layout.order and seconds:
            # of t nothing says the unit
            seconds = named_columns(_names(place))[0]["t"] == "ts"
        check_kinds(path, kinds, seconds)
        self.in_seconds = kinds[2].kind == "f"

    def parts(self, offset: int) -> Iterator[Columns]:
        """x, y, t [us], p of some events after another. offset: of times [us]."""
        path = self._path
        with h5py.File(path) as file:
            members = self._open(file)
            for first in range(0, len(members[0]), PART):
                x, y, t, p = self._columns(members, slice(first, first + PART))
                us = microseconds(path, t) if self.in_seconds else t
                yield x, y, whole_times(path, us) + offset if offset else us, p

    def _open(self, file: h5py.File) -> list[h5py.Dataset]:
        """The four columns, or the one dataset that holds all of them."""
        place = self._layout.place
        try:
            if isinstance(file.get(place or "/"), h5py.Dataset):
                return [open_member(file, place)]
            named, _ = named_columns(_names(file[place or "/"]))
            prefix = f"{place}/" if place else ""
            return [open_member(file, f"{prefix}{named[each]}") for each in "xytp"]
        except ArtifactError as error:
            raise ObservationError(f"{self._path}: {error}") from error

    def _columns(self, members: list[h5py.Dataset], part: slice) -> Columns:
        if len(members) == 4:
            return tuple(member[part] for member in members)
        rows = members[0][part]
        if order := self._layout.order:
            return tuple(rows[:, order.index(each)] for each in "xytp")
        named, _ = named_columns(rows.dtype.names)
        return tuple(rows[named[each]] for each in "xytp")


def _size(path: Path, file: h5py.File, layout: _Layout) -> Size | None:
    """(height, width) of the camera, where the file says it without doubt."""
    group = file.get(layout.place or "/")
    sides = [group.attrs.get(name) for name in ("height", "width")]
    geometry = file.attrs.get("geometry")  # Prophesee's, width x height
    resolution = file.get(f"{layout.place}/calib/resolution")  # M3ED's, width and height
    square = np.ravel(file.attrs.get("sensor_resolution", ()))  # of both orders in use
    if None not in sides:
        size = int(sides[0]), int(sides[1])
    elif isinstance(geometry, str) and (found := re.fullmatch(r"(\d+)x(\d+)", geometry)):
        size = int(found[2]), int(found[1])
    elif isinstance(resolution, h5py.Dataset) and resolution.shape == (2,):
        width, height = (int(n) for n in resolution)
        size = height, width
    elif len(square) == 2 and square[0] == square[1]:
        size = int(square[0]), int(square[1])
    else:
        return None
    if min(size) < 1:
        raise ObservationError(
            f"{path} says that its camera has {size[0]}x{size[1]} pixels (height x width); the "
            "least is 1x1. Correct the attributes height and width of its group events."
        )
    return size


def _offset(path: Path, file: h5py.File, layout: _Layout) -> int:
    """[us] from which DSEC's times count, beside or in the group of the columns."""
    group = file.get(layout.place or "/")
    for holder in (group, file):
        if isinstance(holder, h5py.Group) and isinstance(holder.get("t_offset"), h5py.Dataset):
            found = np.asarray(holder["t_offset"][()])
            if found.size != 1 or found.dtype.kind not in "iu":
                raise ObservationError(
                    f"{path} has a t_offset of {found.dtype} {found.shape}; it must be one whole "
                    "number [us]. Correct it."
                )
            if abs(offset := int(found.ravel()[0])) >= LATEST:
                raise ObservationError(
                    f"{path} has a t_offset of {offset} us; it must be less than 2^62 us, either "
                    "way. Correct it."
                )
            return offset
    return 0


def _check_column(path: Path, column: h5py.Dataset) -> None:
    """Refuse what would unpack to too much at once, or by a filter that is not installed."""
    if (found := int(np.prod(column.chunks or (0,))) * column.dtype.itemsize) > _MOST_CHUNK:
        raise ObservationError(
            f"{path}: {column.name} unpacks {found} bytes at once; at most {_MOST_CHUNK}. Write it "
            "in smaller chunks."
        )
    properties = column.id.get_create_plist()
    filters = [properties.get_filter(k) for k in range(properties.get_nfilters())]
    missing = [each for each in filters if not h5py.h5z.filter_avail(each[0])]
    if missing and importlib.util.find_spec("hdf5plugin"):
        import hdf5plugin  # noqa: F401 (it registers filters, such as DSEC's blosc)

        missing = [each for each in missing if not h5py.h5z.filter_avail(each[0])]
    if not missing:
        return
    code, *_, name = missing[0]
    if code == _ECF:
        raise ObservationError(
            f"{path} is a recording of Prophesee whose {column.name} is compressed by ECF, filter "
            f"{code}, which HDF5 here has not. Where Metavision is installed, "
            "metavision_file_to_dat -i FILE writes a .dat, which is read; or build the filter, "
            "github.com/prophesee-ai/hdf5_ecf, and set HDF5_PLUGIN_PATH to its folder."
        )
    raise ObservationError(
        f"{path}: {column.name} is compressed by filter {code} ({name.decode() or 'no name'}), "
        'which HDF5 here has not: pip install "spikedeploy[dsec]", or write it with gzip.'
    )


# NIRData


def _check_nir(path: Path) -> None:
    try:
        check_container(path, 1 << 62)  # its size is no matter, since it is read in parts
    except ArtifactError as error:
        raise ObservationError(f"{path} is HDF5 and no recording of events: {error}") from error


def _nir_parts(path: Path, file: h5py.File, camera: Size | None) -> Parts:
    """Parts of the events of NIRData's only node: neuron ((p H) + y) W + x at a time [s]."""
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
    for column in (data["idx"], data["time"]):
        _check_column(path, column)

    def parts() -> Iterator[Columns]:
        with h5py.File(path) as file:
            idx, time = (file[f"{place}/{name}"] for name in ("idx", "time"))
            for first in range(0, idx.shape[1], PART):
                neuron = idx[0, first : first + PART].astype(np.int64)
                at = time[0, first : first + PART]
                if not (np.isfinite(at).all() and (neuron < neurons).all()):
                    raise ObservationError(
                        f"{path} has an event of a neuron that it has not, or at no time. Correct "
                        "the events."
                    )
                there = neuron >= 0  # samples of fewer events are filled with -1
                neuron, us = neuron[there], to_microseconds(path, at[there])
                # of one channel every event is one of rising light
                p = neuron // pixels if neurons > pixels else np.ones(len(neuron), np.int64)
                yield neuron % width, neuron % pixels // width, us, p

    return parts
