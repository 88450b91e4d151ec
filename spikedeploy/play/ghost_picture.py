"""A crowd of ghosts on their track."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pygame

from spikedeploy.envs.kart.picture import draw_kart
from spikedeploy.envs.kart.scene import Scene
from spikedeploy.play.ghost_group import Crowd
from spikedeploy.play.theme import AMBER, CYAN, DIM, GREEN, RED, Colour, write

FEW = 40  # ghosts that are drawn as karts; more of them as dots; a larger crowd shows its ages
AGES: tuple[Colour, ...] = ((150, 96, 208), (112, 118, 230), (76, 160, 240), (76, 211, 220))


@dataclass(frozen=True)
class Paint:
    """The colours of a crowd.

    driving   of those who drive, from the first to the last of the training
    leader    of the best and of its path
    finished  of the dots where they ended
    crashed   of the dots where they ended
    """

    driving: tuple[Colour, ...]
    leader: Colour = AMBER
    finished: Colour = GREEN
    crashed: Colour = RED


def alone(crowd: Crowd) -> Paint:
    """The paint of the only crowd: by what happens to its ghosts, and of many by their age."""
    return Paint(AGES if len(crowd.drives) > FEW else (CYAN,))


def one_colour(colour: Colour) -> Paint:
    """The paint of a crowd among others."""
    return Paint((colour,), colour, colour, colour)


def draw_crowd(
    surface: pygame.Surface, place: Scene, crowd: Crowd, step: int, paint: Paint
) -> None:
    """Draw who drives and where others ended, over a track."""
    poses = crowd.poses(step)
    points = place.at(poses[:, :2])
    for well, colour in ((False, paint.crashed), (True, paint.finished)):
        _dots(surface, points[crowd.ended(step, well)], colour, 3, 120)
    ages = np.minimum(crowd.age * len(paint.driving), len(paint.driving) - 1).astype(int)
    driving = crowd.driving(step)
    for age, colour in enumerate(paint.driving):
        these = np.flatnonzero(driving & (ages == age))
        if driving.sum() > FEW:
            _dots(surface, points[these], colour, max(3, round(9 * place.scale)), 120)
        else:
            for index in these:
                draw_kart(surface, place, _pose(poses[index]), colour, 150)


def draw_leader(
    surface: pygame.Surface, place: Scene, crowd: Crowd, step: int, colour: Colour
) -> None:
    """Draw the best of a crowd and its path."""
    if crowd.leader is None:
        return
    points = place.at(crowd.trail(step))
    if len(points) > 1:
        pygame.draw.aalines(surface, colour, False, [tuple(point) for point in points])
    draw_kart(surface, place, _pose(crowd.poses(step)[crowd.leader]), colour)


def draw_legend(surface: pygame.Surface, paint: Paint) -> None:
    """What the colours mean, in the lower left corner."""
    x, y = 20.0, surface.get_height() - 18.0
    name = "driving" if len(paint.driving) == 1 else "driving, of early to late training"
    entries: list[tuple[str, tuple[Colour, ...]]] = [
        ("leader", (paint.leader,)),
        ("finished", (paint.finished,)),
        ("crashed", (paint.crashed,)),
        (name, paint.driving),
    ]
    for text, colours in entries:
        for colour in colours:
            pygame.draw.aacircle(surface, colour, (x, y), 5)
            x += 14
        x = write(surface, text, (x - 2, y), 12, DIM, anchor="midleft").right + 20


def _dots(
    surface: pygame.Surface, points: np.ndarray, colour: Colour, radius: int, alpha: int
) -> None:
    dot = _dot(colour, radius, alpha)
    corners = np.rint(points - radius - 1).astype(int).tolist()
    surface.blits([(dot, tuple(corner)) for corner in corners], doreturn=False)


@lru_cache(maxsize=32)
def _dot(colour: Colour, radius: int, alpha: int) -> pygame.Surface:
    dot = pygame.Surface((2 * radius + 2, 2 * radius + 2), pygame.SRCALPHA)
    pygame.draw.aacircle(dot, (*colour, alpha), (radius + 1, radius + 1), radius)
    return dot


def _pose(row: np.ndarray) -> tuple[float, float, float]:
    x, y, heading = row.tolist()
    return x, y, heading
