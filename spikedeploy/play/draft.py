"""A track under construction: lines that may be unfinished, undo, and its files."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import dist, isfinite
from pathlib import Path
from typing import Any

from spikedeploy.envs.kart.track import Track, check, load, parse
from spikedeploy.runtime.errors import ConfigError, EnvError
from spikedeploy.runtime.files import suffix, write_text

Point = tuple[float, float]
Line = tuple[Point, ...]
Heading = tuple[float, float]


@dataclass(frozen=True)
class TrackDraft:
    """A track that may be incomplete, in the units of envs.kart.track.

    name     of the track
    walls    polylines; points are appended to the last, which is empty for a new wall
    gates    pairs of points; the last may lack its second point
    start    centre of the start area, None before it is placed
    spread   of the start
    heading  (lowest, highest) at the start
    sway     of the finish
    adding_gates  whether the next point belongs to a gate, not to a wall
    """

    name: str
    walls: tuple[Line, ...] = ()
    gates: tuple[Line, ...] = ()
    start: Point | None = None
    spread: float = 10.0
    heading: Heading = (-0.3, 0.3)
    sway: float = 0.0
    adding_gates: bool = False

    @property
    def points(self) -> tuple[Point, ...]:
        """The points of all walls and gates."""
        return tuple(point for line in (*self.walls, *self.gates) for point in line)

    @property
    def open_line(self) -> Line:
        """The line that the next point extends; empty where it begins a new one."""
        lines = self.gates if self.adding_gates else self.walls
        last = lines[-1] if lines else ()
        return () if self.adding_gates and len(last) == 2 else last

    def new_wall(self) -> "TrackDraft":
        """With a new wall, which the next point begins."""
        walls = self.walls if self.walls and not self.walls[-1] else (*self.walls, ())
        return replace(self, walls=walls, adding_gates=False)

    def new_gate(self) -> "TrackDraft":
        """With gates next."""
        return replace(self, adding_gates=True)

    def with_point(self, point: Point) -> "TrackDraft":
        """With a point appended to the open line, unless it repeats the last one."""
        line = self.open_line
        if line and line[-1] == point:
            return self
        grown = (*line, point)
        if self.adding_gates:
            return replace(self, gates=(*(self.gates[:-1] if line else self.gates), grown))
        return replace(self, walls=(*self.walls[:-1], grown))

    def with_start(self, point: Point) -> "TrackDraft":
        """With the start at a point."""
        return replace(self, start=point)

    def with_turn(self, angle: float) -> "TrackDraft":
        """With the headings at the start turned by an angle [rad]."""
        low, high = (round(value + angle, 4) for value in self.heading)
        return replace(self, heading=(low, high))

    def with_point_moved(self, old: Point, new: Point) -> "TrackDraft":
        """With a point moved, in every line that has it and in the start."""
        start = new if self.start == old else self.start
        return replace(self._map_points(lambda p: new if p == old else p), start=start)

    def without(self, old: Point) -> "TrackDraft":
        """Without a point, in every line and in the start."""
        start = None if self.start == old else self.start
        return replace(self._map_points(lambda p: None if p == old else p), start=start)

    def near(self, place: Point, reach: float) -> Point | None:
        """The nearest point or start within `reach` [px]."""
        points = self.points if self.start is None else (*self.points, self.start)
        found = min(points, key=lambda p: dist(p, place), default=None)
        return found if found is not None and dist(found, place) <= reach else None

    def snap(self, place: Point, reach: float) -> Point:
        """The point of a click: an existing point nearby, for gates a near wall, else whole px."""
        corner = min(self.points, key=lambda p: dist(p, place), default=None)
        if corner is not None and dist(corner, place) <= reach:
            return corner
        walls = [_foot(place, a, b) for line in self.walls for a, b in pairwise(line)]
        foot = min(walls, key=lambda p: dist(p, place), default=None)
        if self.adding_gates and foot is not None and dist(foot, place) <= reach:
            return _round(foot)
        return _round(place)

    def _map_points(self, to: Callable[[Point], Point | None]) -> "TrackDraft":
        gates = tuple(gate for gate in _map_points(self.gates, to) if gate)
        return replace(self, walls=_map_points(self.walls, to), gates=gates)


@dataclass(frozen=True)
class History:
    """A draft with its undo history.

    now     the current draft
    past    (n,) the oldest first
    future  (n,) undone drafts, the next first
    """

    now: TrackDraft
    past: tuple[TrackDraft, ...] = ()
    future: tuple[TrackDraft, ...] = ()

    def record(self, draft: TrackDraft) -> "History":
        """After a change, which can be undone; unchanged without one."""
        return self if draft == self.now else History(draft, (*self.past, self.now))

    def replace_now(self, draft: TrackDraft) -> "History":
        """After a change that undo passes over, such as walls or gates next."""
        return replace(self, now=draft)

    def undo(self) -> "History":
        """After undo."""
        *past, before = self.past or (self.now,)
        return History(before, tuple(past), (self.now, *self.future)) if self.past else self

    def redo(self) -> "History":
        """After redo."""
        after, *future = self.future or (self.now,)
        return History(after, (*self.past, self.now), tuple(future)) if self.future else self


def _map_points(lines: tuple[Line, ...], to: Callable[[Point], Point | None]) -> tuple[Line, ...]:
    """Lines with mapped points; finished lines with fewer than two points are dropped."""
    found = []
    for index, line in enumerate(lines):
        points = [place for point in line if (place := to(point)) is not None]
        kept = tuple(p for n, p in enumerate(points) if not n or p != points[n - 1])
        if len(kept) > 1 or index == len(lines) - 1:
            found.append(kept)
    return tuple(found)


def _foot(place: Point, a: Point, b: Point) -> Point:
    """The nearest point of a wall segment."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    share = ((place[0] - a[0]) * dx + (place[1] - a[1]) * dy) / (dx * dx + dy * dy or 1.0)
    share = min(max(share, 0.0), 1.0)
    return a[0] + share * dx, a[1] + share * dy


