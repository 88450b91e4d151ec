"""A sketch of a track, drawn, and the panel beside it."""

from dataclasses import dataclass
from itertools import pairwise
from math import cos, sin

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from spikedeploy.envs.kart.picture import KART, draw_kart
from spikedeploy.envs.kart.scene import NIGHT, WALL, thick_line
from spikedeploy.play.theme import (
    AMBER,
    CYAN,
    DIM,
    GREEN,
    PANEL,
    TEXT,
    Colour,
    font,
    heading,
    keycaps,
    write,
)
from spikedeploy.play.track_draft import Line, Point, Sketch

HEIGHT = 800
WIDTH = 340
PAD = 26
GRID: Colour = (24, 28, 39)
METRE = 100.0  # [px]
VIEW = 1000.0  # [px] that are seen of an empty sketch
KEYS = [
    ("CLICK", "point"),
    ("RIGHT", "remove"),
    ("WHEEL", "zoom"),
    ("W", "new wall"),
    ("G", "gates"),
    ("S", "start"),
    ("Q E", "turn it"),
    ("M", "move a point"),
    ("Z", "undo"),
    ("Y", "redo"),
    ("ENTER", "save"),
    ("P", "picture"),
    ("ESC", "leave"),
]


@dataclass(frozen=True)
class View:
    """Which part of the world is seen.

    corner  in the upper left [px]
    scale   [screen px / px]
    """

    corner: Point
    scale: float

    def at(self, points: ArrayLike) -> NDArray[np.float64]:
        """Screen points (…, 2) of points (…, 2) [px] of the world."""
        found: NDArray[np.float64] = (np.asarray(points, np.float64) - self.corner) * self.scale
        return found

    def under(self, place: Point) -> Point:
        """The point of the world under a screen point."""
        return (
            self.corner[0] + place[0] / self.scale,
            self.corner[1] + place[1] / self.scale,
        )

    def zoomed(self, factor: float, place: Point) -> "View":
        """Larger or smaller; what is under a screen point stays there."""
        scale = min(max(self.scale * factor, 0.1), 8.0)
        x, y = self.under(place)
        return View((x - place[0] / scale, y - place[1] / scale), scale)


def view_of(sketch: Sketch) -> View:
    """The whole sketch with a metre around it."""
    if not sketch.points:
        return View((0.0, 0.0), HEIGHT / VIEW)
    low, high = np.min(sketch.points, axis=0) - METRE, np.max(sketch.points, axis=0) + METRE
    side = float((high - low).max())
    x, y = ((low + high - side) / 2).tolist()
    return View((x, y), HEIGHT / side)


def draw_sketch(sketch: Sketch, view: View, target: Point, moving: bool) -> pygame.Surface:
    """Walls, gates and start, and the line to where a click would be."""
    surface = pygame.Surface((HEIGHT + WIDTH, HEIGHT))
    surface.fill(NIGHT)
    _grid(surface, view)
    _start(surface, view, sketch)
    for number, gate in enumerate(sketch.gates, 1):
        _gate(surface, view, gate, number, number == len(sketch.gates))
    for wall in sketch.walls:
        for a, b in pairwise(wall):
            thick_line(surface, WALL, view.at(a), view.at(b), 4)
    for point in sketch.points:
        pygame.draw.aacircle(surface, NIGHT, tuple(view.at(point)), 5)
        pygame.draw.aacircle(surface, WALL, tuple(view.at(point)), 5, 2)
    colour = AMBER if moving or sketch.gating else CYAN
    if sketch.growing and not moving:
        ends = tuple(view.at(sketch.growing[-1])), tuple(view.at(target))
        pygame.draw.aaline(surface, colour, *ends, 2)
    if target in sketch.points:
        pygame.draw.aacircle(surface, colour, tuple(view.at(target)), 10, 2)
    pygame.draw.aacircle(surface, colour, tuple(view.at(target)), 4)
    return surface


