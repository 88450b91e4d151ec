"""A group of ghosts on their track."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pygame

from spikedeploy.envs.kart.picture import Scene, draw_kart
from spikedeploy.play.ghost_group import GhostGroup
from spikedeploy.play.theme import AMBER, CYAN, DIM, GREEN, RED, Colour, write

_FEW = 40  # more ghosts than this are drawn as dots, coloured by age
_AGES: tuple[Colour, ...] = ((150, 96, 208), (112, 118, 230), (76, 160, 240), (76, 211, 220))


@dataclass(frozen=True)
class _GroupColours:
    """The colours of a group.

    driving   of moving ghosts, from the start to the end of the training
    leader    of the best ghost and its path
    finished  of dots at the ends of finished episodes
    crashed   of dots at the ends of crashed episodes
    """

    driving: tuple[Colour, ...]
    leader: Colour = AMBER
    finished: Colour = GREEN
    crashed: Colour = RED


def colours_by_age(group: GhostGroup) -> _GroupColours:
    """The colours of a single group: by outcome, and of many ghosts by age."""
    return _GroupColours(_AGES if len(group.drives) > _FEW else (CYAN,))


def one_colour(colour: Colour) -> _GroupColours:
    """The colours of a group among others."""
    return _GroupColours((colour,), colour, colour, colour)


def draw_group(
    surface: pygame.Surface, place: Scene, group: GhostGroup, step: int, colours: _GroupColours
) -> None:
    """Draw moving ghosts, and where the others ended, over a track."""
    poses = group.poses(step)
    points = place.at(poses[:, :2])
    for well, colour in ((False, colours.crashed), (True, colours.finished)):
        _dots(surface, points[group.ended(step, well)], colour, 3, 120)
    ages = np.minimum(group.age * len(colours.driving), len(colours.driving) - 1).astype(int)
    driving = group.driving(step)
    for age, colour in enumerate(colours.driving):
        these = np.flatnonzero(driving & (ages == age))
        if driving.sum() > _FEW:
            _dots(surface, points[these], colour, max(3, round(9 * place.scale)), 120)
        else:
            for index in these:
                draw_kart(surface, place, _pose(poses[index]), colour, 150)


def draw_leader(
    surface: pygame.Surface, place: Scene, group: GhostGroup, step: int, colour: Colour
) -> None:
    """Draw the best ghost and its path."""
    if group.leader is None:
        return
    points = place.at(group.trail(step))
    if len(points) > 1:
        pygame.draw.aalines(surface, colour, False, [tuple(point) for point in points])
    draw_kart(surface, place, _pose(group.poses(step)[group.leader]), colour)


def draw_legend(surface: pygame.Surface, colours: _GroupColours) -> None:
    """Draw a legend in the lower left corner."""
    x, y = 20.0, surface.get_height() - 18.0
    name = "driving" if len(colours.driving) == 1 else "driving, of early to late training"
    entries: list[tuple[str, tuple[Colour, ...]]] = [
        ("leader", (colours.leader,)),
        ("finished", (colours.finished,)),
        ("crashed", (colours.crashed,)),
        (name, colours.driving),
    ]
    for text, shades in entries:
        for colour in shades:
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
