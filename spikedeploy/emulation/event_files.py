"""Recordings of event cameras: files of several formats as one stream of checked events.

HDF5 with `events/x`, `y`, `t`, `p` (our own, and DSEC's: Gehrig et al. 2021, "DSEC: A Stereo Event
Camera Dataset for Driving Scenarios"), NIRData with events, and structured arrays of NumPy are read
here; AEDAT 4, Prophesee's .raw (EVT 2, 2.1, 3) and .dat, and .es by faery. All are read in parts,
so that memory does not grow with the recording.
"""

import importlib.util
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from spikedeploy.events import EVENT, MOST_PIXELS, Events
from spikedeploy.runtime.artifact.hdf5 import check_container
from spikedeploy.runtime.artifact.nir_data import is_nir_data
from spikedeploy.runtime.errors import ArtifactError, ObservationError

Size = tuple[int, int]
Columns = tuple[NDArray[Any], ...]  # x, y, t [us] and p of some events, as a file holds them

_PART = 1 << 16  # events that are read at once
_FAERY = (".aedat4", ".raw", ".dat", ".es")
KINDS = f"HDF5, NumPy structured arrays (.npy), {', '.join(_FAERY)}"
_MOST_CHUNK = 1 << 28  # bytes that HDF5 unpacks at once
# [us] after which a counter of 32 bits begins anew, and by how much it then falls at least, unless
# the camera was silent for nine minutes
_WRAP, _FALL = 1 << 32, 7 << 29
# what a size of faery means that no header gave: .raw and .dat have at most 14 bits for x and y
_UNKNOWN = (1 << 14, 1 << 14)
# names of the fields of structured arrays, as NumPy, Tonic, faery and event_stream have them
_FIELDS = {"x": ("x",), "y": ("y",), "t": ("t", "ts", "timestamp"), "p": ("p", "on", "polarity")}
_SORT = "Sort the events by time and write them anew"


@dataclass(frozen=True)
class Recording:
    """A file of events, which is read as often as wanted.

    path: of the file.
    size: (height, width) of the camera [pixels]; None where nothing says it.
    parts: reads x, y, t [us] and p of some events after another, unchecked.
    """

    path: Path
    size: Size | None
    parts: Callable[[], Iterator[Columns]]

    def events(self) -> Iterator[Events]:
        """Events (E,) in the order of time, part by part; ObservationError where any is none.

        A time that falls by almost 2**32 us is a counter of 32 bits that began anew: it goes on.
        """
        count, wraps, last, stored = 0, 0, 0, 0
        height, width = self.size or (MOST_PIXELS, MOST_PIXELS)
        for x, y, t, p in self._parts():
            t = t.astype(np.int64)
            falls = np.diff(t, prepend=stored if count else t[0]) < -_FALL
            offset = _WRAP * (wraps + np.cumsum(falls & (t < _WRAP)))
            found, wraps, stored = t + offset, int(offset[-1]) // _WRAP, int(t[-1])
            before = np.concatenate([[last if count else found[0]], found[:-1]])
            outside = (x < 0) | (x >= width) | (y < 0) | (y >= height)
            for wrong, refuse in ((outside, self._outside), (found < before, self._unordered)):
                if wrong.any():
                    at = int(np.argmax(wrong))
                    raise ObservationError(
                        f"{self.path}: event {count + at} "
                        + refuse(int(x[at]), int(y[at]), int(found[at]), int(before[at]))
                    )
            if not count and found[0] < 0:
                raise ObservationError(
                    f"{self.path}: event 0 is at t = {found[0]} us; times are counted from 0 on. "
                    "Add an offset to all of them."
                )
            events = np.empty(len(t), EVENT)
            events["x"], events["y"], events["t"], events["p"] = x, y, found, p > 0
            count, last = count + len(t), int(found[-1])
            yield events

    def _parts(self) -> Iterator[Columns]:
        """The parts that hold events; ObservationError where the file is damaged."""
        try:
            yield from (part for part in self.parts() if len(part[2]))
        except (ObservationError, ModuleNotFoundError):
            raise
        # h5py and faery raise exceptions of many types for a damaged file
        except Exception as error:
            raise _damaged(self.path, error) from error

    def _outside(self, x: int, y: int, _t: int, _before: int) -> str:
        height, width = self.size or (MOST_PIXELS, MOST_PIXELS)
        return (
            f"is at x = {x}, y = {y}; the camera has {height}x{width} pixels (height x width). "
            "Correct the event, or the size: in the file, or where that has none with --camera HxW."
        )

    def _unordered(self, _x: int, _y: int, t: int, before: int) -> str:
        return f"at t = {t} us comes {before - t} us before the one ahead of it. {_SORT}."


