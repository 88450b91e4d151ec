"""The window of `spikedeploy play`: keys in, frames out, and numbers beside the picture.

The app draws itself as a surface, so that it can be tested, and filmed, without a window.
"""

from collections.abc import Iterator

import pygame

from spikedeploy import envs
from spikedeploy.envs.foreign import AdaptedEnv
from spikedeploy.play.display import check_display, check_driver
from spikedeploy.play.session import Session
from spikedeploy.runtime.errors import ConfigError

MAX_TICKS = 25.0  # ticks between two frames
_WIDTH, _HEIGHT = 320, 800  # of the panel
_NIGHT, _TEXT, _DIM = (15, 18, 25), (226, 232, 243), (134, 146, 168)
_GREEN, _RED = (95, 211, 141), (242, 114, 123)
_ROW = 24  # height of a line of the panel

pygame.font.init()


def show(app: "DriveApp") -> None:
    """Show the app until its window is closed or ESC is pressed."""
    check_display()
    try:
        pygame.display.init()
        check_driver(pygame.display.get_driver())
        screen = pygame.display.set_mode(app.draw().get_size(), pygame.RESIZABLE)
    except pygame.error as error:
        raise ConfigError(
            f"no window can be opened here ({error}); `spikedeploy run --video` needs none"
        ) from error
    pygame.display.set_caption(app.title)
    clock, due = pygame.time.Clock(), 1.0
    try:
        while not _handle_events(app):
            for _ in range(int(due)):
                app.tick()
            _fit(pygame.display.get_surface() or screen, app.draw())
            pygame.display.flip()
            # where drawing is slow, more time passes between two frames
            due = min(due % 1 + clock.tick(app.fps) / 1000 * app.fps, MAX_TICKS)
    finally:
        pygame.display.quit()


def _handle_events(app: "DriveApp") -> bool:
    """Pass pending events to the app; return whether one of them closes the window."""
    for event in pygame.event.get():
        key = event.key if event.type == pygame.KEYDOWN else None
        if event.type == pygame.QUIT or key == pygame.K_ESCAPE:
            return True
        if event.type in (pygame.KEYDOWN, pygame.KEYUP):
            app.handle(event)
    return False


def _fit(screen: pygame.Surface, frame: pygame.Surface) -> None:
    """Draw the frame in the middle of the window, scaled to fit."""
    if screen.get_size() != frame.get_size():
        width, height = frame.get_size()
        scale = min(screen.get_width() / width, screen.get_height() / height)
        frame = pygame.transform.smoothscale_by(frame, scale)
        screen.fill(_NIGHT)
    screen.blit(frame, frame.get_rect(center=screen.get_rect().center))


class DriveApp:
    """A session, its picture, and its numbers.

    name: name of the environment
    title: title of the window
    fps: wanted frames per second
    """

    def __init__(self, session: Session, env: str) -> None:
        self.session, self.name = session, envs.spec(env).short
        self.title = f"{self.name} – spikedeploy"
        self.fps = 1.0 / session.period
        track = getattr(session.world, "track", None)
        self._heading = f"{self.name}, {track.name}" if track else self.name
        self._size = (_HEIGHT, _HEIGHT) if track else (_HEIGHT * 4 // 3, _HEIGHT)

    def handle(self, event: pygame.Event) -> None:
        """Restart at R; any other key is passed to the driver."""
        if event.type == pygame.KEYDOWN and event.key == pygame.K_r:
            self.session.restart()
        else:
            self.session.driver.handle(event)

    def tick(self) -> None:
        """Take one control step."""
        self.session.tick()

    def draw(self) -> pygame.Surface:
        """Return the environment, the panel, and the outcome at the end of an episode."""
        session, (width, height) = self.session, self._size
        surface = pygame.Surface((width + _WIDTH, height))
        surface.fill(_NIGHT)
        seen = surface.blit(_picture(session, self._size), (0, 0))
        y = 24
        for label, value in self._rows():
            _write(surface, label, y, (width + 24, "left"), _DIM if value else _TEXT)
            _write(surface, value, y, (width + _WIDTH - 24, "right"), _TEXT)
            y += _ROW
        if session.waiting:
            _draw_outcome(surface, seen, session)
        return surface

    def _rows(self) -> Iterator[tuple[str, str]]:
        """Lines of the panel: a label, and its value."""
        session, driver = self.session, self.session.driver
        world, info = session.world, session.info
        yield self._heading, ""
        yield driver.name, ""
        if "speed" in info and not isinstance(world, AdaptedEnv):
            speed = float(info["speed"]) / (100 if hasattr(world, "track") else 1)
            yield "speed", f"{speed:.2f} m/s"
        if "command_speed" in info:
            yield (
                "commanded",
                f"{info['command_speed']:+.2f} m/s  {info['command_turn']:+.2f} rad/s",
            )
        yield "time", f"{session.episode.steps * session.period:.2f} s"
        if laps := [each.seconds for each in session.outcomes if each.seconds is not None]:
            yield "last, best lap", f"{laps[-1]:.2f} s, {min(laps):.2f} s"
        if hasattr(world, "track"):
            yield "gates", f"{int(world.next_gate)} / {len(world.track.gates)}"
        yield "return", f"{sum(session.sums.values()):+.2f}"
        for name, value in session.sums.items():
            yield f"   {name.replace('_', ' ')}", f"{value:+.2f}"
        yield "", ""
        yield from [*driver.legend, ("R", "restart"), ("ESC", "leave")]


def _write(
    surface: pygame.Surface,
    text: str,
    y: int,
    x: tuple[int, str],
    colour: tuple[int, int, int],
    size: int = 22,
) -> None:
    """Write a line with its middle at y, and an edge, or its centre, at x."""
    drawn = pygame.font.Font(None, size).render(text, True, colour)
    place = drawn.get_rect(centery=y)
    setattr(place, x[1], x[0])
    surface.blit(drawn, place)


def _draw_outcome(surface: pygame.Surface, picture: pygame.Rect, session: Session) -> None:
    """Draw the end of an episode over the middle of the picture."""
    outcome = session.outcomes[-1]
    lap = "" if outcome.seconds is None else f"  {outcome.seconds:.2f} s"
    box = pygame.Rect(0, 0, 280, 72)
    box.center = picture.center
    colour = _GREEN if outcome.good else _RED
    pygame.draw.rect(surface, _NIGHT, box, border_radius=14)
    pygame.draw.rect(surface, colour, box, 2, border_radius=14)
    _write(surface, outcome.word + lap, box.centery, (box.centerx, "centerx"), colour, 36)


def _picture(session: Session, size: tuple[int, int]) -> pygame.Surface:
    """Return what the environment renders, scaled to the size."""
    seen = pygame.surfarray.make_surface(session.world.render().swapaxes(0, 1))
    scale = min(size[0] / seen.get_width(), size[1] / seen.get_height())
    surface = pygame.Surface(size)
    surface.fill(_NIGHT)
    seen = pygame.transform.smoothscale_by(seen, scale)
    surface.blit(seen, seen.get_rect(center=surface.get_rect().center))
    return surface
