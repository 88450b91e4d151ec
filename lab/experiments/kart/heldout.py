"""Greedy episodes of a driver on every track, most of which it was not trained on.

Episodes run as one batch on a track, so that a spiking policy on the chip costs little more than a
float one. What a policy observes stays as in its training; only the track is another.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lab.experiments.evaluation import BuiltInEvaluation
from lab.experiments.stored_row import Record, StoredRow
from lab.experiments.trial import Trial
from spikedeploy import envs
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.sparse.pool import BatchController, Episodes, Stateless

# corridors of the length that is trained on, then longer ones; every start draws another
TRACKS = (
    "corridor-8", "corridor-24", "room_1", "room_2", "room_3", "small_S", "circuit", "big_S",
)  # fmt: skip
# trained on by no policy; `corridor-8` and `big_S` are, each by some
UNSEEN = tuple(track for track in TRACKS if track not in ("corridor-8", "big_S"))


@dataclass(frozen=True)
class TrackEvaluation:
    """The evaluation of one driver on all tracks.

    of      a training, or a built-in policy
    starts  episodes on each track, from seed EVALUATION up
    """

    of: Trial | BuiltInEvaluation
    starts: int

    @property
    def name(self) -> str:
        """`kart-grid-corridor-snn-s0-tracks`."""
        return f"{self.of.name}-tracks"

    @property
    def world(self) -> str:
        """Short name of the environment."""
        return self.of.env if isinstance(self.of, BuiltInEvaluation) else self.of.config.env.name

    @property
    def finished(self) -> Mapping[str, list[int]] | None:
        """Track -> whether each episode finished; None where an evaluation is missing."""
        row = self._row
        return row.found if row else None

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""
        return self.finished is not None

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of `perform`."""
        return {"of": self.of.arguments(), "starts": self.starts}

    def write(self, row: Record) -> None:
        """Write the result."""
        if self._row:
            self._row.write(row)

    @property
    def _row(self) -> StoredRow | None:
        """Where the result is; None before the training is complete."""
        made: Record = {"tracks": list(TRACKS), "starts": self.starts, "first_seed": EVALUATION}
        if isinstance(self.of, BuiltInEvaluation):
            return StoredRow(Path(self.of.folder) / f"{self.name}.json", made)
        file = self.policy
        if file is None or self.of.run is None:
            return None
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        made |= {"policy": digest, "chip": self.of.chip}
        return StoredRow(self.of.run / "tracks.json", made)

    @property
    def policy(self) -> Path | None:
        """The exported policy of a training; None where it is missing or not complete."""
        if isinstance(self.of, BuiltInEvaluation) or self.of.run is None or not self.of.done:
            return None
        files = (self.of.run / f"policy{ending}" for ending in (".onnx", ".nir"))
        return next((file for file in files if file.is_file()), None)


def perform(of: Mapping[str, Any], starts: int) -> bool:
    """Evaluate the driver with these fields; False where its training is not complete."""
    driver = Trial(**of) if "recipe" in of else BuiltInEvaluation(**of)
    asked = TrackEvaluation(driver, starts)
    if isinstance(driver, Trial) and asked.policy is None:
        return False
    asked.write({track: _finished(asked, track) for track in TRACKS})
    return True


def _finished(asked: TrackEvaluation, track: str) -> list[int]:
    """Whether each episode on a track finished."""
    trained = asked.of.config.env.options if isinstance(asked.of, Trial) else {}
    options = {**trained, "track": track}
    episodes = Episodes(EnvConfig(name=asked.world, options=options), asked.starts)
    seeds = range(EVALUATION, EVALUATION + asked.starts)
    _, _, infos = episodes.play(seeds, _controller(asked, options))
    return [int(info["finish"]) for info in infos]


def _controller(asked: TrackEvaluation, options: Mapping[str, Any]) -> BatchController:
    """The driver, for a batch of karts."""
    if isinstance(asked.of, Trial):
        file = str(asked.policy)
        if file.endswith(".onnx"):
            return Stateless(OnnxController(file).replay)
        spiking = SpikingController(load(file), chip(asked.of.chip), "none")
        spiking.reset(EVALUATION)
        return Stateless(spiking.act_batch)  # membranes start every control step at zero
    env = envs.make(asked.world, **options)
    if asked.of.policy == "gap":
        driver = GapDriver.of(env)
        return Stateless(lambda seen: np.array([driver.act(each) for each in seen]))
    env.action_space.seed(EVALUATION)
    return Stateless(lambda seen: np.array([env.action_space.sample() for _ in seen]))
