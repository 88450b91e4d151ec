"""Several sources over one another on one track: who is who, and whether they may be."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.play.ghost_picture import draw_crowd, draw_leader, one_colour
from spikedeploy.play.replay_source import Source
from spikedeploy.play.replay_views import Facts, GhostReel
from spikedeploy.play.theme import Colour
from spikedeploy.runtime.errors import ConfigError

COLOURS: tuple[Colour, ...] = (  # of the sources, in their order; far apart in hue, alike in weight
    (76, 201, 240),  # sky
    (255, 209, 102),  # sand
    (240, 128, 176),  # rose
    (112, 211, 150),  # mint
    (170, 145, 250),  # violet
    (244, 140, 70),  # apricot
)


class OverlayReel:
    """A batch of each source, all started together.

    reels    of the sources
    length   control steps of the longest
    seed     of the first source's leader
    legend   name of a source -> its colour
    """

    def __init__(self, reels: Mapping[str, GhostReel]) -> None:
        self.reels = reels
        self._first = next(iter(reels.values()))
        self.length = max(reel.length for reel in reels.values())
        self.seed = self._first.seed
        self.legend: Mapping[str, Colour] = dict(zip(reels, COLOURS, strict=False))

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """The first source's track with everybody on it, the leaders on top."""
        surface, place = self._first.ground(size), self._first.place(size)
        for name, reel in self.reels.items():
            draw_crowd(surface, place, reel.crowd, step, one_colour(self.legend[name]))
        for name, reel in reversed([*self.reels.items()]):
            draw_leader(surface, place, reel.crowd, step, self.legend[name])
        return surface

    def facts(self, step: int) -> Facts:
        """The name of each source, how many of it do what, and its best."""
        told: Facts = []
        for name, reel in self.reels.items():
            count = reel.crowd.count(step)
            told.append((name, ""))
            numbers = f"{count.driving:,} / {count.finished:,} / {count.crashed:,}"
            told.append(("driving / finished / crashed", numbers))
            told.append(("leader", reel.led()))
        return told

    def observations(self) -> NDArray[np.float64]:
        """What the first source's leader saw."""
        return self._first.observations()

    def action(self, step: int) -> int | None:
        """The choice that the first source's leader made there."""
        return self._first.action(step)


def distinct(paths: Sequence[Path]) -> list[str]:
    """Names of sources that tell them apart: the end of each path, as long as that needs."""
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


def check_alike(sources: Sequence[Source], options: Mapping[str, Any]) -> None:
    """Refuse sources of different worlds, and more of them than there are colours.

    What drivers saw and were paid may differ; where they drove may not.
    """
    if len(sources) > len(COLOURS):
        raise ConfigError(f"{len(sources)} sources: at most {len(COLOURS)} can be told apart")
    first, *others = sources
    for other in others:
        ours, theirs = _world(first, options), _world(other, options)
        if ours != theirs:
            raise ConfigError(
                f"{other.name} was driven in {theirs}, {first.name} in {ours}: only sources of one "
                "world can be laid over one another"
            )


def _world(source: Source, options: Mapping[str, Any]) -> str:
    """The kind of kart and the track of a source, for people."""
    short = envs.spec(source.env_id).short
    track = {"track": "big_S", **source.options, **options}["track"]
    place = Path(str(track))
    return f"{short} on {place.resolve() if place.suffix == '.json' else place}"
