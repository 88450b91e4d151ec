"""A track while it is drawn: lines that may be unfinished, and what was drawn before."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot

Point = tuple[float, float]
Line = tuple[Point, ...]
Heading = tuple[float, float]


@dataclass(frozen=True)
class Sketch:
    """A track that need not be whole; in the units of envs.track.

    name     of the track
    walls    polylines; the last is the one that grows, and is empty where a new one begins
    gates    pairs of points; the last may lack its second
    start    middle of the places to start, None as long as there is none
    spread   of the start
    heading  (lowest, highest) at the start
    sway     of the finish
    gating   whether the next point is a gate's, or else a wall's
    """

    name: str
    walls: tuple[Line, ...] = ()
    gates: tuple[Line, ...] = ()
    start: Point | None = None
    spread: float = 10.0
    heading: Heading = (-0.3, 0.3)
    sway: float = 0.0
    gating: bool = False

    @property
    def points(self) -> tuple[Point, ...]:
        """Of all walls and gates."""
        return tuple(point for line in (*self.walls, *self.gates) for point in line)

    @property
    def growing(self) -> Line:
        """The line that the next point belongs to; empty where it begins one."""
        lines = self.gates if self.gating else self.walls
        last = lines[-1] if lines else ()
        return () if self.gating and len(last) == 2 else last

    def new_wall(self) -> "Sketch":
        """The next point begins a wall."""
        walls = self.walls if self.walls and not self.walls[-1] else (*self.walls, ())
        return replace(self, walls=walls, gating=False)

    def new_gate(self) -> "Sketch":
        """The next point is a gate's."""
        return replace(self, gating=True)

    def added(self, point: Point) -> "Sketch":
        """A point more at the line that grows; the same one twice is one."""
        line = self.growing
        if line and line[-1] == point:
            return self
        grown = (*line, point)
        if self.gating:
            return replace(self, gates=(*(self.gates[:-1] if line else self.gates), grown))
        return replace(self, walls=(*self.walls[:-1], grown))

    def started(self, point: Point) -> "Sketch":
        """With the start there."""
        return replace(self, start=point)

    def turned(self, angle: float) -> "Sketch":
        """With another heading at the start, by so many rad."""
        low, high = (round(value + angle, 4) for value in self.heading)
        return replace(self, heading=(low, high))

    def moved(self, old: Point, new: Point) -> "Sketch":
        """Every line that touches a point, and the start, follow it to another place."""
        start = new if self.start == old else self.start
        return replace(self._mapped(lambda p: new if p == old else p), start=start)

    def without(self, old: Point) -> "Sketch":
        """No line goes through that point any more, and no start is there."""
        start = None if self.start == old else self.start
        return replace(self._mapped(lambda p: None if p == old else p), start=start)

    def near(self, place: Point, reach: float) -> Point | None:
        """The nearest point or start within so many px."""
        points = self.points if self.start is None else (*self.points, self.start)
        found = min(points, key=lambda p: _distance(p, place), default=None)
        return found if found is not None and _distance(found, place) <= reach else None

    def snapped(self, place: Point, reach: float) -> Point:
        """Where a click at a place means: a point nearby, for gates a wall nearby, a whole px."""
        corner = min(self.points, key=lambda p: _distance(p, place), default=None)
        if corner is not None and _distance(corner, place) <= reach:
            return corner
        walls = [_foot(place, a, b) for line in self.walls for a, b in pairwise(line)]
        foot = min(walls, key=lambda p: _distance(p, place), default=None)
        if self.gating and foot is not None and _distance(foot, place) <= reach:
            return _rounded(foot)
        return _rounded(place)

    def _mapped(self, to: Callable[[Point], Point | None]) -> "Sketch":
        gates = tuple(gate for gate in _mapped(self.gates, to) if gate)
        return replace(self, walls=_mapped(self.walls, to), gates=gates)


@dataclass(frozen=True)
class History:
    """A sketch, and those before and after it.

    now     the sketch
    past    (n,) the oldest first
    future  (n,) that were undone, the next first
    """

    now: Sketch
    past: tuple[Sketch, ...] = ()
    future: tuple[Sketch, ...] = ()

    def did(self, sketch: Sketch) -> "History":
        """After a change, which can be undone; what changed nothing leaves no trace."""
        return self if sketch == self.now else History(sketch, (*self.past, self.now))

    def chose(self, sketch: Sketch) -> "History":
        """After a choice of what the next point is for, which undo does not stop at."""
        return replace(self, now=sketch)

    def undone(self) -> "History":
        """One change back."""
        if not self.past:
            return self
        return History(self.past[-1], self.past[:-1], (self.now, *self.future))

    def redone(self) -> "History":
        """One undone change on."""
        if not self.future:
            return self
        return History(self.future[0], (*self.past, self.now), self.future[1:])


def _mapped(lines: tuple[Line, ...], to: Callable[[Point], Point | None]) -> tuple[Line, ...]:
    """Lines of other points; one that has shrunk to less than a line goes, if it is done."""
    found = []
    for index, line in enumerate(lines):
        points = [place for point in line if (place := to(point)) is not None]
        kept = tuple(p for n, p in enumerate(points) if not n or p != points[n - 1])
        if len(kept) > 1 or index == len(lines) - 1:
            found.append(kept)
    return tuple(found)


def _foot(place: Point, a: Point, b: Point) -> Point:
    """The nearest point of a wall."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    share = ((place[0] - a[0]) * dx + (place[1] - a[1]) * dy) / (dx * dx + dy * dy or 1.0)
    share = min(max(share, 0.0), 1.0)
    return a[0] + share * dx, a[1] + share * dy


def _rounded(place: Point) -> Point:
    return float(round(place[0])), float(round(place[1]))


def _distance(a: Point, b: Point) -> float:
    return hypot(a[0] - b[0], a[1] - b[1])