def open_recording(
    path: Path, camera: Size | None = None, fallback: Size | None = None
) -> Recording:
    """The recording in a file; ObservationError where its format is not known or it is damaged.

    camera: (height, width) [pixels]; must be what the file says, where it does.
    fallback: likewise, where neither file nor `camera` say it.
    """
    if not path.is_file():
        raise ObservationError(f"{path} is no file. Give a recording: {KINDS}.")
    try:
        if path.suffix == ".npy":
            found, parts = None, _numpy_parts(path)
        elif path.suffix in _FAERY:
            found, parts = _faery_parts(path)
        elif is_nir_data(path):
            found, parts = _hdf5_parts(path, camera or fallback)
        else:
            raise ObservationError(f"{path} is no recording of events that is known: {KINDS}.")
    except (ObservationError, ModuleNotFoundError):
        raise
    except Exception as error:
        raise _damaged(path, error) from error
    if camera and found and camera != found:
        raise ObservationError(
            f"{path} says that its camera has {found[0]}x{found[1]} pixels (height x width), "
            f"--camera {camera[0]}x{camera[1]}. Leave --camera out."
        )
    return Recording(path, camera or found or fallback, parts)


def _damaged(path: Path, error: Exception) -> ObservationError:
    return ObservationError(
        f"{path} cannot be read to its end as {path.suffix or 'a recording'}: "
        f"{str(error).strip().rstrip('.') or type(error).__name__}. The file is truncated, damaged "
        "or of another format; copy or convert it again."
    )


def _check_kinds(path: Path, columns: Iterable[NDArray[Any] | h5py.Dataset]) -> None:
    """Refuse columns of events that are no whole numbers, or that differ in length."""
    kinds = [each.dtype for each in columns]
    if any(kind.kind not in "biu" for kind in kinds):
        shown = ", ".join(f"{n} {kind}" for n, kind in zip("xytp", kinds, strict=True))
        raise ObservationError(
            f"{path} holds {shown}; x, y, t [us] and p must be whole numbers. Convert it: t in "
            "seconds times 1e6, rounded."
        )
    if len({each.shape for each in columns}) != 1 or len(next(iter(columns)).shape) != 1:
        shown = ", ".join(f"{n} {each.shape}" for n, each in zip("xytp", columns, strict=True))
        raise ObservationError(
            f"{path} holds {shown}, which must be columns of one length. The recording is "
            "truncated; cut all columns to the shortest."
        )


# NumPy


def _numpy_parts(path: Path) -> Callable[[], Iterator[Columns]]:
    # memory-mapped, which takes no memory; no objects are loaded, which could execute code
    array = np.lib.format.open_memmap(path, mode="r")
    names = array.dtype.names or ()
    fields = {name: next((n for n in known if n in names), None) for name, known in _FIELDS.items()}
    if missing := sorted(name for name, field in fields.items() if field is None):
        raise ObservationError(
            f"{path} holds {', '.join(names) or f'plain {array.dtype}'}; needed is a structured "
            f"array with the fields x, y, t [us] and p, and {missing[0]!r} is missing. Rasters go "
            "to --input."
        )
    _check_kinds(path, [array[field] for field in fields.values()])

    def parts() -> Iterator[Columns]:
        for first in range(0, len(array), _PART):
            rows = array[first : first + _PART]
            yield tuple(np.asarray(rows[field]) for field in fields.values())

    return parts


# HDF5


def _hdf5_parts(
    path: Path, camera: Size | None
) -> tuple[Size | None, Callable[[], Iterator[Columns]]]:
    """Size and parts of events/{x,y,t,p} or of NIRData."""
    try:
        check_container(path, 1 << 62)  # its size is no matter, since it is read in parts
    except ArtifactError as error:
        raise ObservationError(f"{path} is HDF5 and no recording of events: {error}") from error
    with h5py.File(path) as file:
        group = file.get("events")
        if "nodes" in file:
            return camera, _nir_parts(path, file, camera)
        names = list(group) if isinstance(group, h5py.Group) else []
        if missing := sorted(set("xytp") - set(names)):
            raise ObservationError(
                f"{path} holds {', '.join(f'events/{n}' for n in names) or ', '.join(file)}; "
                f"needed are events/x, y, t and p, and events/{missing[0]} is missing. Rename "
                "them."
            )
        columns = [group[name] for name in "xytp"]
        _check_kinds(path, columns)
        for column in columns:
            _check_column(path, column)
        offset = int(file["t_offset"][()]) if "t_offset" in file else 0
        sides = (group.attrs.get("height"), group.attrs.get("width"))
    size = None if None in sides else (int(sides[0]), int(sides[1]))
    if size and min(size) < 1:
        raise ObservationError(
            f"{path} says that its camera has {size[0]}x{size[1]} pixels (height x width); the "
            "least is 1x1. Correct the attributes height and width of its group events."
        )

    def parts() -> Iterator[Columns]:
        with h5py.File(path) as file:
            x, y, t, p = (file["events"][name] for name in "xytp")
            for first in range(0, len(t), _PART):
                part = slice(first, first + _PART)
                # DSEC's times count from its offset
                yield x[part], y[part], t[part].astype(np.int64) + offset, p[part]

    return size, parts


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
    if missing:
        code, *_, name = missing[0]
        raise ObservationError(
            f"{path}: {column.name} is compressed by filter {code} ({name.decode() or 'no name'}), "
            'which HDF5 here has not: pip install "spikedeploy[dsec]", or write it with gzip.'
        )


