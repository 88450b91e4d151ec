"""Teachers of `distill` that no other format plays: functions of the user, files of other people.

They act in the environment's own units, which is why ONNX files of other people are here too.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.foreign import is_target
from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies.costs import UNCOUNTED, Costs
from spikedeploy.policies.interface import Candidate, check_fit
from spikedeploy.policies.registry import find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.onnx_session import says_how_it_acts, session

if TYPE_CHECKING:
    from spikedeploy.trainers.distill.teacher import Teacher, Units


class TeacherController:
    """A teacher as a player.

    chooses  whether its output is logits, of which the largest is taken
    """

    def __init__(self, teacher: "Teacher", chooses: bool) -> None:
        self._teacher, self._chooses = teacher, chooses

    def reset(self, seed: int) -> None:
        """Nothing to reset: teachers have no state."""

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The action (act,) or ()."""
        return np.asarray(self.replay(observation[None])[0])

    def replay(self, observations: NDArray[np.float64]) -> NDArray[Any]:
        """Actions (S, act) or (S,) for the observations (S, obs) of an episode."""
        output = self._teacher.act_all(observations)
        return output.argmax(axis=1) if self._chooses else output


def teacher_candidate(reference: str, units: "Units | None" = None) -> Candidate:
    """The candidate of a teacher as `distill` names it; `units` are those of its actions.

    A function that the user names is code of the user, imported where it plays: a reference that
    was read from a file must not come here.
    """
    path = Path(reference)
    if is_target(reference) and not path.exists():
        return Candidate(reference, reference, "control", "function", units=units)
    if path.suffix == ".zip" or (path.suffix == ".onnx" and _of_others(path)):
        return Candidate(reference, path.stem, "ann", "teacher", units=units)
    if units is not None:
        raise ConfigError(f"{reference} says itself how it acts: leave --teacher-units out")
    return find(reference)


def _of_others(path: Path) -> bool:
    """Whether an ONNX file does not say how it acts, as ours do."""
    return path.is_file() and not says_how_it_acts(session(path))


def describe(path: Path) -> Candidate:
    """The candidate of a teacher."""
    return teacher_candidate(str(path))


def controller(
    candidate: Candidate, chip: str | None, env: gymnasium.Env[Any, Any], sampled: bool
) -> TeacherController:
    """The teacher, opened; functions are imported now."""
    import torch

    from spikedeploy.trainers.distill.teacher import OwnSpaces
    from spikedeploy.trainers.distill.teachers import opened

    torch.set_num_threads(1)
    name = env.spec.id if env.spec else ""
    found = opened(candidate.path, name, lambda: OwnSpaces.within(name, env), candidate.units)
    chooses = isinstance(env.action_space, gymnasium.spaces.Discrete)
    check_fit(replace(candidate, observed=found.observations, actions=found.actions), env)
    return TeacherController(found, chooses)


def costs(controller: TeacherController, played: Rollout) -> Costs:
    """Not counted: neither scripts nor files of others say their operations."""
    return UNCOUNTED
