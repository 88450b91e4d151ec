"""Recordings of event cameras: a stream of events that were checked, from files of several formats.

Structured arrays of NumPy, Prophesee's .dat and HDF5 are read here; AEDAT 4, Prophesee's .raw (EVT
2, 2.1, 3) and .es by faery. All are read in parts, so that memory does not grow with the recording.

Layouts of HDF5: Prophesee: Metavision's HDF5 Event File Format, docs.prophesee.ai. DSEC: Gehrig et
al. 2021, "DSEC: A Stereo Event Camera Dataset for Driving Scenarios"; our own recordings are alike.
v2e: v2ecore/emulator.py of SensorsINI/v2e. ESIM: the packages rpg_e2vid and event_utils read and
write it so.
"""

import importlib.util
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.hdf5 import open_member
from spikedeploy.runtime.artifact.nir_data import is_nir_data
from spikedeploy.runtime.camera_events import EVENT, MOST_PIXELS, Events
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.runtime.files import suffix

Size: TypeAlias = tuple[int, int]
Columns: TypeAlias = tuple[NDArray[Any], ...]  # x, y, t and p of some events, as stored
Parts: TypeAlias = Callable[[], Iterator[Columns]]

PART = 1 << 16  # events that are read at once
# names of columns, as NumPy, Tonic, faery, event_stream, ESIM and ROS have them
_NAMES = {
    "x": ("x", "xs"),
    "y": ("y", "ys"),
    "t": ("t", "ts", "timestamp"),
    "p": ("p", "ps", "pol", "on", "polarity"),
}
_CODINGS = ({0, 1}, {-1, 1})  # polarities of falling and of rising light
# [us] after which a counter of 32 bits begins anew, and by how much it then falls at least, unless
# the camera was silent for nine minutes
_WRAP, _FALL = 1 << 32, 7 << 29
_COARSEST = 1e-5  # [s] between numbers that a float type can hold where times are


def named_columns(names: Iterable[str]) -> dict[str, str]:
    """Return the names in a file by x, y, t and p, as far as they are there."""
    there = set(names)
    found = {key: next((n for n in known if n in there), "") for key, known in _NAMES.items()}
    return {key: name for key, name in found.items() if name}


def _check_names(path: Path, names: Iterable[str]) -> None:
    """Refuse columns of which two have a name of one quantity."""
    there = set(names)
    for key, known in _NAMES.items():
        if len(both := [name for name in known if name in there]) > 1:
            raise ObservationError(f"{path} has {' and '.join(both)}: which is {key}? Keep one.")


def _remark_units(times: np.dtype[Any]) -> tuple[str, ...]:
    """The remark on times in floats, of which nothing says the unit."""
    return ("times are floats, and read as seconds",) * (times.kind == "f")


