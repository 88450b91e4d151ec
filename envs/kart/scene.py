"""A track scaled to a surface: its coordinates on screen and its static background."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from spikedeploy.envs.kart.track import Track

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

    track    the track drawn
    size     (width, height) [screen px]
    scale    [screen px / px]
    pen      factor on the widths of lines and dots, at most 1
    ground   surface with walls and road; draw on a copy
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

    def at(self, points: ArrayLike) -> Floats:
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
        a, b = _FINE * self.at(self.track.gates[-1])
        thick_line(barriers, WALL, a, b, width)
        free = pygame.mask.from_threshold(barriers, (0, 0, 0), (1, 1, 1, 255))
        start = tuple(int(value) for value in _FINE * self.at(self.track.start))
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
        for a, b in _FINE * self.at(self.track.walls):
            thick_line(target, colour, a, b, width)
        if within is not None:
            within.to_surface(surface, setsurface=target, unsetcolor=None)

    def _checkers(self, surface: pygame.Surface) -> None:
        """Draw the finish as two rows of squares."""
        a, b = _FINE * self.at(self.track.gates[-1])
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


def thick_line(surface: pygame.Surface, colour: Any, a: Floats, b: Floats, width: int) -> None:  # noqa: ANN401
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


def scene(track: Track, size: tuple[int, int]) -> Scene:
    """The scene of a track, cached by what the track looks like."""
    return _scene(_TrackKey(track), size)


@lru_cache(maxsize=16)
def _scene(key: _TrackKey, size: tuple[int, int]) -> Scene:
    return Scene(key.track, size)


class _TrackKey:
    """A track as cache key: equal to another one with the same geometry."""

    def __init__(self, track: Track) -> None:
        self.track = track
        self._geometry = (track.walls.tobytes(), track.gates.tobytes(), track.start.tobytes())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _TrackKey) and self._geometry == other._geometry

    def __hash__(self) -> int:
        return hash(self._geometry)
