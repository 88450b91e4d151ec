"""A replay as MP4 or GIF, drawn as in its window."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.outputs import mark
from spikedeploy.play.replay_app import ReplayApp
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.video import gif, mp4

_FPS = {".mp4": 30, ".gif": 20}  # frame times of a GIF are whole hundredths of a second
_GIF_SCALE = 0.6


def save_film(app: ReplayApp, path: Path, seconds: float) -> Path:
    """Write one round through the batches, at most so many seconds; return the path.

    .mp4  as large as the window, 30 frames per second
    .gif  smaller, 20 frames per second
    """
    if path.suffix not in _FPS:
        raise ConfigError(f"--video {path}: choose a name that ends in {' or '.join(_FPS)}")
    fps = _FPS[path.suffix]
    frames = islice(_frames(app, round(app.fps / fps)), max(1, round(seconds * fps)))
    if path.suffix == ".gif":
        small = (pygame.transform.smoothscale_by(frame, _GIF_SCALE) for frame in frames)
        gif(path, map(_pixels, small), 1 / fps, mark("replay"))
        return path
    with mp4(path, fps, mark("replay")) as write:
        for frame in frames:
            write(_pixels(frame))
    return path


def _frames(app: ReplayApp, every: int) -> Iterator[pygame.Surface]:
    while not app.playback.rounds:
        yield app.draw()
        for _ in range(every):
            app.tick()


def _pixels(frame: pygame.Surface) -> NDArray[np.uint8]:
    """(H, W, 3) of a surface."""
    found: NDArray[np.uint8] = pygame.surfarray.array3d(frame).swapaxes(0, 1)
    return found
