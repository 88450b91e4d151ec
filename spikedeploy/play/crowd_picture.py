"""A crowd of ghosts on their track."""

from functools import lru_cache

import numpy as np
import pygame

from envs.kart_picture import draw_kart
from envs.kart_scene import Scene
from spikedeploy.play.crowd import Crowd
from spikedeploy.play.theme import AMBER, CYAN, DIM, GREEN, RED, Colour, write

FEW = 40  # ghosts that are drawn as karts; more of them as dots; a larger crowd shows its ages
AGES: tuple[Colour, ...] = ((150, 96, 208), (112, 118, 230), (76, 160, 240), (76, 211, 220))


def draw_crowd(surface: pygame.Surface, place: Scene, crowd: Crowd, step: int) -> None:
    """Draw who drives, where others ended, and the leader with its trail, over a track."""
    poses = crowd.poses(step)
    points = place.at(poses[:, :2])
    for well, colour in ((False, RED), (True, GREEN)):
        _dots(surface, points[crowd.ended(step, well)], colour, 3, 120)
    colours = AGES if len(crowd.drives) > FEW else (CYAN,)
    ages = np.minimum(crowd.age * len(colours), len(colours) - 1).astype(int)
    driving = crowd.driving(step)
    for age, colour in enumerate(colours):
        these = np.flatnonzero(driving & (ages == age))
        if driving.sum() > FEW:
            _dots(surface, points[these], colour, max(3, round(9 * place.scale)), 120)
        else:
            for index in these:
                draw_kart(surface, place, _pose(poses[index]), colour, 150)
    _legend(surface, colours)
    if crowd.leader is not None:
        _trail(surface, place, crowd, step)
        draw_kart(surface, place, _pose(poses[crowd.leader]), AMBER)


def _legend(surface: pygame.Surface, driving: tuple[Colour, ...]) -> None:
    """What the colours mean, in the lower left corner."""
    x, y = 20.0, surface.get_height() - 18.0
    entries: list[tuple[str, tuple[Colour, ...]]] = [("leader", (AMBER,)), ("finished", (GREEN,))]
    name = "driving" if len(driving) == 1 else "driving, of early to late training"
    entries += [("crashed", (RED,)), (name, driving)]
    for text, colours in entries:
        for colour in colours:
            pygame.draw.aacircle(surface, colour, (x, y), 5)
            x += 14
        x = write(surface, text, (x - 2, y), 12, DIM, anchor="midleft").right + 20


def _trail(surface: pygame.Surface, place: Scene, crowd: Crowd, step: int) -> None:
    points = place.at(crowd.trail(step))
    if len(points) > 1:
        pygame.draw.aalines(surface, AMBER, False, [tuple(point) for point in points])


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
