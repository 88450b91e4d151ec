"""The window of `spikedeploy play`: keys in, frames out, and its panel.

The app draws itself as a surface, so that it can be tested, and filmed, without a window.
"""

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pygame

from spikedeploy import envs
from spikedeploy.envs.foreign import AdaptedEnv
from spikedeploy.play.display import check_display, check_driver
from spikedeploy.play.panel import (
    AMBER,
    CYAN,
    DIM,
    GREEN,
    HEIGHT,
    LINE,
    NIGHT,
    RED,
    TEXT,
    TRACK,
    Panel,
    banner,
    signed_bar,
    write,
)
from spikedeploy.play.session import MEAN, Session
from spikedeploy.play.spikes import WIDTH as SPIKES_WIDTH
from spikedeploy.play.spikes import draw_inferences
from spikedeploy.runtime.errors import ConfigError

_SCREENSHOTS = Path("screenshots")
MAX_TICKS = 25.0  # ticks between two frames
_WIDTH = 400  # of the panel


def show(app: "DriveApp", screenshots: Path = _SCREENSHOTS) -> None:
    """Show the app until its window is closed or ESC is pressed; P takes a screenshot."""
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
        while not _handle_events(app, screenshots):
            for _ in range(int(due)):
                app.tick()
            _fit(pygame.display.get_surface() or screen, app.draw())
            pygame.display.flip()
            # where drawing is slow, more time passes between two frames
            due = min(due % 1 + clock.tick(app.fps) / 1000 * app.fps, MAX_TICKS)
    finally:
        pygame.display.quit()


def _handle_events(app: "DriveApp", screenshots: Path) -> bool:
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
    return False


def _fit(screen: pygame.Surface, frame: pygame.Surface) -> None:
    """Draw the frame in the middle of the window, scaled to fit."""
    if screen.get_size() != frame.get_size():
        width, height = frame.get_size()
        scale = min(screen.get_width() / width, screen.get_height() / height)
        frame = pygame.transform.smoothscale_by(frame, scale)
        screen.fill(NIGHT)
    screen.blit(frame, frame.get_rect(center=screen.get_rect().center))


