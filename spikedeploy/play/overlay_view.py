"""Several sources on one track, each in a colour of its own."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.play.ghost_picture import draw_group, draw_leader, one_colour
from spikedeploy.play.replay_source import Source
from spikedeploy.play.replay_views import Facts, GhostView
from spikedeploy.play.theme import Colour
from spikedeploy.runtime.errors import ConfigError

COLOURS: tuple[Colour, ...] = (  # of the sources, in order: far apart in hue
    (76, 201, 240),  # sky
    (255, 209, 102),  # sand
    (240, 128, 176),  # rose
    (112, 211, 150),  # mint
    (170, 145, 250),  # violet
    (244, 140, 70),  # apricot
)


class OverlayView:
    """A batch of each source, started together.

    views    of the sources
    length   control steps of the longest
    seed     of the first source's leader
    legend   name of a source -> its colour
    """

    def __init__(self, views: Mapping[str, GhostView]) -> None:
        self.views = views
        self._first = next(iter(views.values()))
        self.length = max(view.length for view in views.values())
        self.seed = self._first.seed
        self.legend: Mapping[str, Colour] = dict(zip(views, COLOURS, strict=False))

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """The first source's track with all ghosts, the leaders on top."""
        surface, place = self._first.ground(size), self._first.place(size)
        for name, view in self.views.items():
            draw_group(surface, place, view.group, step, one_colour(self.legend[name]))
        for name, view in reversed([*self.views.items()]):
            draw_leader(surface, place, view.group, step, self.legend[name])
        return surface

    def facts(self, step: int) -> Facts:
        """For each source its name, counts and leader."""
        facts: Facts = []
        for name, view in self.views.items():
            count = view.group.count(step)
            facts.append((name, ""))
            numbers = f"{count.driving:,} / {count.finished:,} / {count.crashed:,}"
            facts.append(("driving / finished / crashed", numbers))
            facts.append(("leader", view.leader_result()))
        return facts

    def observations(self) -> NDArray[np.float64]:
        """Observations of the first source's leader."""
        return self._first.observations()

    def action(self, step: int) -> int | None:
        """The discrete action of the first source's leader."""
        return self._first.action(step)


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """Distinct names of sources: the shortest ends of their paths that differ."""
    whole = [path.resolve().with_suffix("") if path.is_file() else path.resolve() for path in paths]
    repeated = next((path for n, path in enumerate(paths) if whole[n] in whole[:n]), None)
    if repeated is not None:
        raise ConfigError(f"{repeated} is named twice; lay each source over the others once")
    parts = [[part for part in path.parts if part != "ghosts"] for path in whole]
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-length:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in paths]


def check_same_world(sources: Sequence[Source], options: Mapping[str, Any]) -> None:
    """Refuse sources of different environments or tracks, and more sources than colours.

    Observations and rewards may differ.
    """
    if len(sources) > len(COLOURS):
        raise ConfigError(f"{len(sources)} sources: at most {len(COLOURS)} can be facts apart")
    first, *others = sources
    for other in others:
        ours, theirs = _world(first, options), _world(other, options)
        if ours != theirs:
            raise ConfigError(
                f"{other.name} was driven in {theirs}, {first.name} in {ours}: only sources of one "
                "environment and track can be shown together"
            )


def _world(source: Source, options: Mapping[str, Any]) -> str:
    """Environment and track of a source, in words."""
    short = envs.spec(source.env_id).short
    track = {"track": "big_S", **source.options, **options}["track"]
    place = Path(str(track))
    return f"{short} on {place.resolve() if place.suffix == '.json' else place}"
