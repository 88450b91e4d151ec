"""Recordings of event cameras in files of several formats.

Structured arrays of NumPy and Prophesee's .dat are read here, HDF5 in `event_hdf5`; AEDAT 4,
Prophesee's .raw (EVT 2, 2.1, 3) and .es by faery. All are read in parts, so that memory does not
grow with the recording.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from spikedeploy.emulation.event_hdf5 import hdf5_recording
from spikedeploy.emulation.event_recording import (
    PART,
    Columns,
    Recording,
    Size,
    damaged,
    named_columns,
)
from spikedeploy.runtime.artifact.nir_data import is_nir_data
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.files import suffix

# by the ending of a file, in small letters, the type by which faery reads it
_FAERY = {".aedat4": "aedat", ".raw": "evt", ".es": "es"}
_KINDS = f"HDF5, NumPy structured arrays (.npy), .dat, {', '.join(_FAERY)}"
# what a size of faery means that no header gave: .raw has at most 14 bits for x and y
_UNKNOWN = (1 << 14, 1 << 14)


def open_recording(
    path: Path, camera: Size | None = None, fallback: Size | None = None
) -> Recording:
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
            found = hdf5_recording(path, camera or fallback)
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


def _numpy_recording(path: Path) -> Recording:
    # memory-mapped, which takes no memory; no objects are loaded, which could execute code
    array = np.lib.format.open_memmap(path, mode="r")
    names = array.dtype.names or ()
    if len(fields := named_columns(names)) < 4:
        raise ObservationError(
            f"{path} holds {', '.join(names) or f'plain {array.dtype}'}; needed is a structured "
            "array with the fields x, y, t [us] and p. Rasters go to --input."
        )

    def parts() -> Iterator[Columns]:
        for first in range(0, len(array), PART):
            rows = array[first : first + PART]
            yield tuple(np.asarray(rows[fields[name]]) for name in "xytp")

    return Recording(path, None, parts)


def _dat_recording(path: Path) -> Recording:
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
    if not start or event_size != b"\x08" or header.get("version", 2) != 2:
        raise ObservationError(f"{path} holds no events of version 2 of .dat. Convert it anew.")
    words = np.memmap(path, "<u4", "r", place, ((path.stat().st_size - place) // 8, 2))

    def parts() -> Iterator[Columns]:
        for first in range(0, len(words), PART):
            t, word = np.asarray(words[first : first + PART]).T
            yield word & 0x3FFF, word >> 14 & 0x3FFF, t, word >> 28

    size = (header["height"], header["width"]) if {"height", "width"} <= header.keys() else None
    return Recording(path, size, parts, offset=header.get("t0", 0))  # t0 is faery's


def _faery_recording(path: Path, form: str) -> Recording:
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
        for events in stream():  # which is read once
            yield events["x"], events["y"], events["t"], events["on"]

    width, height = stream().dimensions()
    return Recording(path, None if (width, height) == _UNKNOWN else (height, width), parts)
