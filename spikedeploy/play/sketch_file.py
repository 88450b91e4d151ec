"""Sketches as files: a track that the validator agrees to, and a draft of one until then."""

import json
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.kart.track_file import load, parse
from spikedeploy.envs.kart.track_rules import check
from spikedeploy.files import write_text
from spikedeploy.play.sketch import Line, Point, Sketch
from spikedeploy.runtime.errors import ConfigError


def draft_of(path: Path) -> Path:
    """Where what is no track yet is kept."""
    return path.with_suffix(".draft.json")


def opened(path: Path, copy: str | None = None) -> Sketch:
    """The draft that was left, or else the track in a file, or else an empty sketch.

    copy  track that a new file begins with
    """
    if path.suffix != ".json" or path.stem.endswith(".draft"):
        raise ConfigError(
            f"{path}: a track is drawn into a file that ends in .json; its .draft.json opens itself"
        )
    here = next((file for file in (draft_of(path), path) if file.exists()), None)
    if here is not None and copy is not None:
        raise ConfigError(f"--copy {copy}: {here} exists; choose a new name for the copy")
    if copy is not None:
        return _of_track(load(copy), path.stem)
    if here is None:
        return Sketch(path.stem)
    try:
        tree = json.loads(here.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"track {here}: not a JSON file ({error})") from error
    if here == path:
        track = parse(tree, f"track {path}")
        return _of_track(track, track.name)
    return _of_draft(tree, here)


def save(sketch: Sketch, path: Path) -> None:
    """Write a track and drop its draft; raises EnvError with the reason why it is none."""
    if sketch.start is None:
        raise EnvError(f"{path.name}: there is no start; S places it at the pointer")
    tree = json.loads(as_text(sketch))
    track = parse(tree, path.name)
    check(track, path.name)
    write_text(path, as_text(sketch))
    draft_of(path).unlink(missing_ok=True)


def save_draft(sketch: Sketch, path: Path) -> Path:
    """Keep a sketch beside the file that it is to become; the draft's path."""
    return write_text(draft_of(path), as_text(sketch))


def as_text(sketch: Sketch) -> str:
    """The file of a sketch, a line for each line."""
    position = None if sketch.start is None else _short(sketch.start)
    start = {
        "position": position,
        "spread": _short([sketch.spread])[0],
        "heading": _short(sketch.heading),
    }
    rows = [
        f'"name": {json.dumps(sketch.name)}',
        f'"walls": {_rows(sketch.walls)}',
        f'"gates": {_rows(sketch.gates)}',
        f'"start": {json.dumps(start)}',
    ]
    if sketch.sway:
        rows.append(f'"sway": {json.dumps(_short([sketch.sway])[0])}')
    return "{\n  " + ",\n  ".join(rows) + "\n}\n"


def _rows(lines: Sequence[Line]) -> str:
    """A list of lines without those that are empty."""
    rows = [json.dumps([_short(point) for point in line]) for line in lines if line]
    return "[\n    " + ",\n    ".join(rows) + "\n  ]" if rows else "[]"


def _short(numbers: Sequence[float]) -> list[float]:
    """Whole numbers without a point."""
    return [int(number) if number == int(number) else number for number in numbers]


def _of_track(track: Track, name: str) -> Sketch:
    low, high = track.heading
    return Sketch(
        name=name,
        walls=(*(_line(line.tolist()) for line in track.polylines), ()),
        gates=tuple(_line(gate) for gate in track.gates.tolist()),
        start=_point(track.start.tolist()),
        spread=track.spread,
        heading=(low, high),
        sway=track.sway,
    )


def _of_draft(tree: Any, path: Path) -> Sketch:  # noqa: ANN401
    """What save_draft wrote."""
    try:
        start = tree["start"]
        low, high = start["heading"]
        return Sketch(
            name=str(tree["name"]),
            walls=(*map(_line, tree["walls"]), ()),
            gates=tuple(map(_line, tree["gates"])),
            start=None if start["position"] is None else _point(start["position"]),
            spread=_number(start["spread"]),
            heading=(_number(low), _number(high)),
            sway=_number(tree.get("sway", 0.0)),
        )
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise ConfigError(
            f"{path}: not a draft that `draw` left ({error}); mend or remove it"
        ) from error


def _line(points: Sequence[Sequence[float]]) -> Line:
    return tuple(map(_point, points))


def _point(numbers: Sequence[float]) -> Point:
    x, y = numbers
    return _number(x), _number(y)


def _number(value: float) -> float:
    if not isfinite(value):
        raise ValueError(f"{value} is no place")
    return float(value)
