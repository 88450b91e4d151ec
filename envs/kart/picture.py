"""Pictures of a track and of karts on it."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from spikedeploy.envs.kart.track import RADIUS, Track

Floats = NDArray[np.float64]
Colour = tuple[int, int, int]

NIGHT: Colour = (15, 18, 25)  # around the track
_ROAD: Colour = (31, 37, 50)
_EDGE: Colour = (20, 24, 33)  # the road's shade along the walls
WALL: Colour = (214, 222, 236)
PLAIN: Colour = (64, 74, 96)  # gates that are still ahead
_MARGIN = 0.035  # of the surface's shorter side
_FINE = 2  # factor at which the ground is drawn, before it is downscaled

pygame.font.init()


class Scene:
    """A track scaled to fit a surface.

    track: the track drawn
    size: (width, height) [screen px]
    scale: [screen px / px]
    pen: factor on the widths of lines and dots, at most 1
    ground: surface with walls and road; draw on a copy
    """

    def __init__(self, track: Track, size: tuple[int, int]) -> None:
        self.track, self.size = track, size
        points = np.concatenate((track.walls, track.gates)).reshape(-1, 2)
        low, high = points.min(axis=0), points.max(axis=0)
        margin = _MARGIN * min(size) + 4
        inner = np.array(size) - 2 * margin
        self.scale = float((inner / np.maximum(high - low, 1.0)).min())
        self.pen = min(self.scale, 1.0)
        self._offset = np.array(size) / 2 - self.scale * (low + high) / 2
        self.ground = self._ground()

    def on_screen(self, points: ArrayLike) -> Floats:
        """Screen points (…, 2) of points (…, 2) [px] of the track."""
        found: Floats = np.asarray(points, np.float64) * self.scale + self._offset
        return found

    def _ground(self) -> pygame.Surface:
        """Draw road and walls, supersampled so that edges are smooth."""
        large = pygame.Surface((_FINE * self.size[0], _FINE * self.size[1]))
        large.fill(NIGHT)
        width = max(4, round(_FINE * 5.0 * self.pen))
        road = self._road(large.get_size(), width)
        if road is not None:
            large.blit(road.to_surface(setcolor=_ROAD, unsetcolor=NIGHT), (0, 0))
            self._lines(large, _EDGE, 5 * width, within=road)
        self._checkers(large)
        self._lines(large, WALL, width)
        return pygame.transform.smoothscale(large, self.size)

    def _road(self, size: tuple[int, int], width: int) -> pygame.Mask | None:
        """The area reachable from the start without crossing a wall or the finish.

        None where it is not bounded by an outer wall.
        """
        barriers = pygame.Surface(size)
        self._lines(barriers, WALL, width)
        a, b = _FINE * self.on_screen(self.track.gates[-1])
        _thick_line(barriers, WALL, a, b, width)
        free = pygame.mask.from_threshold(barriers, (0, 0, 0), (1, 1, 1, 255))
        start = tuple(int(value) for value in _FINE * self.on_screen(self.track.start))
        road = free.connected_component(start)
        return None if road.get_at((0, 0)) else road

    def _lines(
        self,
        surface: pygame.Surface,
        colour: Colour,
        width: int,
        within: pygame.Mask | None = None,
    ) -> None:
        """Draw every wall with round ends, clipped to the mask `within`."""
        target = surface if within is None else surface.copy()
        for a, b in _FINE * self.on_screen(self.track.walls):
            _thick_line(target, colour, a, b, width)
        if within is not None:
            within.to_surface(surface, setsurface=target, unsetcolor=None)

    def _checkers(self, surface: pygame.Surface) -> None:
        a, b = _FINE * self.on_screen(self.track.gates[-1])
        along = (b - a) / max(float(np.hypot(*(b - a))), 1.0)
        across = np.array([-along[1], along[0]])
        side = _FINE * max(5.0, 9.0 * self.pen)
        count = max(2, round(float(np.hypot(*(b - a))) / side))
        step = (b - a) / count
        for column in range(count):
            for row in (0, 1):
                corner = a + column * step + (row - 1) * side * across
                square = [corner, corner + step, corner + step + side * across]
                square.append(corner + side * across)
                colour = WALL if (column + row) % 2 else PLAIN
                pygame.draw.polygon(surface, colour, [tuple(point) for point in square])


def _thick_line(surface: pygame.Surface, colour: Any, a: Floats, b: Floats, width: int) -> None:  # noqa: ANN401
    """Draw a line with round ends, so that corners are closed."""
    pygame.draw.line(surface, colour, tuple(a), tuple(b), width)
    along = b - a
    length = float(np.hypot(*along))
    if length > 0:  # pygame ends thick lines along an axis; a quadrangle ends them at a right angle
        across = np.array([-along[1], along[0]]) / length * width / 2
        corners = (a + across, b + across, b - across, a - across)
        pygame.draw.polygon(surface, colour, [tuple(corner) for corner in corners])
    for end in (a, b):
        pygame.draw.circle(surface, colour, tuple(end), width / 2)


_scenes: dict[tuple[bytes, ...], Scene] = {}
_MOST_SCENES = 16


def scene(track: Track, size: tuple[int, int]) -> Scene:
    """The scene of a track, cached by what the track looks like."""
    looks = (track.walls, track.gates, track.start, np.array(size))
    key = tuple(part.tobytes() for part in looks)
    if key not in _scenes:
        if len(_scenes) >= _MOST_SCENES:
            del _scenes[next(iter(_scenes))]
        _scenes[key] = Scene(track, size)
    return _scenes[key]


_SIZE = (720, 720)  # of a picture [screen px]

KART: Colour = (76, 201, 240)
_NEXT: Colour = (255, 209, 102)
_PASSED: Colour = (52, 122, 98)
_HIT: Colour = (242, 114, 123)
_RAY = (76, 201, 240, 60)
_TYRE: Colour = (8, 10, 14)
_HELMET: Colour = (244, 247, 252)
_KART_FINE = 8  # factor at which a kart is drawn, before it is rotated and downscaled


def picture(env: Any, size: tuple[int, int] = _SIZE) -> NDArray[np.uint8]:  # noqa: ANN401
    """Image (H, W, 3) of the current state of a kart environment."""
    turned = pygame.surfarray.array3d(draw_env(env, size)).swapaxes(0, 1)
    return np.ascontiguousarray(turned, np.uint8)


def draw_env(env: Any, size: tuple[int, int] = _SIZE) -> pygame.Surface:  # noqa: ANN401
    """Return a surface with the track, its gates, the LIDAR's rays and the kart."""
    place = scene(env.track, size)
    surface = place.ground.copy()
    _draw_gates(surface, place, env.next_gate)
    _draw_scan(surface, place, env.pose, _ray_angles(env), env.scan, env.lidar.range)
    _draw_kart(surface, place, _facing(env), KART)
    return surface