@dataclass(frozen=True)
class EventRecording:
    """A file of events, which is read as often as wanted.

    path: path of the file.
    size: (height, width) of the camera [pixels]; None where nothing says it.
    parts: reads columns x, y, t and p one part after another. Times are microseconds in whole
        numbers, of which those of 32 bits may wrap, or seconds in floats.
    offset: time that is added to all [us].
    remarks: what of the file was read, where that is not plain.
    """

    path: Path
    size: Size | None
    parts: Parts
    offset: int = 0
    remarks: tuple[str, ...] = ()

    def events(self) -> Iterator[Events]:
        """Events (E,) in the order of time, part by part; ObservationError where any is none."""
        count, wraps, last, stored = 0, 0, 0, 0
        polarities = set[float]()
        for x, y, t, p in self._parts():
            if t.dtype.kind == "f":
                us = _microseconds(self.path, t)
            elif t.dtype.itemsize == 4:
                us = t.astype(np.int64)
                falls = us - np.concatenate([[stored], us[:-1]]) < -_FALL
                wrapped = wraps + np.cumsum(falls)
                stored, wraps = int(us[-1]), int(wrapped[-1])
                us = us + _WRAP * wrapped
            else:
                us = t.astype(np.int64)
            events = np.empty(len(us), EVENT)
            us = us + self.offset
            self._check(count, x, y, us, last)
            polarities |= set(np.unique(p).tolist())
            if not any(polarities <= coding for coding in _CODINGS):
                shown = ", ".join(f"{each:.10g}" for each in sorted(polarities)[:6])
                raise ObservationError(
                    f"{self.path} has the polarities {shown}; known are 0 where the light fell and "
                    "1 where it rose, or -1 and 1. Write them so."
                )
            events["x"], events["y"], events["t"], events["p"] = x, y, us, p > 0
            count, last = count + len(us), int(us[-1])
            yield events

    def _parts(self) -> Iterator[Columns]:
        """Parts that hold events, as columns of numbers; ObservationError where there are none."""
        try:
            for part in self.parts():
                numbers = all(each.ndim == 1 and each.dtype.kind in "biuf" for each in part)
                if not numbers or len({len(each) for each in part}) > 1:
                    pairs = zip("xytp", part, strict=True)
                    shown = ", ".join(f"{name} {each.dtype} {each.shape}" for name, each in pairs)
                    raise ObservationError(
                        f"{self.path} holds {shown}; x, y, t and p must be columns of numbers, of "
                        "one length. Cut all to the shortest, if the recording is truncated."
                    )
                if len(part[0]):
                    yield part
        except (ObservationError, ModuleNotFoundError):
            raise
        # h5py and faery raise exceptions of many types for a damaged file
        except Exception as error:
            raise damaged(self.path, error) from error

    def _check(
        self, count: int, x: NDArray[Any], y: NDArray[Any], us: NDArray[np.int64], last: int
    ) -> None:
        """Refuse events between or outside the pixels, or out of the order of time.

        count, last: number of the events before, and time of the last of them [us].
        """
        height, width = self.size or (MOST_PIXELS, MOST_PIXELS)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        inside &= (x == np.rint(x)) & (y == np.rint(y))
        if not inside.all():
            at = int(np.argmin(inside))
            raise ObservationError(
                f"{self.path}: event {count + at} is at x = {x[at]:g}, y = {y[at]:g}; the camera "
                f"has {height}x{width} whole pixels (height x width). Correct the event, or the "
                "size: in the file, or where that has none with --camera HxW."
            )
        before = np.concatenate([[last], us[:-1]])
        if (us < before).any():
            at = int(np.argmax(us < before))
            raise ObservationError(
                f"{self.path}: event {count + at} is at t = {us[at]} us, before t = {before[at]} "
                "us of the one ahead of it; times count from 0. Sort the events by time, and write "
                "them anew."
            )


def _microseconds(path: Path, seconds: NDArray[Any]) -> NDArray[np.int64]:
    """Times [us] of times [s]; ObservationError where they cannot be seconds, or are too coarse."""
    if not np.isfinite(seconds).all():
        raise ObservationError(f"{path} has an event at no time. Correct the events.")
    latest, step = seconds.max(), float(np.spacing(np.abs(seconds).max()))
    is_whole = latest > seconds.min() and (seconds == np.rint(seconds)).all()
    if is_whole or step > _COARSEST:
        why = "all of them whole" if is_whole else f"which has one number each {step:.3g} s there"
        raise ObservationError(
            f"{path} holds times of up to {latest:.10g} in {seconds.dtype}, {why}; times in floats "
            "are seconds. Write them in microseconds, as whole numbers."
        )
    return np.rint(seconds.astype(np.float64) * 1e6).astype(np.int64)


# files

# by the ending of a file, in small letters, the type by which faery reads it
_FAERY = {".aedat4": "aedat", ".raw": "evt", ".es": "es"}
_KINDS = f"HDF5, NumPy structured arrays (.npy), .dat, {', '.join(_FAERY)}"
# what a size of faery means that no header gave: .raw has at most 14 bits for x and y
_UNKNOWN = (1 << 14, 1 << 14)


def open_recording(
    path: Path, camera: Size | None = None, fallback: Size | None = None
) -> EventRecording:
    """The recording in a file; ObservationError where its format is not known or it is damaged.

    camera: (height, width) [pixels]; must be what the file says, where it does.
    fallback: likewise, where neither file nor `camera` say it.
    """
    if not path.is_file():
        raise ObservationError(f"{path} is no file. Give a recording: {_KINDS}.")
    form = suffix(path)
    try:
        if form == ".npy":
            found = _numpy_recording(path)
        elif form == ".dat":
            found = _dat_recording(path)
        elif form in _FAERY:
            found = _faery_recording(path, form)
        elif is_nir_data(path):
            found = _hdf5_recording(path)
        else:
            raise ObservationError(f"{path} is no recording of events that is known: {_KINDS}.")
    except (ObservationError, ModuleNotFoundError):
        raise
    # h5py, numpy and faery raise exceptions of many types for a damaged file
    except Exception as error:
        raise damaged(path, error) from error
    if camera and found.size and camera != found.size:
        raise ObservationError(
            f"{path} says that its camera has {found.size[0]}x{found.size[1]} pixels (height x "
            f"width), --camera {camera[0]}x{camera[1]}. Leave --camera out."
        )
    return replace(found, size=camera or found.size or fallback)


