"""`spikedeploy draw`: the window in which a track is drawn."""

from math import pi
from pathlib import Path

import pygame

from spikedeploy.envs.errors import EnvError
from spikedeploy.play.draft_files import as_text, draft_of, open_draft, save, save_draft
from spikedeploy.play.theme import DIM, GREEN, RED, Colour
from spikedeploy.play.track_draft import History, Point, TrackDraft
from spikedeploy.play.track_editor_view import HEIGHT, draw_draft, draw_panel, view_of

_REACH = 12.0  # [screen px] within which a click snaps to an existing point
_TURN = pi / 12  # [rad] of the start with each key press
_ZOOM = 1.15


class TrackEditor:
    """The app: a draft of a track under the pointer.

    title, name, fps  as of a window.App
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
        """What is drawn now."""
        return self.history.now

    @property
    def changed(self) -> bool:
        """Whether there are unsaved changes."""
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
            self.history = self.history.undone() if undo else self.history.redone()
        elif event.key in (pygame.K_w, pygame.K_g):
            wall = event.key == pygame.K_w
            new = self.draft.new_wall() if wall else self.draft.new_gate()
            self.history = self.history.chose(new)
        elif event.key == pygame.K_s:
            self._change(self.draft.started(self._target(0.0)))
        elif event.key in (pygame.K_q, pygame.K_e):
            self._change(self.draft.turned(_TURN if event.key == pygame.K_e else -_TURN))
        elif event.key == pygame.K_m:
            self.held = None if self.held else self._near()

    def point(self, event: pygame.Event) -> None:
        """Handle a mouse move, click or wheel event."""
        if event.type == pygame.MOUSEWHEEL:
            self._view = self._view.zoomed(_ZOOM**event.y, self._pointer)
            return
        if self._on_track(event.pos):
            self._pointer = event.pos
            if event.type == pygame.MOUSEBUTTONDOWN and event.button == 1:
                self._click()
            elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 3 and self._near():
                self._change(self.draft.without(self._near() or (0.0, 0.0)))

    def tick(self) -> None:
        """Nothing: time has no effect."""

    def draw(self) -> pygame.Surface:
        """The draft with a preview of the next line, and the panel."""
        target = self._target()
        shown = self.draft.moved(self.held, target) if self.held else self.draft
        surface = draw_draft(shown, self._view, target, bool(self.held))
        file = f"{self.path.name} •" if self.changed else self.path.name
        draw_panel(surface, file, shown, target, bool(self.held), self.message)
        return surface

    def close(self) -> Path | None:
        """Write unsaved changes to a draft file; return its path, if there is one."""
        if self.changed:
            self._saved_text = as_text(self.draft)
            save_draft(self.draft, self.path)
        return draft_of(self.path) if draft_of(self.path).exists() else None

    def _click(self) -> None:
        target = self._target()
        new = self.draft.moved(self.held, target) if self.held else self.draft.added(target)
        self.held = None
        self._change(new)

    def _change(self, draft: TrackDraft) -> None:
        self.history = self.history.did(draft)
        self.message = (DIM, "Not saved yet." if self.changed else "")

    def _save(self) -> None:
        """Write the track, or if it is invalid its draft, and set the message."""
        try:
            self.message = self._written()
        except OSError as error:
            self.message = (RED, f"{self.path}: {error.strerror}; nothing was saved.")
        else:
            self._saved_text = as_text(self.draft)

    def _written(self) -> tuple[Colour, str]:
        try:
            save(self.draft, self.path)
        except EnvError as error:
            draft = save_draft(self.draft, self.path)
            return RED, f"{error}. Kept as {draft.name}."
        self.saved = True
        return GREEN, f"{self.path.name} is saved: a kart can drive it."

    def _target(self, reach: float = _REACH) -> Point:
        """The point that a click would set."""
        rest = self.draft.without(self.held) if self.held else self.draft
        return rest.snapped(self._view.under(self._pointer), reach / self._view.scale)

    def _near(self) -> Point | None:
        """The point under the pointer."""
        return self.draft.near(self._view.under(self._pointer), _REACH / self._view.scale)

    def _on_track(self, place: Point) -> bool:
        return 0 <= place[0] < HEIGHT and 0 <= place[1] < HEIGHT
