"""Films of a training: a greedy episode of the best checkpoint so far, evenly over its steps."""

import random
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.wrappers import TimeLimit

from spikedeploy.console import say
from spikedeploy.envs.rollout import EpisodeRecorder, rollout
from spikedeploy.make_env import make_env
from spikedeploy.outputs import mark, no_link
from spikedeploy.policies import run_record
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import VALIDATION
from spikedeploy.user_errors import one_line
from spikedeploy.video import Frame, Pace, add_caption, gif, shrink

# torch is imported where a film is made: the card looks for films without

FOLDER = "films"
_SECONDS = 12  # of the episode that are shown
_EVERY = 2  # of the frames that an MP4 would have
_WIDTH = 320
_LARGEST = 2_000_000  # [bytes] of a film


class TrainingFilms:
    """Films a run while it is trained, which learns the same, bit for bit.

    count: films of a whole training, the last at its end; 0 for none
    """

    def __init__(self, count: int) -> None:
        self._count, self._hindered = count, False

    def __call__(self, run: Path, step: int, total: int) -> None:
        """Film if a film is due; an error is reported once and does not end the training."""
        if self._hindered:
            return
        try:
            if self._due(run, step, total):
                with _generators_kept():
                    _film(run, step)
        except Exception as error:  # of the environment, the screen, the disk
            self._hindered = True
            why = one_line(error) or f"{type(error).__name__}: {error}"
            with suppress(OSError):  # of a terminal that was closed
                say(f"no more films of this training, which goes on: {why}")

    def _due(self, run: Path, step: int, total: int) -> bool:
        """True where a part of the training ended that has no film yet, and there is a policy."""
        parts = [min(each, total) * self._count // total for each in (step, *_filmed(run))]
        waits = step < total and not _best(run).is_file()
        return parts[0] > max(parts[1:], default=0) and not waits


def last_film(run: Path) -> Path | None:
    """The newest film of a run folder; None where there is none."""
    filmed = _filmed(run)
    return _place(run, max(filmed)) if filmed else None


def _filmed(run: Path) -> list[int]:
    """Steps of the films that there are."""
    return [int(path.stem) for path in (run / FOLDER).glob("*.gif") if path.stem.isdecimal()]


def _place(run: Path, step: int) -> Path:
    return run / FOLDER / f"{step}.gif"


def _best(run: Path) -> Path:
    return run / "checkpoints" / "best.safetensors"


@contextmanager
def _generators_kept() -> Iterator[None]:
    """Restore the generators that training shares: building a network draws weights."""
    import torch

    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - others draw from it
    try:
        with torch.random.fork_rng(devices=()):
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002


def _film(run: Path, step: int) -> None:
    """Write the film of a step, as GIF and for TensorBoard."""
    if not _best(run).is_file():
        raise ConfigError(f"{run} has no best checkpoint: no validation was due")
    no_link(run / FOLDER)
    trained, _ = run_record.steps(run, "best")
    caption = f"step {step:,}, best so far from {trained:,}"
    frames, period = _episode(run)
    frames = [add_caption(frame, caption) for frame in frames]
    path = no_link(_place(run, step))
    while gif(path, frames, period, mark("train")) > _LARGEST and len(frames) > 1:
        frames, period = frames[::2], 2 * period
    _to_tensorboard(path, step, frames[0].shape)


def _episode(run: Path) -> tuple[list[Frame], float]:
    """Frames (h, w, 3) of the beginning of an episode, and the time between two [s]."""
    from spikedeploy.policies.run import TorchController

    settings = run_record.settings(run)["env"]
    world: Any = make_env(settings["name"], settings["options"], render_mode="rgb_array")
    try:
        pace = Pace.for_period(world.unwrapped.CONTROL_DT)
        cut = TimeLimit(world, round(_SECONDS * pace.fps) * pace.every)
        player = TorchController(str(run), checkpoint="best")
        frames: list[Frame] = []

        def take(episode: EpisodeRecorder) -> None:
            if episode.steps % (_EVERY * pace.every) == 0:
                frames.append(shrink(world.render(), _WIDTH))

        rollout(cut, player, VALIDATION[0], take)
    finally:
        world.close()
    return frames, _EVERY / pace.fps


def _to_tensorboard(film: Path, step: int, shape: tuple[int, ...]) -> None:
    """Add the film to an event file beside it, as an image that TensorBoard shows moving."""
    if find_spec("tensorboard") is None:
        return
    from tensorboard.compat.proto.summary_pb2 import Summary
    from torch.utils.tensorboard import SummaryWriter

    image = Summary.Image(
        height=shape[0], width=shape[1], colorspace=3, encoded_image_string=film.read_bytes()
    )
    writer: Any = SummaryWriter(str(film.parent))
    try:
        summary = Summary(value=[Summary.Value(tag="film", image=image)])
        writer.file_writer.add_summary(summary, step)
    finally:
        writer.close()
