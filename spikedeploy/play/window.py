"""Shows an app in a window: events in, frames out."""

import itertools
from pathlib import Path

import pygame

from spikedeploy.play.display import check_display, check_driver
from spikedeploy.play.theme import NIGHT
from spikedeploy.runtime.errors import ConfigError

_SCREENSHOTS = Path("screenshots")
MAX_TICKS = 25.0  # ticks between two frames
_MOUSE = (pygame.MOUSEMOTION, pygame.MOUSEBUTTONDOWN, pygame.MOUSEWHEEL)


class App:
    """An app that a window can show; it draws itself without one too.

    title   of the window
    name    for the names of screenshots
    fps     wanted frames per second
    """

    title: str
    name: str
    fps: float

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press or release."""

    def tick(self) -> None:
        """Advance by one frame."""

    def point(self, event: pygame.Event) -> None:
        """Handle a mouse move, click or wheel event; positions are those of the frame."""

    def draw(self) -> pygame.Surface:
        """The frame, always of the same size."""
        raise NotImplementedError


def show(app: App, screenshots: Path = _SCREENSHOTS) -> None:
    """Show the app until its window is closed or ESC is pressed; P takes a screenshot."""
    check_display()
    try:
        pygame.display.init()
        check_driver(pygame.display.get_driver())
        screen = pygame.display.set_mode(app.draw().get_size(), pygame.RESIZABLE)
    except pygame.error as error:
        raise ConfigError(
            f"no window can be opened here ({error}); `spikedeploy replay --video` and `run "
            "--video` need none"
        ) from error
    pygame.display.set_caption(app.title)
    clock, due, size = pygame.time.Clock(), 1.0, screen.get_size()
    try:
        while not _handle_events(app, screenshots, size):
            for _ in range(int(due)):
                app.tick()
            frame = app.draw()
            size = frame.get_size()
            _fit(screen, frame)
            pygame.display.flip()
            # where drawing is slow, more time passes between two frames
            due = min(due % 1 + clock.tick(app.fps) / 1000 * app.fps, MAX_TICKS)
    finally:
        pygame.display.quit()


def _handle_events(app: App, screenshots: Path, size: tuple[int, int]) -> bool:
    """Pass pending events to the app; return whether one of them closes the window."""
    for event in pygame.event.get():
        key = event.key if event.type == pygame.KEYDOWN else None
        if event.type == pygame.QUIT or key == pygame.K_ESCAPE:
            return True
        if key == pygame.K_p:
            screenshots.mkdir(parents=True, exist_ok=True)
            names = (screenshots / f"{app.name}-{number}.png" for number in itertools.count(1))
            pygame.image.save(app.draw(), next(name for name in names if not name.exists()))
        elif event.type in (pygame.KEYDOWN, pygame.KEYUP):
            app.handle(event)
        elif event.type in _MOUSE:
            app.point(_on_frame(event, size))
    return False


def _on_frame(event: pygame.Event, size: tuple[int, int]) -> pygame.Event:
    """A mouse event with its position in frame pixels; the frame may be scaled to the window."""
    screen = pygame.display.get_surface()
    if screen is None or not hasattr(event, "pos"):
        return event
    whole = screen.get_size()
    scale = min(whole[0] / size[0], whole[1] / size[1])
    pos = tuple((event.pos[k] - (whole[k] - scale * size[k]) / 2) / scale for k in (0, 1))
    return pygame.Event(event.type, {**event.dict, "pos": pos})


def _fit(screen: pygame.Surface, frame: pygame.Surface) -> None:
    """Draw the frame in the middle of the window, scaled to fit."""
    screen = pygame.display.get_surface() or screen
    if screen.get_size() != frame.get_size():
        width, height = frame.get_size()
        scale = min(screen.get_width() / width, screen.get_height() / height)
        frame = pygame.transform.smoothscale_by(frame, scale)
        screen.fill(NIGHT)
    screen.blit(frame, frame.get_rect(center=screen.get_rect().center))
