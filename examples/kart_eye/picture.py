"""Pictures of a kart with an event camera: its view, what the camera sends, and the map."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from examples.kart_eye.batch import RADIUS, EyeBatch
from examples.kart_eye.course import GATE_AT, HALF, Course, to_world
from examples.kart_eye.signs import WIDTH
from examples.kart_eye.view import View

Colour = tuple[int, int, int]
Points = NDArray[np.float64]

SIZE = (960, 720)  # of a picture [screen px]
_VIEW = (480, 960)  # rows and columns of the view above
_NIGHT: Colour = (15, 18, 25)
_ROAD: Colour = (44, 53, 72)
_AHEAD: Colour = (36, 42, 57)
_EDGE: Colour = (118, 130, 154)
_TRAIL: Colour = (76, 201, 240)
_SIGN: Colour = (255, 209, 102)
_TEXT: Colour = (148, 158, 178)
_ON, _OFF = np.array((255, 176, 60)), np.array((64, 156, 255))  # events
_SHADES = np.array([(9, 11, 17), (60, 70, 92), (138, 149, 170), (236, 240, 247)], np.float64)
_DARK, _BRIGHT = -1.6, 1.3  # log luminance of the first and the last shade
_SCALE = 21.0  # of the map [screen px / m]

pygame.font.init()


def picture(env: Any) -> NDArray[np.uint8]:  # noqa: ANN401
    """Image (720, 960, 3): the view above, events and the map below."""
    image = np.empty((SIZE[1], SIZE[0], 3), np.uint8)
    rows = _VIEW[0]
    image[:rows] = shaded(env.batch.look(_camera(), np.array([0]))[0])
    middle, low = SIZE[0] // 2, SIZE[1] - rows
    image[rows:, :middle] = _scaled(event_colours(env.recent), (low, middle))
    image[rows:, middle:] = _map(env.batch, env.trail, (middle, low))
    image[rows : rows + 2] = image[rows:, middle - 1 : middle + 1] = _NIGHT
    return image


@cache
def _camera() -> View:
    return View(_VIEW)


def shaded(seen: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colours (rows, columns, 3) of log luminance (rows, columns)."""
    place = (np.clip(seen, _DARK, _BRIGHT) - _DARK) / (_BRIGHT - _DARK) * (len(_SHADES) - 1)
    first = np.minimum(place.astype(np.int64), len(_SHADES) - 2)
    share = (place - first)[..., None]
    mixed: NDArray[np.float64] = _SHADES[first] * (1 - share) + _SHADES[first + 1] * share
    return mixed.astype(np.uint8)


def event_colours(recent: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colours (rows, columns, 3) of fading numbers (2, rows, columns) of events, on and off."""
    on, off = 1 - np.exp(-recent[..., None])
    mixed: NDArray[np.float64] = (
        np.array(_NIGHT) * (1 - on) * (1 - off) + on * _ON + (1 - on) * off * _OFF
    )
    return mixed.clip(0, 255).astype(np.uint8)


def _scaled(image: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Nearest pixels."""
    rows, columns = (np.arange(n) * old // n for n, old in zip(shape, image.shape, strict=False))
    found: NDArray[np.uint8] = image[rows[:, None], columns]
    return found


def _map(
    batch: EyeBatch, trail: list[tuple[float, float]], size: tuple[int, int]
) -> NDArray[np.uint8]:
    """The corridors behind and the fork ahead, the direction of the corridor up."""
    surface = pygame.Surface(size)
    surface.fill(_NIGHT)
    course, k = batch.courses[0], min(int(batch.fork[0]), batch.options.forks - 1)
    heading = float(batch.heading[0])
    turn = np.array([[np.sin(heading), -np.cos(heading)], [-np.cos(heading), -np.sin(heading)]])
    here = np.array([batch.x[0], batch.y[0]])
    middle = np.array([size[0] / 2, 0.68 * size[1]])

    def at(points: Points) -> list[tuple[float, float]]:
        found = (np.asarray(points) - here) @ turn.T * _SCALE + middle
        return [(float(x), float(y)) for x, y in found]

    shown = [_corridor(course, each) for each in range(max(0, k - 2), k + 1)]
    for corners in [*shown, _arms(course, k)]:
        pygame.draw.polygon(surface, _EDGE, at(corners), 5)
    for corners in [*shown[:-1], _arms(course, k), shown[-1]]:
        pygame.draw.polygon(surface, _AHEAD if corners is not shown[-1] else _ROAD, at(corners))
    for place in course.sign[k, :, :2]:
        ends = to_world(course, k, place + np.array([[-WIDTH / 2, 0], [WIDTH / 2, 0]]))
        pygame.draw.lines(surface, _SIGN, False, at(ends), 3)
    if batch.closed[0]:
        bar = to_world(course, k, np.array([[-HALF, GATE_AT], [HALF, GATE_AT]]))
        pygame.draw.lines(surface, (240, 90, 100), False, at(bar), 3)
    if len(trail) > 1:
        pygame.draw.aalines(surface, _TRAIL, False, at(np.array(trail)))
    _draw_kart(surface, (float(middle[0]), float(middle[1])))
    words = {"letters": "a word: right · mirrored: left", "chevrons": "follow the chevrons"}
    text = _font().render(words[batch.options.signs], True, _TEXT)
    surface.blit(text, text.get_rect(midbottom=(size[0] / 2, size[1] - 8)))
    drawn: NDArray[np.uint8] = pygame.surfarray.array3d(surface).swapaxes(0, 1)
    return drawn


def _corridor(course: Course, k: int) -> Points:
    """Corners of corridor k, with the fork behind it."""
    x, start, end = HALF, -HALF, course.length[k] + HALF
    return to_world(course, k, np.array([[-x, start], [x, start], [x, end], [-x, end]]))


def _arms(course: Course, k: int) -> Points:
    """Corners of both arms of fork k."""
    x, y = course.length[k + 1] + HALF, course.length[k]
    return to_world(
        course, k, np.array([[-x, y - HALF], [x, y - HALF], [x, y + HALF], [-x, y + HALF]])
    )


def _draw_kart(surface: pygame.Surface, place: tuple[float, float]) -> None:
    """The kart and its field of view, pointing up."""
    x, y = place
    veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
    reach = 2.2 * _SCALE
    pygame.draw.polygon(
        veil, (*_TRAIL, 46), [(x, y), (x - reach, y - reach), (x + reach, y - reach)]
    )
    surface.blit(veil, (0, 0))
    size = RADIUS * _SCALE
    body = [
        (x, y - 1.5 * size),
        (x + size, y + 1.2 * size),
        (x, y + 0.6 * size),
        (x - size, y + 1.2 * size),
    ]
    pygame.draw.polygon(surface, _TRAIL, body)
    pygame.draw.aalines(surface, (236, 240, 247), True, body)


@cache
def _font() -> pygame.font.Font:
    return pygame.font.Font(None, 20)
