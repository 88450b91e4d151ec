"""Pictures of a kart on its track, for `render`, windows and videos."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from spikedeploy.envs.kart.scene import PLAIN, Colour, Floats, Scene, scene
from spikedeploy.envs.kart.track import RADIUS

_SIZE = (720, 720)  # of a picture [screen px]

KART: Colour = (76, 201, 240)
_NEXT: Colour = (255, 209, 102)
_PASSED: Colour = (52, 122, 98)
_HIT: Colour = (242, 114, 123)
_RAY = (76, 201, 240, 60)
_TYRE: Colour = (8, 10, 14)
_HELMET: Colour = (244, 247, 252)
_FINE = 8  # factor at which a kart is drawn, before it is rotated and downscaled


class _Place(Protocol):
    """Map from track to screen coordinates: a Scene, or a view that is drawn elsewhere."""

    @property
    def scale(self) -> float:
        """[screen px / px]."""

    def at(self, points: ArrayLike) -> Floats:
        """Screen points (…, 2) of points (…, 2) [px] of the track."""


def picture(env: Any, size: tuple[int, int] = _SIZE) -> NDArray[np.uint8]:  # noqa: ANN401
    """Image (H, W, 3) of the current state of a kart environment."""
    return _pixels(drawn(env, size))


def drawn(env: Any, size: tuple[int, int] = _SIZE) -> pygame.Surface:  # noqa: ANN401
    """A surface with the track, its gates, the LIDAR's rays and the kart."""
    place = scene(env.track, size)
    surface = place.ground.copy()
    draw_gates(surface, place, env.next_gate)
    _draw_scan(surface, place, env.pose, _ray_angles(env), env.scan, env.lidar.range)
    draw_kart(surface, place, _facing(env), KART)
    return surface


def _pixels(surface: pygame.Surface) -> NDArray[np.uint8]:
    """Pixels (H, W, 3) of a surface."""
    turned = pygame.surfarray.array3d(surface).swapaxes(0, 1)
    found: NDArray[np.uint8] = np.ascontiguousarray(turned, np.uint8)
    return found


def _facing(env: Any) -> tuple[float, float, float]:  # noqa: ANN401
    """Position and drawn heading; a kart without a heading points along its velocity."""
    x, y, heading = env.pose
    if not env.TURNS and np.hypot(*env.velocity) > 1.0:
        heading = np.arctan2(env.velocity[1], env.velocity[0])
    return x, y, heading


def _ray_angles(env: Any) -> Floats:  # noqa: ANN401
    """Current directions of the LIDAR's rays (R,) [rad]."""
    angles: Floats = np.asarray(env.lidar.angles, np.float64)
    return angles + env.pose[2] if env.TURNS else angles


def draw_gates(surface: pygame.Surface, place: Scene, next_gate: int) -> None:
    """Draw the gates, the next one highlighted; the finish is part of the ground."""
    width = max(2, round(4.0 * place.pen))
    for index, (a, b) in enumerate(place.at(place.track.gates)):
        if index == next_gate:
            _glow(surface, a, b, width)
        elif index < len(place.track.gates) - 1:
            colour = _PASSED if index < next_gate else PLAIN
            pygame.draw.aaline(surface, colour, tuple(a), tuple(b), width)


def _draw_scan(
    surface: pygame.Surface,
    place: Scene,
    pose: tuple[float, float, float],
    angles: Floats,
    distances: Floats,
    reach: float,
) -> None:
    """Draw the LIDAR's rays, with a dot where they hit a wall."""
    centre = np.array(pose[:2])
    ends = centre + distances[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    start, ends = place.at(centre), place.at(ends)
    veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
    for end in ends:
        pygame.draw.aaline(veil, _RAY, tuple(start), tuple(end))
    surface.blit(veil, (0, 0))
    for end in ends[distances < reach * 0.999]:
        pygame.draw.aacircle(surface, _HIT, tuple(end), max(2, round(4.0 * place.pen)))


def draw_kart(
    surface: pygame.Surface,
    place: _Place,
    pose: tuple[float, float, float],
    colour: Colour,
    alpha: int = 255,
) -> None:
    """Draw a kart from above, as large as its collision circle."""
    turn = round(-np.degrees(pose[2])) % 360
    sprite = _sprite(colour, max(7, round(2 * RADIUS * place.scale)), turn, alpha)
    surface.blit(sprite, sprite.get_rect(center=tuple(np.rint(place.at(pose[:2])).astype(int))))


def _glow(surface: pygame.Surface, a: Floats, b: Floats, width: int) -> None:
    """Draw a bright line in a translucent band of the same colour."""
    veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
    for factor, alpha in ((7, 22), (4, 44)):
        pygame.draw.line(veil, (*_NEXT, alpha), tuple(a), tuple(b), factor * width)
    surface.blit(veil, (0, 0))
    pygame.draw.aaline(surface, _NEXT, tuple(a), tuple(b), width + 1)


@lru_cache(maxsize=4096)
def _sprite(colour: Colour, size: int, turn: int, alpha: int) -> pygame.Surface:
    """A kart rotated by whole degrees."""
    scale = size / (2 * RADIUS * _FINE)
    sprite = pygame.transform.rotozoom(_large(colour), turn, scale)
    sprite.set_alpha(alpha)
    return sprite


@lru_cache(maxsize=64)
def _large(colour: Colour) -> pygame.Surface:
    """A kart facing right, at FINE times its true size."""
    side = round(2 * RADIUS * _FINE)
    surface = pygame.Surface((side, side), pygame.SRCALPHA)
    pygame.draw.aacircle(surface, (*colour, 56), (side / 2, side / 2), side / 2 - 1)

    def box(x: float, y: float, w: float, h: float, fill: Colour, radius: float = 1.5) -> None:
        corner = ((x + RADIUS) * _FINE, (y + RADIUS) * _FINE)
        shape = pygame.Rect(*corner, w * _FINE, h * _FINE)
        pygame.draw.rect(surface, fill, shape, border_radius=round(radius * _FINE))

    dark = (colour[0] * 5 // 9, colour[1] * 5 // 9, colour[2] * 5 // 9)
    for y in (-13.0, 8.5):
        box(-13.5, y, 9.0, 4.5, _TYRE)
        box(5.0, y + 0.5 if y < 0 else y, 7.5, 4.0, _TYRE)
    box(-10.5, -9.0, 3.0, 18.0, dark)  # rear axle
    box(7.5, -9.0, 2.5, 18.0, dark)  # front axle
    box(-15.0, -6.5, 24.0, 13.0, colour, 5.0)
    box(6.0, -3.5, 12.0, 7.0, colour, 3.0)
    pygame.draw.aacircle(surface, dark, (side / 2 - 2 * _FINE, side / 2), 5.4 * _FINE)
    pygame.draw.aacircle(surface, _HELMET, (side / 2 - 2 * _FINE, side / 2), 4.0 * _FINE)
    return surface
