"""Track files: read, checked and cached; tracks/*.json are the shipped ones.

A file holds one JSON object (docs/tracks.md):

    name   text
    walls  polylines, each a list of at least two points [x, y] in px (100 px = 1 m, y downwards)
    gates  pairs of points, in the order in which they are passed; the last is the finish
    start  {"position": [x, y], "spread": px, "heading": [lowest, highest] in rad}
    sway   optional: at each reset, the finish is shifted along y by up to this many px
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.track import Track, segments
from spikedeploy.envs.kart.track_rules import check

FloatArray = NDArray[np.float64]
FOLDER = Path(__file__).parent / "tracks"
_LARGEST = 5 << 20  # [bytes]
_MOST_WALLS = 20_000  # segments; and gates
_FIELDS = ("name", "walls", "gates", "start")
_START = ("position", "spread", "heading")


def names() -> tuple[str, ...]:
    """Names of the shipped tracks."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.json")))


def load(track: str | Path) -> Track:
    """A shipped track by name, or any track by the path of its file.

    Raises EnvError where the file is malformed or the track cannot be driven.
    """
    path = Path(track)
    if path.suffix != ".json":
        if str(track) not in names():
            raise EnvError(_unknown(str(track)))
        path = FOLDER / f"{track}.json"
    try:
        found = path.stat()
    except OSError as error:
        raise EnvError(f"track {path}: {error.strerror}") from error
    if not path.is_file() or found.st_size > _LARGEST:
        raise EnvError(f"track {path}: no file, or more than {_LARGEST} bytes: no track is so long")
    changed = found.st_mtime_ns
    return _read(path, changed)


@lru_cache(maxsize=32)
def _read(path: Path, changed: int) -> Track:
    """Read and check a file; cached until its modification time `changed` changes."""
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise EnvError(f"track {path}: not a JSON file ({error})") from error
    track = parse(tree, f"track {path}")
    check(track, f"track {path}")
    return track


def parse(tree: object, where: str) -> Track:
    """The track in a file's JSON object; `where` names the file in errors."""
    fields = _fields(tree, _FIELDS, ("sway",), where)
    start = _fields(fields["start"], _START, (), f"{where}: start")
    polylines = _lines(fields["walls"], f"{where}: wall")
    low, high = _numbers(start["heading"], (2,), f"{where}: start heading")
    track = Track(
        name=str(fields["name"]),
        walls=segments(polylines),
        gates=_gates(fields["gates"], where),
        start=_numbers(start["position"], (2,), f"{where}: start position"),
        spread=float(_numbers(start["spread"], (), f"{where}: start spread")),
        heading=(float(low), float(high)),
        sway=float(_numbers(fields.get("sway", 0.0), (), f"{where}: sway")),
        polylines=polylines,
    )
    if len(track.walls) > _MOST_WALLS or len(track.gates) > _MOST_WALLS:
        raise EnvError(
            f"{where}: {len(track.walls)} segments of walls and {len(track.gates)} gates; at most "
            f"{_MOST_WALLS} of each. Draw with fewer points"
        )
    if track.spread < 0 or track.sway < 0 or low > high:
        raise EnvError(
            f"{where}: spread {track.spread} and sway {track.sway} must not be negative, "
            f"and the heading [{low}, {high}] must be in ascending order"
        )
    return track


def _gates(value: object, where: str) -> FloatArray:
    lines = _lines(value, f"{where}: gate")
    for number, line in enumerate(lines, start=1):
        if len(line) != 2:
            raise EnvError(f"{where}: gate {number} has {len(line)} points; a gate has two")
    return np.stack(lines)


def _lines(value: object, where: str) -> tuple[FloatArray, ...]:
    """A non-empty list of lines."""
    if not isinstance(value, list) or not value:
        raise EnvError(f"{where}s: must be a list of lines, at least one; found {str(value)[:60]}")
    return tuple(_points(line, f"{where} {number}") for number, line in enumerate(value, 1))


def _points(value: object, where: str) -> FloatArray:
    """At least two points (n, 2), no two consecutive ones equal."""
    points = _numbers(value, (None, 2), where)
    if len(points) < 2:
        raise EnvError(f"{where}: {len(points)} point; a line needs two")
    lengths = np.hypot(*np.diff(points, axis=0).T)
    if not lengths.all():
        place = int(np.flatnonzero(lengths == 0)[0]) + 1
        raise EnvError(f"{where}: points {place} and {place + 1} are the same")
    return points


def _numbers(value: object, shape: Sequence[int | None], where: str) -> FloatArray:
    """An array of finite numbers; None in the shape stands for any length."""
    wanted = "a number" if not shape else f"numbers of shape {tuple(n or 'n' for n in shape)}"
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise EnvError(f"{where}: must be {wanted}, found {str(value)[:60]}") from None
    fits = len(array.shape) == len(shape) and all(
        wanted in (None, size) for wanted, size in zip(shape, array.shape, strict=True)
    )
    if not fits or not np.isfinite(array).all():
        raise EnvError(f"{where}: must be {wanted}, all finite; found {str(value)[:60]}")
    return array


def _fields(
    value: object, needed: Sequence[str], optional: Sequence[str], where: str
) -> dict[str, Any]:
    """The fields of a JSON object, which must have all the needed ones and no unknown ones."""
    if not isinstance(value, dict):
        raise EnvError(f"{where}: must be an object with {', '.join(needed)}")
    missing = [name for name in needed if name not in value]
    unknown = sorted(value.keys() - {*needed, *optional})
    if missing or unknown:
        fault = f"{missing[0]!r} is missing" if missing else f"unknown field {unknown[0]!r}"
        raise EnvError(f"{where}: {fault}; it has {', '.join([*needed, *optional])}")
    return value


def _unknown(name: str) -> str:
    known = [*names(), "corridor"]
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}."
    return f"unknown track {name!r}; {hint} A file of your own ends in .json"