def _facing(env: Any) -> tuple[float, float, float]:  # noqa: ANN401
    """Position and drawn heading; a kart without a heading points along its velocity."""
    x, y, heading = env.pose
    if not env.TURNS and np.hypot(*env.velocity) > 1.0:
        heading = np.arctan2(env.velocity[1], env.velocity[0])
    return x, y, heading


def _ray_angles(env: Any) -> Floats:  # noqa: ANN401
    angles: Floats = np.asarray(env.lidar.angles, np.float64)
    return angles + env.pose[2] if env.TURNS else angles


def _draw_gates(surface: pygame.Surface, place: Scene, next_gate: int) -> None:
    """Draw the gates, the next one highlighted; the finish is part of the ground."""
    width = max(2, round(4.0 * place.pen))
    for index, (a, b) in enumerate(place.on_screen(place.track.gates)):
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
    centre = np.array(pose[:2])
    ends = centre + distances[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    start, ends = place.on_screen(centre), place.on_screen(ends)
    veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
    for end in ends:
        pygame.draw.aaline(veil, _RAY, tuple(start), tuple(end))
    surface.blit(veil, (0, 0))
    for end in ends[distances < reach * 0.999]:
        pygame.draw.aacircle(surface, _HIT, tuple(end), max(2, round(4.0 * place.pen)))


def _draw_kart(
    surface: pygame.Surface,
    place: Scene,
    pose: tuple[float, float, float],
    colour: Colour,
    alpha: int = 255,
) -> None:
    """Draw a kart from above, as large as its collision circle."""
    turn = round(-np.degrees(pose[2])) % 360
    sprite = _sprite(colour, max(7, round(2 * RADIUS * place.scale)), turn, alpha)
    surface.blit(
        sprite, sprite.get_rect(center=tuple(np.rint(place.on_screen(pose[:2])).astype(int)))
    )


def _glow(surface: pygame.Surface, a: Floats, b: Floats, width: int) -> None:
    veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
    for factor, alpha in ((7, 22), (4, 44)):
        pygame.draw.line(veil, (*_NEXT, alpha), tuple(a), tuple(b), factor * width)
    surface.blit(veil, (0, 0))
    pygame.draw.aaline(surface, _NEXT, tuple(a), tuple(b), width + 1)


@lru_cache(maxsize=4096)
def _sprite(colour: Colour, size: int, turn: int, alpha: int) -> pygame.Surface:
    scale = size / (2 * RADIUS * _KART_FINE)
    sprite = pygame.transform.rotozoom(_large(colour), turn, scale)
    sprite.set_alpha(alpha)
    return sprite


@lru_cache(maxsize=64)
def _large(colour: Colour) -> pygame.Surface:
    """Draw a kart facing right, at FINE times its true size."""
    side = round(2 * RADIUS * _KART_FINE)
    surface = pygame.Surface((side, side), pygame.SRCALPHA)
    pygame.draw.aacircle(surface, (*colour, 56), (side / 2, side / 2), side / 2 - 1)

    def box(x: float, y: float, w: float, h: float, fill: Colour, radius: float = 1.5) -> None:
        corner = ((x + RADIUS) * _KART_FINE, (y + RADIUS) * _KART_FINE)
        shape = pygame.Rect(*corner, w * _KART_FINE, h * _KART_FINE)
        pygame.draw.rect(surface, fill, shape, border_radius=round(radius * _KART_FINE))

    dark = (colour[0] * 5 // 9, colour[1] * 5 // 9, colour[2] * 5 // 9)
    for y in (-13.0, 8.5):
        box(-13.5, y, 9.0, 4.5, _TYRE)
        box(5.0, y + 0.5 if y < 0 else y, 7.5, 4.0, _TYRE)
    box(-10.5, -9.0, 3.0, 18.0, dark)  # rear axle
    box(7.5, -9.0, 2.5, 18.0, dark)  # front axle
    box(-15.0, -6.5, 24.0, 13.0, colour, 5.0)
    box(6.0, -3.5, 12.0, 7.0, colour, 3.0)
    pygame.draw.aacircle(surface, dark, (side / 2 - 2 * _KART_FINE, side / 2), 5.4 * _KART_FINE)
    pygame.draw.aacircle(surface, _HELMET, (side / 2 - 2 * _KART_FINE, side / 2), 4.0 * _KART_FINE)
    return surface