def _numpy_recording(path: Path) -> EventRecording:
    # memory-mapped, which takes no memory; no objects are loaded, which could execute code
    array = np.lib.format.open_memmap(path, mode="r")
    names = array.dtype.names or ()
    if len(fields := named_columns(names)) < 4:
        raise ObservationError(
            f"{path} holds {', '.join(names) or f'plain {array.dtype}'}; needed is a structured "
            "array with the fields x, y, t [us] and p. Rasters go to --input."
        )
    _check_names(path, names)

    def parts() -> Iterator[Columns]:
        for first in range(0, len(array), PART):
            rows = array[first : first + PART]
            yield tuple(np.asarray(rows[fields[name]]) for name in "xytp")

    return EventRecording(path, None, parts, remarks=_remark_units(array.dtype[fields["t"]]))


def _dat_recording(path: Path) -> EventRecording:
    """Events of a .dat, version 2 (docs.prophesee.ai, Encoding Formats, DAT).

    Behind the header stand type and size of an event in a byte each; then for each event its time
    in 32 bits [us], and x, y and polarity in 14, 14 and 4 bits.
    """
    with path.open("rb") as file:
        header = dict[str, int]()
        while (start := file.read(1)) == b"%":
            if found := re.fullmatch(rb"\s*(\w+) (\d+)\s*", file.readline(PART)):
                header[found[1].decode().lower()] = int(found[2])
        place = file.tell() + 1
        event_size = file.read(1)
    kinds = (b"\x00", b"\x0c")  # of change detection, as Metavision and faery write them
    if start not in kinds or event_size != b"\x08" or header.get("version", 2) != 2:
        raise ObservationError(f"{path} holds no events of version 2 of .dat. Convert it anew.")
    count, rest = divmod(path.stat().st_size - place, 8)
    cut = ("the file is cut within its last event, which is left out",) * bool(rest)
    words = np.memmap(path, "<u4", "r", place, (count, 2))

    def parts() -> Iterator[Columns]:
        for first in range(0, len(words), PART):
            t, word = np.asarray(words[first : first + PART]).T
            yield word & 0x3FFF, word >> 14 & 0x3FFF, t, word >> 28

    size = (header["height"], header["width"]) if {"height", "width"} <= header.keys() else None
    return EventRecording(path, size, parts, header.get("t0", 0), cut)  # t0 is faery's


def _faery_recording(path: Path, form: str) -> EventRecording:
    import faery

    with path.open("rb") as file:
        if form == ".raw" and file.read(1) != b"%":
            raise ObservationError(
                f"{path} has no header, which says whether its events are EVT 2, 2.1 or 3. Record "
                "it anew, or convert it with the tools of the camera."
            )

    def stream() -> faery.FiniteEventsStream:
        kind = _FAERY[form]
        return faery.events_stream_from_file(path, dimensions_fallback=_UNKNOWN, file_type=kind)

    def parts() -> Iterator[Columns]:
        if form == ".raw":
            _check_raw(path)
        for events in stream():  # which is read once
            yield events["x"], events["y"], events["t"], events["on"]

    width, height = stream().dimensions()
    return EventRecording(path, None if (width, height) == _UNKNOWN else (height, width), parts)


# by version of EVT: a word, the place of its type in it, and of the time where that is TIME_HIGH
_WORDS = {"2": ("<u4", 28, 0), "21": ("<u8", 60, 32), "3": ("<u2", 12, 0)}
_TIME_HIGH = 8


