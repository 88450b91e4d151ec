"""Files of the track editor: a valid track, or a draft beside it."""

import json
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.track import Track, check, load, parse
from spikedeploy.files import write_text
from spikedeploy.play.track_draft import Line, Point, TrackDraft
from spikedeploy.runtime.errors import ConfigError


def draft_of(path: Path) -> Path:
    """The path of the draft of a track file."""
    return path.with_suffix(".draft.json")


def open_draft(path: Path, copy: str | None = None) -> TrackDraft:
    """The unfinished draft of a file, else its track, else an empty draft.

    copy  track to begin a new file with
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
        return TrackDraft(path.stem)
    try:
        tree = json.loads(here.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"track {here}: not a JSON file ({error})") from error
    if here == path:
        track = parse(tree, f"track {path}")
        return _of_track(track, track.name)
    return _of_draft(tree, here)


def save(draft: TrackDraft, path: Path) -> None:
    """Write a track and remove its draft; EnvError if the track is invalid."""
    if draft.start is None:
        raise EnvError(f"{path.name}: there is no start; S places it at the pointer")
    tree = json.loads(as_text(draft))
    track = parse(tree, path.name)
    check(track, path.name)
    write_text(path, as_text(draft))
    draft_of(path).unlink(missing_ok=True)


def save_draft(draft: TrackDraft, path: Path) -> Path:
    """Write the draft of a track file; return its path."""
    return write_text(draft_of(path), as_text(draft))


def as_text(draft: TrackDraft) -> str:
    """The JSON text of a draft, a row for each line."""
    position = None if draft.start is None else _short(draft.start)
    start = {
        "position": position,
        "spread": _short([draft.spread])[0],
        "heading": _short(draft.heading),
    }
    rows = [
        f'"name": {json.dumps(draft.name)}',
        f'"walls": {_rows(draft.walls)}',
        f'"gates": {_rows(draft.gates)}',
        f'"start": {json.dumps(start)}',
    ]
    if draft.sway:
        rows.append(f'"sway": {json.dumps(_short([draft.sway])[0])}')
    return "{\n  " + ",\n  ".join(rows) + "\n}\n"


def _rows(lines: Sequence[Line]) -> str:
    """A JSON list of the non-empty lines."""
    rows = [json.dumps([_short(point) for point in line]) for line in lines if line]
    return "[\n    " + ",\n    ".join(rows) + "\n  ]" if rows else "[]"


def _short(numbers: Sequence[float]) -> list[float]:
    """Numbers, integral ones as int."""
    return [int(number) if number == int(number) else number for number in numbers]


def _of_track(track: Track, name: str) -> TrackDraft:
    low, high = track.heading
    return TrackDraft(
        name=name,
        walls=(*(_line(line.tolist()) for line in track.polylines), ()),
        gates=tuple(_line(gate) for gate in track.gates.tolist()),
        start=_point(track.start.tolist()),
        spread=track.spread,
        heading=(low, high),
        sway=track.sway,
    )


def _of_draft(tree: Any, path: Path) -> TrackDraft:  # noqa: ANN401
    """The draft from what save_draft wrote."""
    try:
        start = tree["start"]
        low, high = start["heading"]
        return TrackDraft(
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
            f"{path}: not a draft that `draw` left ({error}); repair or remove it"
        ) from error


def _line(points: Sequence[Sequence[float]]) -> Line:
    return tuple(map(_point, points))


def _point(numbers: Sequence[float]) -> Point:
    x, y = numbers
    return _number(x), _number(y)


def _number(value: float) -> float:
    if not isfinite(value):
        raise ValueError(f"{value} is not a coordinate")
    return float(value)
