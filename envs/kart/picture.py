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

_NIGHT: Colour = (15, 18, 25)  # around the track
_ROAD: Colour = (31, 37, 50)
_EDGE: Colour = (20, 24, 33)  # the road's shade along the walls
_WALL: Colour = (214, 222, 236)
_PLAIN: Colour = (64, 74, 96)  # gates that are still ahead
_MARGIN = 0.035  # of the surface's shorter side
_FINE = 2  # factor at which the ground is drawn, before it is downscaled

pygame.font.init()


class TrackPicture:
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
        large.fill(_NIGHT)
        width = max(4, round(_FINE * 5.0 * self.pen))
        road = self._road(large.get_size(), width)
        if road is not None:
            large.blit(road.to_surface(setcolor=_ROAD, unsetcolor=_NIGHT), (0, 0))
            self._lines(large, _EDGE, 5 * width, within=road)
        self._checkers(large)
        self._lines(large, _WALL, width)
        return pygame.transform.smoothscale(large, self.size)

    def _road(self, size: tuple[int, int], width: int) -> pygame.Mask | None:
        """The area reachable from the start without crossing a wall or the finish.

        None where it is not bounded by an outer wall.
        """
        barriers = pygame.Surface(size)
        self._lines(barriers, _WALL, width)
        a, b = _FINE * self.on_screen(self.track.gates[-1])
        _thick_line(barriers, _WALL, a, b, width)
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
                colour = _WALL if (column + row) % 2 else _PLAIN
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


_pictures: dict[tuple[bytes, ...], TrackPicture] = {}
_MOST_PICTURES = 16


def picture_of(track: Track, size: tuple[int, int]) -> TrackPicture:
    """The picture of a track, cached by what the track looks like."""
    looks = (track.walls, track.gates, track.start, np.array(size))
    key = tuple(part.tobytes() for part in looks)
    if key not in _pictures:
        if len(_pictures) >= _MOST_PICTURES:
            del _pictures[next(iter(_pictures))]
        _pictures[key] = TrackPicture(track, size)
    return _pictures[key]


_SIZE = (720, 720)  # of a picture [screen px]

_KART: Colour = (76, 201, 240)
_KART_DARK: Colour = (42, 111, 133)
_NEXT: Colour = (255, 209, 102)
_PASSED: Colour = (52, 122, 98)
_HIT: Colour = (242, 114, 123)
_RAY = (76, 201, 240, 60)
_TYRE: Colour = (8, 10, 14)
_HELMET: Colour = (244, 247, 252)
_KART_FINE = 8  # factor at which a kart is drawn, before it is rotated and downscaled


def picture(env: Any) -> NDArray[np.uint8]:  # noqa: ANN401
    """Image (H, W, 3) of a kart environment: the track, gates, the LIDAR's rays and the kart."""
    place = picture_of(env.track, _SIZE)
    surface = place.ground.copy()
    _draw_gates(surface, place, env.next_gate)
    _draw_scan(surface, place, env.pose, _ray_angles(env), env.scan, env.lidar.range)
    turn = round(-np.degrees(_heading(env))) % 360
    sprite = _sprite(max(7, round(2 * RADIUS * place.scale)), turn)
    centre = np.rint(place.on_screen(env.pose[:2])).astype(int)
    surface.blit(sprite, sprite.get_rect(center=tuple(centre)))
    return np.ascontiguousarray(pygame.surfarray.array3d(surface).swapaxes(0, 1), np.uint8)


def _heading(env: Any) -> float:  # noqa: ANN401
    """Drawn heading [rad]; a kart without one points along its velocity."""
    if not env.TURNS and np.hypot(*env.velocity) > 1.0:
        return float(np.arctan2(env.velocity[1], env.velocity[0]))
    return float(env.pose[2])


def _ray_angles(env: Any) -> Floats:  # noqa: ANN401
    angles: Floats = np.asarray(env.lidar.angles, np.float64)
    return angles + env.pose[2] if env.TURNS else angles


def _draw_gates(surface: pygame.Surface, place: TrackPicture, next_gate: int) -> None:
    """Draw the gates, the next one highlighted; the finish is part of the ground."""
    width = max(2, round(4.0 * place.pen))
    for index, (a, b) in enumerate(place.on_screen(place.track.gates)):
        if index == next_gate:
            _glow(surface, a, b, width)
        elif index < len(place.track.gates) - 1:
            colour = _PASSED if index < next_gate else _PLAIN
            pygame.draw.aaline(surface, colour, tuple(a), tuple(b), width)


def _draw_scan(
    surface: pygame.Surface,
    place: TrackPicture,
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


def _glow(surface: pygame.Surface, a: Floats, b: Floats, width: int) -> None:
    veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
    for factor, alpha in ((7, 22), (4, 44)):
        pygame.draw.line(veil, (*_NEXT, alpha), tuple(a), tuple(b), factor * width)
    surface.blit(veil, (0, 0))
    pygame.draw.aaline(surface, _NEXT, tuple(a), tuple(b), width + 1)


@lru_cache(maxsize=4096)
def _sprite(size: int, turn: int) -> pygame.Surface:
    """A kart from above, as large as its collision circle."""
    return pygame.transform.rotozoom(_large_kart(), turn, size / (2 * RADIUS * _KART_FINE))


@lru_cache(maxsize=1)
def _large_kart() -> pygame.Surface:
    """Draw a kart facing right, at FINE times its true size."""
    side = round(2 * RADIUS * _KART_FINE)
    surface = pygame.Surface((side, side), pygame.SRCALPHA)
    pygame.draw.aacircle(surface, (*_KART, 56), (side / 2, side / 2), side / 2 - 1)

    def box(x: float, y: float, w: float, h: float, fill: Colour, radius: float = 1.5) -> None:
        corner = ((x + RADIUS) * _KART_FINE, (y + RADIUS) * _KART_FINE)
        shape = pygame.Rect(*corner, w * _KART_FINE, h * _KART_FINE)
        pygame.draw.rect(surface, fill, shape, border_radius=round(radius * _KART_FINE))

    for y in (-13.0, 8.5):
        box(-13.5, y, 9.0, 4.5, _TYRE)
        box(5.0, y + 0.5 if y < 0 else y, 7.5, 4.0, _TYRE)
    box(-10.5, -9.0, 3.0, 18.0, _KART_DARK)  # rear axle
    box(7.5, -9.0, 2.5, 18.0, _KART_DARK)  # front axle
    box(-15.0, -6.5, 24.0, 13.0, _KART, 5.0)
    box(6.0, -3.5, 12.0, 7.0, _KART, 3.0)
    pygame.draw.aacircle(
        surface, _KART_DARK, (side / 2 - 2 * _KART_FINE, side / 2), 5.4 * _KART_FINE
    )
    pygame.draw.aacircle(surface, _HELMET, (side / 2 - 2 * _KART_FINE, side / 2), 4.0 * _KART_FINE)
    return surface