def _check_raw(path: Path) -> None:
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
        while part := file.read(width * PART):
            words = np.frombuffer(part[: len(part) // width * width], kind)
            high = (words[words >> of_type == _TIME_HIGH] >> of_time & most).astype(np.int64)
            falls = -np.diff(high, prepend=last)
            if ((falls > 0) & (falls < most // 8 * 7)).any():
                raise ObservationError(f"{path}: its times jump back. Sort the events by time.")
            last = int(high[-1]) if len(high) else last


def _header(path: Path) -> bytes:
    """The lines that begin with "%", ahead of all others; of .raw to "% end"."""
    found = b""
    with path.open("rb") as file:
        while (line := file.readline(PART)).startswith(b"%") and line.endswith(b"\n"):
            found += line
            if line.strip() == b"% end":
                break
    return found


def damaged(path: Path, error: Exception) -> ObservationError:
    """Return the error of a file that a library could not read."""
    return ObservationError(
        f"{path} cannot be read to its end as {path.suffix or 'a recording'}: "
        f"{str(error).strip().rstrip('.') or type(error).__name__}. The file is truncated, damaged "
        "or of another format; copy or convert it again."
    )


# HDF5

# a group of columns, a dataset with fields, or a table (N, 4); the first that is there is read
_LAYOUTS = ("CD/events", "events", "event", "")
_TABLE = "txyp"  # columns of v2e's table
_ECF = 36559  # Prophesee's filter
_MOST_CHUNK = 1 << 28  # bytes that HDF5 unpacks at once
_MOST_NAMES = 8  # of a file whose layout is not known

# by x, y, t and p the path of a dataset, and what indexes the column in its rows
_Places: TypeAlias = list[tuple[str, Any]]


def _hdf5_recording(path: Path) -> EventRecording:
    """The recording in a file; ObservationError where it has no layout that is known."""
    with h5py.File(path) as file:
        (place, columns), *others = _layouts(path, file)
        members = _open(path, file, columns)
        for member in members.values():
            _check_filters(path, member)
        size, offset = _size(file, place), _offset(file, place)
        name, field = columns["xytp".index("t")]
        times = members[name].dtype
        remarks = list(_remark_units(times[field] if isinstance(field, str) else times))
        for other, _ in others:
            remarks.append(f"read is {place or 'x, y, t, p'}; {other or 'x, y, t, p'} is there too")

    def parts() -> Iterator[Columns]:
        with h5py.File(path) as file:
            members = _open(path, file, columns)
            for first in range(0, max(map(len, members.values())), PART):
                rows = {place: member[first : first + PART] for place, member in members.items()}
                yield tuple(rows[place][index] for place, index in columns)

    return EventRecording(path, size, parts, offset, tuple(remarks))


def _layouts(path: Path, file: h5py.File) -> list[tuple[str, _Places]]:
    """Places of events in a file, and of their x, y, t and p; the first is read."""
    names, with_fields = list[str](), list[str]()

    def look(name: str, member: object) -> None:
        names.append(name)
        if isinstance(member, h5py.Dataset) and len(named_columns(member.dtype.names or ())) == 4:
            with_fields.append(name)

    file.visititems(look)
    layouts: dict[str, _Places] = {}
    for place in (*_LAYOUTS, *with_fields[: len(with_fields) == 1]):
        member = file.get(place) if place else file
        if isinstance(member, h5py.Group):
            if len(found := named_columns(member)) == 4:
                _check_names(path, member)
                layouts[place] = [(f"{place}/{found[n]}".lstrip("/"), ...) for n in "xytp"]
        elif isinstance(member, h5py.Dataset):
            if len(found := named_columns(member.dtype.names or ())) == 4:
                _check_names(path, member.dtype.names)
                layouts[place] = [(place, found[n]) for n in "xytp"]
            elif member.ndim == 2 and member.shape[1] == 4:
                layouts[place] = [(place, (slice(None), _TABLE.index(n))) for n in "xytp"]
    if layouts:
        return list(layouts.items())
    raise ObservationError(
        f"{path} holds {', '.join(names[:_MOST_NAMES]) or 'nothing'}"
        f"{' ...' * (len(names) > _MOST_NAMES)}; known are x, y, t, p in a group or as fields of "
        f"one dataset, and a table (N, 4) of {', '.join(_TABLE)}, called events. Write it so "
        "(docs/event-camera.md)."
    )


def _open(path: Path, file: h5py.File, columns: _Places) -> dict[str, h5py.Dataset]:
    """The datasets that hold the columns, by their paths."""
    try:
        return {place: open_member(file, place) for place, _ in columns}
    except ArtifactError as error:
        raise ObservationError(f"{path}: {error}") from error


def _size(file: h5py.File, place: str) -> Size | None:
    """(height, width) of the camera, where the file says it."""
    attributes = file[place or "/"].attrs
    if "height" in attributes and "width" in attributes:
        return int(attributes["height"]), int(attributes["width"])
    if found := re.fullmatch(r"(\d+)x(\d+)", str(file.attrs.get("geometry", ""))):
        return int(found[2]), int(found[1])  # Prophesee's, width x height
    return None


def _offset(file: h5py.File, place: str) -> int:
    """[us] from which DSEC's times count, beside or in the group of the columns."""
    for holder in (file.get(place or "/"), file):
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
    if missing := [code for code in filters if not h5py.h5z.filter_avail(code)]:
        remedy = (
            "it is Prophesee's ECF. Where Metavision is installed, metavision_file_to_dat -i FILE "
            "writes a .dat, which is read"
            if missing[0] == _ECF
            else 'pip install "spikedeploy[dsec]", or write it with gzip'
        )
        raise ObservationError(
            f"{path}: {column.name} is compressed by filter {missing[0]}, which HDF5 here has not: "
            f"{remedy}."
        )
