"""Policies without a file of ours: the built-in scripts, such as `gait` and `gap`; teachers."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.foreign import is_target
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.envs.rollout import Rollout, draw_action
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.costs import NOTHING, Costs, float_costs
from spikedeploy.policies.registry import Candidate, Controller, Env, Floats, check_fit, find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix
from spikedeploy.trainers.onnx_session import has_policy_metadata, session

if TYPE_CHECKING:
    from spikedeploy.trainers.distill.teacher import Teacher, Units

_STREAM = 1  # so that draws differ from those of an environment with the same seed


class ZeroController(Controller):
    """Zero actions (act,), which leave the environment's own gait unchanged."""

    def __init__(self, actions: int) -> None:
        self._actions = actions

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The gait of a robot that has one."""
        space = env.action_space
        if not isinstance(space, gymnasium.spaces.Box):
            raise ConfigError("the gait is for robots that have one, with actions that are numbers")
        return cls(space.shape[0])

    def act(self, observation: Floats) -> Floats:
        """The action (act,)."""
        return np.zeros(self._actions)

    def costs(self, played: Rollout) -> Costs:
        """Return no costs: nothing is computed."""
        return NOTHING


class RandomController(Controller):
    """Actions of a space, drawn uniformly at every control step, seeded by the episode."""

    def __init__(self, space: gymnasium.Space[Any]) -> None:
        self._space = space
        self.reset(0)

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """Draws of the environment's actions."""
        return cls(env.action_space)

    def reset(self, seed: int) -> None:
        """Seed the draws."""
        self._rng = np.random.default_rng([seed, _STREAM])

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action (act,), or () where it is one of several."""
        return np.asarray(draw_action(self._space, self._rng))

    def costs(self, played: Rollout) -> Costs:
        """Return no costs: nothing is computed."""
        return NOTHING


class GapController(Controller):
    """A script that follows the gap in the LIDAR, on the observations of a policy."""

    def __init__(self, env: Env) -> None:
        self._driver = GapDriver.for_env(env)

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The driver of the environment's kart."""
        return cls(env)

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action (act,), or () where it is one of several."""
        return self._driver.act(observation)


class ExpertController(Controller):
    """The environment's own expert, which reads the simulation and no observation."""

    def __init__(self, expert: "Teacher", chooses: bool) -> None:
        self._expert, self._chooses = expert, chooses

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The method `expert` of the environment."""
        from spikedeploy.trainers.distill.teacher import OwnSpaces
        from spikedeploy.trainers.distill.teachers import expert_of

        expert = expert_of(OwnSpaces.within(env.spec.id if env.spec else "", env)).in_envs([env])
        return cls(expert, isinstance(env.action_space, gymnasium.spaces.Discrete))

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action (act,), or () where it is one of several, that the expert takes now."""
        action = self._expert.act(observation)
        return np.asarray(action.argmax()) if self._chooses else action

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Refuse: the expert needs the environment in the state of each step."""
        raise ConfigError("the expert looks at no observations, so it has no actions for them")

    def costs(self, played: Rollout) -> Costs:
        """Return no costs: nothing is observed, and no computation counts."""
        return NOTHING


class TeacherController(Controller):
    """A teacher of `distill` that no other format plays: a function, a file of another tool.

    It acts in the environment's own units, which is why ONNX files of other tools are here too.

    chooses: whether its output is logits, of which the largest is taken
    """

    def __init__(self, teacher: "Teacher", chooses: bool) -> None:
        self._teacher, self._chooses = teacher, chooses

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The teacher; functions are imported now."""
        if setup.sampled:
            raise ConfigError("a teacher gives its best action: leave --sampled out")
        import torch

        from spikedeploy.trainers.distill.teacher import OwnSpaces
        from spikedeploy.trainers.distill.teachers import open_teacher

        torch.set_num_threads(1)
        name = env.spec.id if env.spec else ""
        found = open_teacher(
            candidate.path, name, lambda: OwnSpaces.within(name, env), candidate.units
        )
        check_fit(replace(candidate, observed=found.observations, actions=found.actions), env)
        return cls(found, isinstance(env.action_space, gymnasium.spaces.Discrete))

    def reset(self, seed: int) -> None:
        """Begin an episode, of a script with a memory."""
        self._teacher.reset(seed)

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Actions (S, act) or (S,) for the observations (S, obs) of an episode."""
        output = self._teacher.act_all(observations)
        return output.argmax(axis=1) if self._chooses else output

    def costs(self, played: Rollout) -> Costs:
        """Multiply-accumulates of all layers, where they are known; zeros are not looked for."""
        widths = self._teacher.widths
        if not widths:
            return super().costs(played)
        dense = sum(a * b for a, b in pairwise(widths))
        return float_costs(dense, None, sum(widths[1:]), widths[0], hidden=len(widths) > 2)


def teacher_candidate(reference: str, units: "Units | None" = None) -> Candidate:
    """The candidate of a teacher as `distill` names it; `units` are those of its actions.

    A function that the user names is code of the user, imported where it plays: a reference that
    was read from a file must not come here.
    """
    path = Path(reference)
    if is_target(reference) and not path.exists():
        return Candidate(reference, reference, "control", "function", units=units)
    is_onnx = suffix(path) == ".onnx" and path.is_file()
    if suffix(path) == ".zip" or (is_onnx and not has_policy_metadata(session(path))):
        return Candidate(reference, path.stem, "ann", "teacher", units=units)
    if units is not None:
        raise ConfigError(f"{reference} says itself how it acts: leave --teacher-units out")
    return find(reference)
