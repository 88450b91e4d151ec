"""A replay as MP4 or GIF, drawn as in its window."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.files import replacing
from spikedeploy.outputs import mark
from spikedeploy.play.replay_app import ReplayApp
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.video import mp4

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
        return _gif(frames, path, fps)
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


def _gif(frames: Iterator[pygame.Surface], path: Path, fps: int) -> Path:
    from PIL import Image

    small = (pygame.transform.smoothscale_by(frame, _GIF_SCALE) for frame in frames)
    method = Image.Quantize.MAXCOVERAGE  # keeps the colours of small objects
    pictures = (Image.fromarray(np.ascontiguousarray(_pixels(frame))) for frame in small)
    images = (picture.quantize(method=method) for picture in pictures)
    with replacing(path) as part:
        next(images).save(
            part,
            format="GIF",
            save_all=True,
            append_images=images,
            duration=1000 // fps,
            loop=0,
            comment=mark("replay"),
        )
    return path
