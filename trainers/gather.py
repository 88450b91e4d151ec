"""One DAgger iteration's walk: states that the student or the teacher reaches, with labels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spikedeploy.trainers.collect import EnvBatch
from spikedeploy.trainers.distill_config import DistillConfig
from spikedeploy.trainers.teachers import Numbers, Teacher


@dataclass(frozen=True)
class Walk:
    """What was seen on the way.

    observation: (n, obs) every state
    label: (n, act) what the teacher would do there
    returns: of the episodes that ended
    """

    observation: Numbers
    label: Numbers
    returns: list[float]


def fresh(config: DistillConfig, iteration: int) -> EnvBatch:
    """Return the environments of an iteration; a run that is resumed there sees the same."""
    return EnvBatch(config.env, np.random.default_rng((config.seed, iteration)))


def walk(
    config: DistillConfig,
    iteration: int,
    teacher: Teacher,
    student: Teacher,
    stopped: Callable[[], bool],
) -> Walk | None:
    """Walk an iteration's states; None when stopped on the way."""
    envs = fresh(config, iteration)
    visited: list[Numbers] = []
    labels: list[Numbers] = []
    rng = np.random.default_rng((config.seed, iteration, 1))
    share = config.mixing**iteration  # 1 in iteration 0: the teacher's own way
    while len(visited) * len(envs) < config.states:
        if stopped():
            return None
        visited.append(envs.observation)
        labels.append(teacher.act_all(envs.observation))
        taught = rng.random(len(envs)) < share
        action = labels[-1] if taught.all() else student.act_all(envs.observation)
        action = np.where(taught[:, None], labels[-1], action)
        noise = config.noise * rng.standard_normal(action.shape)
        envs.step(np.clip(action + noise, -1.0, 1.0))
    return Walk(np.concatenate(visited), np.concatenate(labels), envs.returns)
