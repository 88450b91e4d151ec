"""Rows of the gymnasium experiment, on seeds that no training and no choice of a policy has seen.

Each row is a file of its own, <runs>/evaluations/<training>@<place>.json, which says what it was
made with: a stopped experiment goes on after the last row, and a row whose policy or sizes have
changed is made again.
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lab.experiments.gymnasium.design import RANDOM, TEACHER, GymnasiumDesign
from lab.experiments.gymnasium.networks import network_of, random_actions
from lab.experiments.gymnasium.training import TaskTraining
from lab.experiments.pareto.training import complete
from lab.experiments.stored_row import StoredRow
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.sparse.pool import BatchController, Episodes, Walk

Record = dict[str, Any]
_VERSION = 1  # of what a row holds; a higher one makes all rows again


def rows(design: GymnasiumDesign, training: TaskTraining) -> list[StoredRow]:
    """The rows of a training that has ended; beside the teacher's that of random actions."""
    if training.run is None:
        raise ConfigError(f"{training.name} has no run folder")
    policy = (training.run / "checkpoints" / "best.safetensors").read_bytes()
    digest = hashlib.sha256(policy).hexdigest()
    found = [_row(design, training, place, digest) for place in design.places(training)]
    return [*found, _row(design, training, RANDOM, "")] if training.role == TEACHER else found


def _row(design: GymnasiumDesign, training: TaskTraining, place: str, digest: str) -> StoredRow:
    made = {
        "training": training.name,
        "place": place,
        "policy": digest,
        "episodes": design.episodes,
        "first_seed": EVALUATION,
        "limit": design.limit,
        "version": _VERSION,
    }
    folder = Path(design.runs) / "evaluations"
    return StoredRow(folder / f"{training.name}@{place}.json", made)


def missing(design: GymnasiumDesign, training: TaskTraining) -> bool:
    """Whether a training, or a row of it, is missing."""
    return not training.trained or any(row.found is None for row in rows(design, training))


def all_rows(design: GymnasiumDesign) -> Iterator[Record]:
    """The results so far."""
    for training in design.trainings():
        for row in rows(design, training) if training.trained else ():
            if (found := row.found) is not None:
                yield found


def _named(design: Record, name: str) -> tuple[GymnasiumDesign, TaskTraining]:
    asked = GymnasiumDesign(**design)
    return asked, next(each for each in asked.trainings() if each.name == name)


def train(design: Record, name: str) -> bool:
    """Complete a training (a job of `resumable`); False if it was interrupted."""
    return complete(_named(design, name)[1])


def perform(design: Record, name: str) -> bool:
    """Make the missing rows of a training (a job of `resumable`)."""
    asked, training = _named(design, name)
    if not training.trained:
        raise ConfigError(f"{training.name} is not trained yet, so there is nothing to evaluate")
    for row in rows(asked, training):
        if row.found is None:
            row.write(_evaluated(asked, training, row))
    return True


def _evaluated(design: GymnasiumDesign, training: TaskTraining, row: StoredRow) -> Record:
    place = row.of["place"]
    facts = {"env": training.env, "role": training.role, "seed": training.seed, "place": place}
    if place == RANDOM:
        facts |= {"role": RANDOM, "seed": None}
        return facts | _played(design, training.env, random_actions(training.env))[1]
    if training.run is None:
        raise ConfigError(f"{training.name} has no run folder")
    try:
        made = network_of(training.run, place, Path(design.runs) / "policies" / training.name)
    except RuleError as error:
        return facts | {"refusal": str(error)}
    walks, found = _played(design, training.env, made.controller)
    return facts | made.done(walks) | found


def _played(
    design: GymnasiumDesign, env: str, controller: BatchController
) -> tuple[list[Walk], Record]:
    """Walks of all episodes in one batch, and what they came to."""
    together = Episodes(EnvConfig(name=env), design.episodes, design.limit)
    seeds = range(EVALUATION, EVALUATION + design.episodes)
    # walks are kept only with labels, of which nothing is needed here
    walks, returns, _ = together.play(seeds, controller, lambda seen: seen[:, :0])
    return walks, {
        "episodes": design.episodes,
        "return_mean": float(np.mean(returns)),
        "terminated": float(np.mean([each.terminated for each in together.earned])),
        "steps": float(np.mean([len(walk.observation) for walk in walks])),
        "scores": list(returns),
    }
