"""`spikedeploy draw`: the window in which a track is drawn."""

from dataclasses import dataclass
from itertools import pairwise
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from spikedeploy.envs.kart.picture import KART, NIGHT, WALL, draw_kart, thick_line
from spikedeploy.play.draft import (
    History,
    Line,
    Point,
    TrackDraft,
    as_text,
    draft_of,
    open_draft,
    save,
    save_draft,
)
from spikedeploy.play.theme import (
    AMBER,
    CYAN,
    DIM,
    GREEN,
    HEIGHT,
    RED,
    Colour,
    Panel,
    font,
    write,
)
from spikedeploy.play.window import App
from spikedeploy.runtime.errors import EnvError

_REACH = 12.0  # [screen px] within which a click snaps to an existing point
_TURN = pi / 12  # [rad] of the start with each key press
_ZOOM = 1.15
_WIDTH = 340
_GRID: Colour = (24, 28, 39)
_METRE = 100.0  # [px]
_VIEW = 1000.0  # [px] shown of an empty draft
_KEYS = [
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


class TrackEditor(App):
    """The app: a draft of a track under the pointer.

    path     of the file that it is saved to
    history  the draft and its undo history
    held     the point that is being moved
    message  (colour, text) of the last action
    saved    whether the file was written
    """

    fps = 60.0

    def __init__(self, path: Path, copy: str | None = None) -> None:
        left = draft_of(path).exists()
        draft = open_draft(path, copy)
        self.path, self.name = path, f"draw-{path.stem}"
        self.title = f"{path.name} – spikedeploy"
        self.history = History(draft)
        self.held: Point | None = None
        self.saved = False
        self.message: tuple[Colour, str] = (DIM, "Click to begin a wall.")
        if left:
            self.message = (DIM, f"{draft_of(path).name} was left and goes on here.")
        self._view = view_of(draft)
        self._saved_text = as_text(draft)
        self._pointer: Point = (HEIGHT / 2, HEIGHT / 2)

    @property
    def draft(self) -> TrackDraft:
        """The line that is drawn now."""
        return self.history.now

    @property
    def changed(self) -> bool:
        """True if there are unsaved changes."""
        return as_text(self.draft) != self._saved_text

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press."""
        if event.type != pygame.KEYDOWN:
            return
        ctrl = getattr(event, "mod", 0) & pygame.KMOD_CTRL
        if event.key in (pygame.K_RETURN, pygame.K_KP_ENTER) or (ctrl and event.key == pygame.K_s):
            self._save()
        elif event.key in (pygame.K_z, pygame.K_y):
            self.held = None
            undo = event.key == pygame.K_z
            self.history = self.history.undo() if undo else self.history.redo()
        elif event.key in (pygame.K_w, pygame.K_g):
            wall = event.key == pygame.K_w
            new = self.draft.new_wall() if wall else self.draft.new_gate()
            self.history = self.history.replace_now(new)
        elif event.key == pygame.K_s:
            self._change(self.draft.with_start(self._target(0.0)))
        elif event.key in (pygame.K_q, pygame.K_e):
            self._change(self.draft.with_turn(_TURN if event.key == pygame.K_e else -_TURN))
        elif event.key == pygame.K_m:
            self.held = None if self.held else self._near()

    def point(self, event: pygame.Event) -> None:
        """Handle a mouse move, click or wheel event."""
        if event.type == pygame.MOUSEWHEEL:
            self._view = self._view.zoom(_ZOOM**event.y, self._pointer)
            return
        if max(event.pos) < HEIGHT and min(event.pos) >= 0:
            self._pointer = event.pos
            if event.type == pygame.MOUSEBUTTONDOWN and event.button == 1:
                self._click()
            elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 3 and self._near():
                self._change(self.draft.without(self._near() or (0.0, 0.0)))

    def draw(self) -> pygame.Surface:
        """The draft with a preview of the next line, and the panel."""
        target = self._target()
        shown = self.draft.with_point_moved(self.held, target) if self.held else self.draft
        surface = draw_draft(shown, self._view, target, bool(self.held))
        file = f"{self.path.name} •" if self.changed else self.path.name
        place = pygame.Rect(HEIGHT, 0, _WIDTH, HEIGHT)
        panel = Panel(surface, place, file, "draw a track", _KEYS, 4)
        _draw_facts(panel, shown, target, bool(self.held))
        _draw_message(panel, *self.message)
        return surface

    def close(self) -> Path | None:
        """Write unsaved changes to a draft file; return its path, if there is one."""
        if self.changed:
            self._saved_text = as_text(self.draft)
            save_draft(self.draft, self.path)
        return draft_of(self.path) if draft_of(self.path).exists() else None

    def _click(self) -> None:
        target = self._target()  # which depends on the point that is held
        held, self.held = self.held, None
        draft = self.draft
        self._change(draft.with_point_moved(held, target) if held else draft.with_point(target))

    def _change(self, draft: TrackDraft) -> None:
        self.history = self.history.record(draft)
        self.message = (DIM, "Not saved yet." if self.changed else "")

    def _save(self) -> None:
        """Write the track, or if it is invalid its draft, and set the message."""
        try:
            try:
                save(self.draft, self.path)
            except EnvError as error:
                draft = save_draft(self.draft, self.path)
                self.message = (RED, f"{error}. Kept as {draft.name}.")
            else:
                self.saved = True
                self.message = (GREEN, f"{self.path.name} is saved: a kart can drive it.")
            self._saved_text = as_text(self.draft)
        except OSError as error:
            self.message = (RED, f"{self.path}: {error.strerror}; nothing was saved.")

    def _target(self, reach: float = _REACH) -> Point:
        """The point that a click would set."""
        rest = self.draft.without(self.held) if self.held else self.draft
        return rest.snap(self._view.point_under(self._pointer), reach / self._view.scale)

    def _near(self) -> Point | None:
        """The point under the pointer."""
        return self.draft.near(self._view.point_under(self._pointer), _REACH / self._view.scale)


# what is seen


@dataclass(frozen=True)
class View:
    """The visible part of the world.

    corner  upper left [px]
    scale   [screen px / px]
    """

    corner: Point
    scale: float

    def at(self, points: ArrayLike) -> NDArray[np.float64]:
        """Screen points (…, 2) of points (…, 2) [px] of the world."""
        found: NDArray[np.float64] = (np.asarray(points, np.float64) - self.corner) * self.scale
        return found

    def point_under(self, place: Point) -> Point:
        """The point of the world under a screen point."""
        return self.corner[0] + place[0] / self.scale, self.corner[1] + place[1] / self.scale

    def zoom(self, factor: float, place: Point) -> "View":
        """Zoomed about a screen point."""
        scale = min(max(self.scale * factor, 0.1), 8.0)
        x, y = self.point_under(place)
        return View((x - place[0] / scale, y - place[1] / scale), scale)


def view_of(draft: TrackDraft) -> View:
    """A view of the whole draft with a margin of one metre."""
    if not draft.points:
        return View((0.0, 0.0), HEIGHT / _VIEW)
    low, high = np.min(draft.points, axis=0) - _METRE, np.max(draft.points, axis=0) + _METRE
    side = float((high - low).max())
    x, y = ((low + high - side) / 2).tolist()
    return View((x, y), HEIGHT / side)


def draw_draft(draft: TrackDraft, view: View, target: Point, moving: bool) -> pygame.Surface:
    """Walls, gates, start, and the line to the point that a click would set."""
    surface = pygame.Surface((HEIGHT + _WIDTH, HEIGHT))
    surface.fill(NIGHT)
    _grid(surface, view)
    _start(surface, view, draft)
    for number, gate in enumerate(draft.gates, 1):
        _gate(surface, view, gate, number, number == len(draft.gates))
    for wall in draft.walls:
        for a, b in pairwise(wall):
            thick_line(surface, WALL, view.at(a), view.at(b), 4)
    for point in draft.points:
        pygame.draw.aacircle(surface, NIGHT, tuple(view.at(point)), 5)
        pygame.draw.aacircle(surface, WALL, tuple(view.at(point)), 5, 2)
    colour = AMBER if moving or draft.adding_gates else CYAN
    if draft.open_line and not moving:
        ends = tuple(view.at(draft.open_line[-1])), tuple(view.at(target))
        pygame.draw.aaline(surface, colour, *ends, 2)
    if target in draft.points:
        pygame.draw.aacircle(surface, colour, tuple(view.at(target)), 10, 2)
    pygame.draw.aacircle(surface, colour, tuple(view.at(target)), 4)
    return surface


def _draw_facts(panel: Panel, draft: TrackDraft, target: Point, moving: bool) -> None:
    """Draw what the next click does, and facts."""
    adding, begun = draft.adding_gates, bool(draft.open_line)
    if moving:
        does = "puts the point down"
    elif adding:
        does = "ends the gate" if begun else "begins a gate"
    else:
        does = "goes on with the wall" if begun else "begins a wall"
    panel.title("next click")
    panel.text(does, 17, 19, AMBER if moving or adding else CYAN, "bold")
    panel.y += 62
    walls = [wall for wall in draft.walls if wall]
    panel.row("walls", f"{len(walls)}, of {sum(map(len, walls))} points")
    panel.row("gates", f"{len(draft.gates)}, the last is the finish" if draft.gates else "none")
    for name, point in (("start", draft.start), ("pointer", target)):
        at = point and f"{point[0] / _METRE:.2f}, {point[1] / _METRE:.2f} m"
        panel.row(name, at or "none")


def _draw_message(panel: Panel, colour: Colour, text: str) -> None:
    """Draw a text, wrapped to the width."""
    rows = [""]
    for word in text.split():
        longer = f"{rows[-1]} {word}".strip()
        if font(13).size(longer)[0] <= panel.inner.width or not rows[-1]:
            rows[-1] = longer
        else:
            rows.append(word)
    panel.y += 16
    for row in rows:
        panel.y = panel.text(row, 0, 13, colour).bottom + 4


def _grid(surface: pygame.Surface, view: View) -> None:
    """A grid with a line at each metre."""
    for axis in (0, 1):
        first = np.ceil(view.corner[axis] / _METRE) * _METRE
        for value in np.arange(first, view.corner[axis] + HEIGHT / view.scale, _METRE):
            along = (value - view.corner[axis]) * view.scale
            a, b = ((along, 0), (along, HEIGHT)) if axis == 0 else ((0, along), (HEIGHT, along))
            pygame.draw.line(surface, _GRID, a, b)


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


def _start(surface: pygame.Surface, view: View, draft: TrackDraft) -> None:
    """A kart at the start, the square of start positions, and the sector of headings."""
    if draft.start is None:
        return
    x, y = draft.start
    low, high = draft.heading
    angles = np.linspace(low, high, 24)
    rim = [(x + 70 * cos(angle), y + 70 * sin(angle)) for angle in angles]
    veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
    pygame.draw.polygon(veil, (*CYAN, 50), [tuple(view.at(p)) for p in ((x, y), *rim)])
    surface.blit(veil, (0, 0))
    left, top = view.at((x - draft.spread, y - draft.spread)).tolist()
    side = 2 * draft.spread * view.scale
    draw_kart(surface, view, (x, y, (low + high) / 2), KART)
    pygame.draw.rect(surface, CYAN, pygame.Rect(left, top, side, side), 1)