class DriveApp:
    """A session and its panel.

    name: name of the environment
    title: title of the window
    fps: wanted frames per second
    """

    def __init__(self, session: Session, env: str) -> None:
        self.session, self.name = session, envs.spec(env).short
        self.title = f"{self.name} – spikedeploy"
        self.fps = 1.0 / session.period
        track = getattr(session.world, "track", None)
        self._heading = f"{self.name} · {track.name}" if track else self.name
        self._size = (HEIGHT, HEIGHT) if track else (HEIGHT * 4 // 3, HEIGHT)

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
        """Return the environment, the panel, and a banner at the end of an episode."""
        session, driver, (width, height) = self.session, self.session.driver, self._size
        spikes = SPIKES_WIDTH if driver.meter else 0
        surface = pygame.Surface((width + spikes + _WIDTH, height))
        seen = surface.blit(_picture(session, self._size), (0, 0))
        if driver.meter:
            place = pygame.Rect(width, 0, spikes, height)
            actions = getattr(session.world, "ACTIONS", ())
            draw_inferences(surface, place, driver.name, driver.meter.trace, actions)
        keys = [*driver.legend, ("R", "restart"), ("P", "picture"), ("ESC", "leave")]
        place = pygame.Rect(width + spikes, 0, _WIDTH, height)
        _draw_sections(Panel(surface, place, self._heading, driver.name, keys), session)
        if session.waiting:
            outcome = session.outcomes[-1]
            lap = "" if outcome.seconds is None else f"  {outcome.seconds:.2f} s"
            banner(surface, seen, outcome.word + lap, GREEN if outcome.good else RED)
        return surface


def _picture(session: Session, size: tuple[int, int]) -> pygame.Surface:
    """Return a kart's track with those beside it, or what another environment renders."""
    if hasattr(session.world, "track"):
        from spikedeploy.envs.kart.picture import draw_env

        poses = [path[min(session.episode.steps, len(path) - 1)] for path in session.others]
        return draw_env(session.world, size, poses)
    seen = pygame.surfarray.make_surface(session.world.render().swapaxes(0, 1))
    scale = min(size[0] / seen.get_width(), size[1] / seen.get_height())
    surface = pygame.Surface(size)
    surface.fill(NIGHT)
    seen = pygame.transform.smoothscale_by(seen, scale)
    surface.blit(seen, seen.get_rect(center=surface.get_rect().center))
    return surface


# sections of the panel

_TOPS = {
    "up": 4.0,
    "forward": 4.4,
    "accelerate": 5.99,
    "straight": 3.0,
}  # action of one kind of kart -> [m/s]


def _is_kart(world: Any) -> bool:  # noqa: ANN401
    return hasattr(world, "track")


def _draw_sections(panel: Panel, session: Session) -> None:
    world, meter = session.world, session.driver.meter
    if not isinstance(world, AdaptedEnv):
        _draw_speed(panel, session)
    panel.y += 24
    seconds = session.episode.steps * session.period
    cells = [("time", f"{seconds:.2f} s", TEXT if seconds else DIM)]
    if _is_kart(world):
        laps = [each.seconds for each in session.outcomes if each.seconds is not None]
        last, best = (f"{laps[-1]:.2f} s", f"{min(laps):.2f} s") if laps else ("–", "–")
        cells.append(("last lap", last, TEXT if laps else DIM))
        cells.append(("best lap", best, GREEN if laps else DIM))
    panel.columns(cells, 19)
    panel.y += 66
    if _is_kart(world):
        _draw_gates(panel, len(world.track.gates), int(world.next_gate))
        _draw_lidar(panel, world)
    if meter is not None:
        share = meter.seconds / session.period
        sops, joules = meter.costs or (None, None)
        cells = [
            ("SOPs", "–" if sops is None else f"{sops:,.0f}", TEXT),
            ("energy", "–" if joules is None else f"{1e9 * joules:,.3g} nJ", TEXT),
            ("deadline use", f"{100 * share:.1f} %", RED if share > 1 else TEXT),
        ]
        panel.columns(cells, 15)
        panel.text(f"means of {MEAN} steps · energy by {meter.table}", 40, 12)
        panel.y += 78
    _draw_rewards(panel, session.sums)


def _draw_speed(panel: Panel, session: Session) -> None:
    """Draw a large number and a bar; a robot's command below it."""
    scale = 100.0 if _is_kart(session.world) else 1.0  # of the world's unit in a metre
    speed = float(session.info.get("speed", 0.0)) / scale
    panel.title("speed")
    number = panel.text(f"{speed:.2f}", 14, 44, TEXT, "bold")
    unit = number.right + 8, number.bottom - 9
    write(panel.surface, "m/s", unit, 15, DIM, anchor="bottomleft")
    top = next((_TOPS[a] for a in getattr(session.world, "ACTIONS", ()) if a in _TOPS), 0.5)
    panel.bar(abs(speed) / top, 72, 8)
    panel.y += 80
    if "command_speed" in session.info:
        speed, turn = (session.info[f"command_{name}"] for name in ("speed", "turn"))
        panel.text("commanded", 12, 13)
        panel.value(f"{speed:+.2f} m/s   {turn:+.2f} rad/s", 12, 13, AMBER, "mono")
        panel.y += 30


def _draw_gates(panel: Panel, count: int, passed: int) -> None:
    """Draw a mark for each gate: passed, next, to come."""
    panel.title("gates")
    panel.value(f"{passed} / {count}", -3, 14, TEXT, "bold")
    gap = 6
    width = (panel.inner.width - gap * (count - 1)) / count
    for gate in range(count):
        colour = GREEN if gate < passed else AMBER if gate == passed else TRACK
        left = round(panel.inner.left + gate * (width + gap))
        mark = pygame.Rect(left, panel.y + 20, round(width), 8)
        pygame.draw.rect(panel.surface, colour, mark, border_radius=4)
    panel.y += 52


def _draw_lidar(panel: Panel, world: Any) -> None:  # noqa: ANN401
    """Draw the LIDAR scan in the frame of the kart: ahead is up."""
    surface, radius = panel.surface, 78
    panel.title("lidar")
    panel.text(f"{world.lidar.range / 100:.1f} m", 18, 13)
    centre = np.array([panel.inner.centerx, panel.y + radius + 4])
    for share in (1.0, 2 / 3, 1 / 3):
        pygame.draw.aacircle(surface, LINE, tuple(centre), radius * share, 1)
    turned = np.asarray(world.lidar.angles) - np.pi / 2 * world.TURNS
    share = np.asarray(world.scan) / world.lidar.range
    points = centre + radius * share[:, None] * np.stack((np.cos(turned), np.sin(turned)), axis=1)
    seen_area = [tuple(point) for point in (centre, *points)]
    if world.lidar.options.field >= 2 * np.pi:
        seen_area.pop(0)
    if len(seen_area) > 2:
        veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
        pygame.draw.polygon(veil, (*CYAN, 40), seen_area)
        surface.blit(veil, (0, 0))
    for point, reach in zip(points, share, strict=True):
        colour, size = (RED, 3) if reach < 0.999 else (LINE, 2)
        pygame.draw.aacircle(surface, colour, tuple(point), size)
    pygame.draw.aacircle(surface, CYAN, tuple(centre), 5)
    panel.y += 2 * radius + 32


def _draw_rewards(panel: Panel, sums: Mapping[str, float]) -> None:
    """Draw every reward term: its sum over the episode, as bar and number."""
    panel.title("reward so far")
    panel.value(f"{sum(sums.values()):+.2f}", -4, 16, TEXT, "bold")
    panel.y += 24
    inner, largest = panel.inner, max((abs(value) for value in sums.values()), default=0.0) or 1.0
    rows = max(1, (inner.bottom - 66 - panel.y) // 21)
    for name, value in [*sums.items()][:rows]:
        panel.text(name.replace("_", " "), 0, 13)
        place = pygame.Rect(inner.left + 130, panel.y + 5, inner.width - 130 - 74, 6)
        signed_bar(panel.surface, place, value / largest)
        panel.value(f"{value + 0.0:+.2f}", 0, 13, TEXT, "mono")
        panel.y += 21