def draw_panel(
    surface: pygame.Surface,
    file: str,
    sketch: Sketch,
    target: Point,
    moving: bool,
    message: tuple[Colour, str],
) -> None:
    """What is drawn, what the next click does, what was said last, and the keys."""
    place = pygame.Rect(HEIGHT, 0, WIDTH, HEIGHT)
    pygame.draw.rect(surface, PANEL, place)
    inner = place.inflate(-2 * PAD, -2 * PAD)
    write(surface, file, inner.topleft, 20, TEXT, "bold")
    write(surface, "draw a track", (inner.left, inner.top + 28), 12, DIM)
    y = inner.top + 66
    heading(surface, "next click", (inner.left, y))
    does = "puts the point down" if moving else _next(sketch)
    colour = AMBER if moving or sketch.gating else CYAN
    write(surface, does, (inner.left, y + 17), 19, colour, "bold")
    y += 62
    for name, value in _facts(sketch, target):
        write(surface, name, (inner.left, y), 14, DIM)
        write(surface, value, (inner.right, y), 14, TEXT, "plain", "topright")
        y += 26
    y += 16
    colour, text = message
    for row in _wrapped(text, inner.width):
        y = write(surface, row, (inner.left, y), 13, colour).bottom + 4
    keycaps(surface, KEYS, (inner.left, inner.bottom - 134), inner.width)


def _next(sketch: Sketch) -> str:
    if sketch.gating:
        return "ends the gate" if sketch.growing else "begins a gate"
    return "goes on with the wall" if sketch.growing else "begins a wall"


def _facts(sketch: Sketch, target: Point) -> list[tuple[str, str]]:
    walls = [wall for wall in sketch.walls if wall]
    return [
        ("walls", f"{len(walls)}, of {sum(map(len, walls))} points"),
        ("gates", f"{len(sketch.gates)}, the last is the finish" if sketch.gates else "none"),
        ("start", "none" if sketch.start is None else _metres(sketch.start)),
        ("pointer", _metres(target)),
    ]


def _metres(point: Point) -> str:
    return f"{point[0] / METRE:.2f}, {point[1] / METRE:.2f} m"


def _wrapped(text: str, width: int) -> list[str]:
    """The text in rows that are no wider than that."""
    rows = [""]
    for word in text.split():
        longer = f"{rows[-1]} {word}".strip()
        if font(13).size(longer)[0] <= width or not rows[-1]:
            rows[-1] = longer
        else:
            rows.append(word)
    return rows


def _grid(surface: pygame.Surface, view: View) -> None:
    """A line at each metre."""
    for axis in (0, 1):
        first = np.ceil(view.corner[axis] / METRE) * METRE
        for value in np.arange(first, view.corner[axis] + HEIGHT / view.scale, METRE):
            along = (value - view.corner[axis]) * view.scale
            a, b = ((along, 0), (along, HEIGHT)) if axis == 0 else ((0, along), (HEIGHT, along))
            pygame.draw.line(surface, GRID, a, b)


def _gate(surface: pygame.Surface, view: View, gate: Line, number: int, finish: bool) -> None:
    """A gate with its number; the finish is green."""
    if len(gate) < 2:
        return
    colour = GREEN if finish else AMBER
    a, b = view.at(gate)
    pygame.draw.aaline(surface, colour, tuple(a), tuple(b), 2)
    middle = tuple((a + b) / 2)
    pygame.draw.aacircle(surface, NIGHT, middle, 11)
    pygame.draw.aacircle(surface, colour, middle, 11, 2)
    write(surface, str(number), middle, 12, colour, "bold", "center")


def _start(surface: pygame.Surface, view: View, sketch: Sketch) -> None:
    """A kart, the square that its middle is drawn from, and the fan that it looks into."""
    if sketch.start is None:
        return
    x, y = sketch.start
    low, high = sketch.heading
    angles = np.linspace(low, high, 24)
    rim = [(x + 70 * cos(angle), y + 70 * sin(angle)) for angle in angles]
    veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
    pygame.draw.polygon(veil, (*CYAN, 50), [tuple(view.at(p)) for p in ((x, y), *rim)])
    surface.blit(veil, (0, 0))
    left, top = view.at((x - sketch.spread, y - sketch.spread)).tolist()
    side = 2 * sketch.spread * view.scale
    draw_kart(surface, view, (x, y, (low + high) / 2), KART)
    pygame.draw.rect(surface, CYAN, pygame.Rect(left, top, side, side), 1)