def _round(place: Point) -> Point:
    return float(round(place[0])), float(round(place[1]))


# files


def draft_of(path: Path) -> Path:
    """The path of the draft of a track file."""
    return path.with_suffix(".draft.json")


def open_draft(path: Path, copy: str | None = None) -> TrackDraft:
    """The unfinished draft of a file, else its track, else an empty draft.

    copy  track to begin a new file with
    """
    if suffix(path) != ".json" or path.stem.lower().endswith(".draft"):
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
    try:
        return _from_tree(tree)
    except (TypeError, KeyError, ValueError, AttributeError, OverflowError) as error:
        raise ConfigError(
            f"{here}: not a draft that `draw` left ({error}); repair or remove it"
        ) from error


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
    """The JSON text of a draft, a row for each line; integral numbers as such."""

    def short(value: Any) -> Any:  # noqa: ANN401
        if isinstance(value, tuple):
            return [short(each) for each in value]
        return int(value) if value == int(value) else value

    def rows(lines: Sequence[Line]) -> str:
        texts = [json.dumps(short(line)) for line in lines if line]
        return "[\n    " + ",\n    ".join(texts) + "\n  ]" if texts else "[]"

    position = None if draft.start is None else short(draft.start)
    start = {
        "position": position,
        "spread": short(draft.spread),
        "heading": short(draft.heading),
    }
    members = {
        "name": json.dumps(draft.name),
        "walls": rows(draft.walls),
        "gates": rows(draft.gates),
        "start": json.dumps(start),
        **({"sway": json.dumps(short(draft.sway))} if draft.sway else {}),
    }
    return "{\n  " + ",\n  ".join(f'"{name}": {text}' for name, text in members.items()) + "\n}\n"


def _of_track(track: Track, name: str) -> TrackDraft:
    return TrackDraft(
        name,
        (*(_line(line.tolist()) for line in track.polylines), ()),
        tuple(map(_line, track.gates.tolist())),
        _point(track.start.tolist()),
        track.spread,
        track.heading,
        track.sway,
    )


def _from_tree(tree: Mapping[str, Any]) -> TrackDraft:
    """The draft in the JSON that `as_text` makes."""
    start = tree["start"]
    return TrackDraft(
        str(tree["name"]),
        (*map(_line, tree["walls"]), ()),
        tuple(map(_line, tree["gates"])),
        None if start["position"] is None else _point(start["position"]),
        _number(start["spread"]),
        _point(start["heading"]),
        _number(tree.get("sway", 0.0)),
    )


def _line(points: Sequence[Sequence[float]]) -> Line:
    return tuple(map(_point, points))


def _point(numbers: Sequence[float]) -> Point:
    x, y = numbers
    return _number(x), _number(y)


def _number(value: float) -> float:
    if not isfinite(value):
        raise ValueError(f"{value} is not a coordinate")
    return float(value)
