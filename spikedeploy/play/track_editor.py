"""`spikedeploy draw`: a track under the pointer."""

from math import pi
from pathlib import Path

import pygame

from spikedeploy.envs.errors import EnvError
from spikedeploy.play.draft_files import as_text, draft_of, opened, save, save_draft
from spikedeploy.play.theme import DIM, GREEN, RED, Colour
from spikedeploy.play.track_draft import History, Point, Sketch
from spikedeploy.play.track_editor_view import HEIGHT, draw_panel, draw_sketch, view_of

REACH = 12.0  # [screen px] within which a click means a point that is there
TURN = pi / 12  # [rad] of the start at a time
ZOOM = 1.15


class Drawing:
    """A track that is drawn.

    title, name, fps  as of a window.App
    path     of the file that it is saved to
    history  the sketch, and what it was
    held     the point that is being moved
    message  (colour, text) of what was done last
    saved    whether the file was written
    """

    fps = 60.0

    def __init__(self, path: Path, copy: str | None = None) -> None:
        left = draft_of(path).exists()
        sketch = opened(path, copy)
        self.path, self.name = path, f"draw-{path.stem}"
        self.title = f"{path.name} – spikedeploy"
        self.history = History(sketch)
        self.held: Point | None = None
        self.saved = False
        self.message: tuple[Colour, str] = (DIM, "Click to begin a wall.")
        if left:
            self.message = (DIM, f"{draft_of(path).name} was left and goes on here.")
        self._view = view_of(sketch)
        self._kept = as_text(sketch)
        self._pointer: Point = (HEIGHT / 2, HEIGHT / 2)

    @property
    def sketch(self) -> Sketch:
        """What is drawn now."""
        return self.history.now

    @property
    def changed(self) -> bool:
        """Whether there is something that no file holds."""
        return as_text(self.sketch) != self._kept

    def handle(self, event: pygame.Event) -> None:
        """Take a key."""
        if event.type != pygame.KEYDOWN:
            return
        ctrl = getattr(event, "mod", 0) & pygame.KMOD_CTRL
        if event.key in (pygame.K_RETURN, pygame.K_KP_ENTER) or (ctrl and event.key == pygame.K_s):
            self._save()
        elif event.key in (pygame.K_z, pygame.K_y):
            self.held = None
            undo = event.key == pygame.K_z
            self.history = self.history.undone() if undo else self.history.redone()
        elif event.key in (pygame.K_w, pygame.K_g):
            wall = event.key == pygame.K_w
            new = self.sketch.new_wall() if wall else self.sketch.new_gate()
            self.history = self.history.chose(new)
        elif event.key == pygame.K_s:
            self._do(self.sketch.started(self._target(0.0)))
        elif event.key in (pygame.K_q, pygame.K_e):
            self._do(self.sketch.turned(TURN if event.key == pygame.K_e else -TURN))
        elif event.key == pygame.K_m:
            self.held = None if self.held else self._near()

    def point(self, event: pygame.Event) -> None:
        """Take a move, a click or a turn of the wheel."""
        if event.type == pygame.MOUSEWHEEL:
            self._view = self._view.zoomed(ZOOM**event.y, self._pointer)
            return
        if self._on_track(event.pos):
            self._pointer = event.pos
            if event.type == pygame.MOUSEBUTTONDOWN and event.button == 1:
                self._click()
            elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 3 and self._near():
                self._do(self.sketch.without(self._near() or (0.0, 0.0)))

    def tick(self) -> None:
        """A drawing waits."""

    def draw(self) -> pygame.Surface:
        """The sketch with the line that would be drawn next, and the panel."""
        target = self._target()
        shown = self.sketch.moved(self.held, target) if self.held else self.sketch
        surface = draw_sketch(shown, self._view, target, bool(self.held))
        file = f"{self.path.name} •" if self.changed else self.path.name
        draw_panel(surface, file, shown, target, bool(self.held), self.message)
        return surface

    def close(self) -> Path | None:
        """Keep what is not saved as a draft; its path, if there is one."""
        if self.changed:
            self._kept = as_text(self.sketch)
            save_draft(self.sketch, self.path)
        return draft_of(self.path) if draft_of(self.path).exists() else None

    def _click(self) -> None:
        target = self._target()
        new = self.sketch.moved(self.held, target) if self.held else self.sketch.added(target)
        self.held = None
        self._do(new)

    def _do(self, sketch: Sketch) -> None:
        self.history = self.history.did(sketch)
        self.message = (DIM, "Not saved yet." if self.changed else "")

    def _save(self) -> None:
        """Write the track, or else its draft, and say which."""
        try:
            self.message = self._written()
        except OSError as error:
            self.message = (RED, f"{self.path}: {error.strerror}; nothing was saved.")
        else:
            self._kept = as_text(self.sketch)

    def _written(self) -> tuple[Colour, str]:
        try:
            save(self.sketch, self.path)
        except EnvError as error:
            draft = save_draft(self.sketch, self.path)
            return RED, f"{error}. Kept as {draft.name}."
        self.saved = True
        return GREEN, f"{self.path.name} is saved: a kart can drive it."

    def _target(self, reach: float = REACH) -> Point:
        """Where a click would be."""
        rest = self.sketch.without(self.held) if self.held else self.sketch
        return rest.snapped(self._view.under(self._pointer), reach / self._view.scale)

    def _near(self) -> Point | None:
        """The point under the pointer."""
        return self.sketch.near(self._view.under(self._pointer), REACH / self._view.scale)

    def _on_track(self, place: Point) -> bool:
        return 0 <= place[0] < HEIGHT and 0 <= place[1] < HEIGHT
