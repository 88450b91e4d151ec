"""The panel beside a drive: speed, gates, LIDAR, rewards."""

from typing import Any

import numpy as np
import pygame

from spikedeploy.envs.foreign import AdaptedEnv
from spikedeploy.play.driving_network import MEAN, DrivingNetwork
from spikedeploy.play.env_picture import is_kart
from spikedeploy.play.session import Session
from spikedeploy.play.theme import (
    AMBER,
    CYAN,
    DIM,
    GREEN,
    LINE,
    PANEL,
    RED,
    TEXT,
    TRACK,
    bar,
    heading,
    keycaps,
    signed_bar,
    write,
)

WIDTH = 400
_PAD = 26
_TOPS = {"up": 4.0, "forward": 4.4, "accelerate": 5.99}  # action of one kind of kart -> [m/s]


def draw_drive_panel(
    surface: pygame.Surface, place: pygame.Rect, session: Session, title: str
) -> None:
    """Draw the panel of a session into a rectangle of a surface."""
    pygame.draw.rect(surface, PANEL, place)
    inner = place.inflate(-2 * _PAD, -2 * _PAD)
    write(surface, title, inner.topleft, 20, TEXT, "bold")
    write(surface, session.driver.name, (inner.left, inner.top + 28), 13, DIM)
    y = _speed(surface, inner, inner.top + 66, session)
    y = _times(surface, inner, y + 24, session)
    if is_kart(session.world):
        y = _gates(surface, inner, y + 24, session.world)
        y = _lidar(surface, inner, y + 24, session.world)
    if session.driver.network is not None:
        y = _network(surface, inner, y + 24, session.driver.network, session.period)
    _rewards(surface, inner, y + 24, session)
    legend = [*session.driver.legend, ("R", "restart"), ("P", "picture"), ("ESC", "leave")]
    keycaps(surface, legend, (inner.left, inner.bottom - 50), inner.width)


def _speed(surface: pygame.Surface, inner: pygame.Rect, y: int, session: Session) -> int:
    """A large number and a bar; a robot's command below it; nothing of worlds that are not ours."""
    if isinstance(session.world, AdaptedEnv):
        return y
    scale = 100.0 if is_kart(session.world) else 1.0  # of the world's unit in a metre
    speed = float(session.info.get("speed", 0.0)) / scale
    heading(surface, "speed", (inner.left, y))
    number = write(surface, f"{speed:.2f}", (inner.left, y + 14), 44, TEXT, "bold")
    write(surface, "m/s", (number.right + 8, number.bottom - 9), 15, DIM, anchor="bottomleft")
    top = next((_TOPS[a] for a in getattr(session.world, "ACTIONS", ()) if a in _TOPS), 0.5)
    bar(surface, pygame.Rect(inner.left, y + 72, inner.width, 8), abs(speed) / top)
    if "command_speed" not in session.info:
        return y + 80
    command = (
        f"{session.info['command_speed']:+.2f} m/s   {session.info['command_turn']:+.2f} rad/s"
    )
    write(surface, "commanded", (inner.left, y + 92), 13, DIM)
    write(surface, command, (inner.right, y + 92), 13, AMBER, "mono", "topright")
    return y + 110


def _times(surface: pygame.Surface, inner: pygame.Rect, y: int, session: Session) -> int:
    """The time of the episode, the last lap and the best, in three columns."""
    cells = [("time", session.seconds, TEXT), ("last lap", session.last, TEXT)]
    cells.append(("best lap", session.best, GREEN))
    if not is_kart(session.world):
        cells = cells[:1]
    for column, (name, seconds, colour) in enumerate(cells):
        x = inner.left + column * inner.width // 3
        heading(surface, name, (x, y))
        text = "–" if seconds is None else f"{seconds:.2f} s"
        write(surface, text, (x, y + 17), 19, colour if seconds else DIM, "bold")
    return y + 42


def _network(
    surface: pygame.Surface, inner: pygame.Rect, y: int, network: DrivingNetwork, period: float
) -> int:
    """Operations and energy of a control step, and how much of it the policy took."""
    share = network.seconds / period
    cells = [
        ("SOPs", "–" if network.sops is None else f"{network.sops:,.0f}"),
        ("energy", "–" if network.joules is None else f"{1e9 * network.joules:,.3g} nJ"),
        ("deadline use", f"{100 * share:.1f} %"),
    ]
    for column, (name, text) in enumerate(cells):
        x = inner.left + column * inner.width // 3
        heading(surface, name, (x, y))
        write(surface, text, (x, y + 17), 15, RED if "use" in name and share > 1 else TEXT, "bold")
    note = f"means of {MEAN} steps · energy by {network.table}"
    write(surface, note, (inner.left, y + 40), 12, DIM)
    return y + 54


def _gates(surface: pygame.Surface, inner: pygame.Rect, y: int, world: Any) -> int:  # noqa: ANN401
    """A mark for each gate: passed, next, to come."""
    count, passed = len(world.track.gates), int(world.next_gate)
    heading(surface, "gates", (inner.left, y))
    write(surface, f"{passed} / {count}", (inner.right, y - 3), 14, TEXT, "bold", "topright")
    gap = 6
    width = (inner.width - gap * (count - 1)) / count
    for gate in range(count):
        colour = GREEN if gate < passed else AMBER if gate == passed else TRACK
        pip = pygame.Rect(round(inner.left + gate * (width + gap)), y + 20, round(width), 8)
        pygame.draw.rect(surface, colour, pip, border_radius=4)
    return y + 28


def _lidar(surface: pygame.Surface, inner: pygame.Rect, y: int, world: Any) -> int:  # noqa: ANN401
    """The LIDAR scan in the frame of the kart: ahead is up."""
    radius = 78
    heading(surface, "lidar", (inner.left, y))
    write(surface, f"{world.lidar.range / 100:.1f} m", (inner.left, y + 18), 13, DIM)
    centre = np.array([inner.centerx, y + radius + 4])
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
        seen = reach < 0.999
        pygame.draw.aacircle(surface, RED if seen else LINE, tuple(point), 3 if seen else 2)
    pygame.draw.aacircle(surface, CYAN, tuple(centre), 5)
    return y + 2 * radius + 8


def _rewards(surface: pygame.Surface, inner: pygame.Rect, y: int, session: Session) -> int:
    """Every reward term: its sum over the episode, as bar and number."""
    heading(surface, "reward so far", (inner.left, y))
    total = sum(session.sums.values())
    write(surface, f"{total:+.2f}", (inner.right, y - 4), 16, TEXT, "bold", "topright")
    y += 24
    largest = max((abs(value) for value in session.sums.values()), default=0.0) or 1.0
    rows = max(1, (inner.bottom - 66 - y) // 21)
    for name, value in [*session.sums.items()][:rows]:
        write(surface, name.replace("_", " "), (inner.left, y), 13, DIM)
        place = pygame.Rect(inner.left + 130, y + 5, inner.width - 130 - 74, 6)
        signed_bar(surface, place, value / largest)
        write(surface, f"{value + 0.0:+.2f}", (inner.right, y), 13, TEXT, "mono", "topright")
        y += 21
    return y