def _nir_parts(path: Path, file: h5py.File, camera: Size | None) -> Callable[[], Iterator[Columns]]:
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
            for first in range(0, idx.shape[1], _PART):
                neuron = idx[0, first : first + _PART].astype(np.int64)
                at = time[0, first : first + _PART]
                if not (np.isfinite(at).all() and (neuron < neurons).all()):
                    raise ObservationError(
                        f"{path} has an event of a neuron that it has not, or at no time. Correct "
                        "the events."
                    )
                there = neuron >= 0  # samples of fewer events are filled with -1
                neuron, us = neuron[there], np.rint(at[there] * 1e6).astype(np.int64)
                # of one channel every event is one of rising light
                p = neuron // pixels if neurons > pixels else np.ones(len(neuron), np.int64)
                yield neuron % width, neuron % pixels // width, us, p

    return parts


# AEDAT 4, Prophesee


def _faery_parts(path: Path) -> tuple[Size | None, Callable[[], Iterator[Columns]]]:
    import faery

    with path.open("rb") as file:
        if path.suffix == ".raw" and file.read(1) != b"%":
            raise ObservationError(
                f"{path} has no header, which says whether its events are EVT 2, 2.1 or 3. Record "
                "it anew, or convert it with the tools of the camera."
            )
    width, height = faery.events_stream_from_file(path, dimensions_fallback=_UNKNOWN).dimensions()
    size = None if (width, height) == _UNKNOWN else (height, width)

    def parts() -> Iterator[Columns]:
        if path.suffix == ".raw":
            _check_times_high(path)
        times, first, offset = _dat_times(path) if path.suffix == ".dat" else None, 0, 0
        # a stream is read once
        for events in faery.events_stream_from_file(path, dimensions_fallback=_UNKNOWN):
            t = events["t"].astype(np.int64)
            if times is not None:
                stored = times[first : first + len(t)].astype(np.int64)
                # headers of faery hold the time of the first event
                offset = offset if first else int(t[0] - stored[0])
                t, first = stored + offset, first + len(t)
            yield events["x"], events["y"], t, events["p"]

    return size, parts


def _dat_times(path: Path) -> NDArray[np.uint32]:
    """Times [us] of a .dat as they are stored; faery raises each that falls to the one ahead of it.

    Behind the header stand two bytes, then eight for each event, its time first.
    """
    place = len(_header(path)) + 2
    return np.memmap(path, "<u4", "r", place, ((path.stat().st_size - place) // 8, 2))[:, 0]


# by version of EVT: a word, the place of its type in it, and of the time where that is TIME_HIGH
_WORDS = {"2": ("<u4", 28, 0), "21": ("<u8", 60, 32), "3": ("<u2", 12, 0)}
_TIME_HIGH = 8


def _check_times_high(path: Path) -> None:
    """Refuse a .raw whose high bits of time fall, unless all begin anew; faery takes each for that.

    Words as in Prophesee's documentation, docs.prophesee.ai, Encoding Formats EVT 2.0, 2.1, 3.0.
    """
    header = _header(path)
    version = re.search(rb"% (?:evt |format EVT)(\d)\.?(1?)", header)
    known = _WORDS.get(b"".join(version.groups()).decode()) if version else None
    if known is None:
        return
    kind, of_type, of_time = known
    most = (1 << (of_type - of_time)) - 1
    width = np.dtype(kind).itemsize
    last = 0
    with path.open("rb") as file:
        file.seek(len(header))
        while part := file.read(width * _PART):
            words = np.frombuffer(part[: len(part) // width * width], kind)
            high = (words[words >> of_type == _TIME_HIGH] >> of_time & most).astype(np.int64)
            falls = -np.diff(high, prepend=last)
            if ((falls > 0) & (falls < most // 8 * 7)).any():
                raise ObservationError(f"{path}: its times jump back. {_SORT}.")
            last = int(high[-1]) if len(high) else last


def _header(path: Path) -> bytes:
    """The lines that begin with "%", ahead of all others; of .raw to "% end"."""
    found = b""
    with path.open("rb") as file:
        while (line := file.readline(_PART)).startswith(b"%") and line.endswith(b"\n"):
            found += line
            if line.strip() == b"% end":
                break
    return found
