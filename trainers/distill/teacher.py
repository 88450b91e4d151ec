"""Teachers, and an environment's observations and actions as its author has them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from gymnasium import Env
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from spikedeploy import envs
from spikedeploy.envs.foreign import AdaptedEnv
from spikedeploy.envs.returned import is_masked
from spikedeploy.runtime import choices
from spikedeploy.runtime.errors import ConfigError

FloatArray = NDArray[np.float64]
_CERTAIN = 20.0  # logit of a choice whose alternatives have 0: its softmax is 1 within 1e-8


@dataclass(frozen=True)
class Teacher:
    """A policy to imitate; also a controller of one robot.

    act_all: actions (B, act) in [-1, 1] for observations (B, obs), or logits of discrete ones
    observations, actions: their numbers
    env: short name or id of its environment, empty if unknown
    widths: widths of a multilayer perceptron, from observations to actions; empty if unknown
    restart: called when an episode begins, of a script with a memory
    act_in_envs: of a teacher that knows the simulation: actions (B, act) in B environments, as
        they are now; `act_all` refuses until `in_envs` has named them
    """

    act_all: Callable[[FloatArray], FloatArray]
    observations: int
    actions: int
    env: str = ""
    widths: tuple[int, ...] = ()
    restart: Callable[[], object] | None = None
    act_in_envs: Callable[[Sequence[Env[Any, Any]]], FloatArray] | None = None

    def in_envs(self, worlds: Sequence[Env[Any, Any]]) -> "Teacher":
        """Return the teacher of robots in these environments, the first of each batch first."""
        if self.act_in_envs is None:
            return self
        act_in_envs = self.act_in_envs
        return replace(self, act_all=lambda observation: act_in_envs(worlds[: len(observation)]))

    def check_sizes(self, path: str, env: str, sizes: tuple[int, int]) -> None:
        """Refuse a teacher of other numbers of observations and actions than an environment's."""
        if sizes != (self.observations, self.actions):
            raise ConfigError(
                f"the teacher {path} takes {self.observations} observations and gives "
                f"{self.actions} actions; {env} has {sizes}"
            )

    def reset(self, seed: int) -> None:
        """Begin an episode."""
        if self.restart is not None:
            self.restart()

    def act(self, observation: FloatArray) -> FloatArray:
        """Return the action (act,) for one observation (obs,)."""
        action: FloatArray = self.act_all(observation[None])[0]
        return action


def certain(choice: NDArray[np.int64], count: int) -> FloatArray:
    """Return the logits (B, n) of a teacher that says its choices (B,) alone."""
    logits: FloatArray = _CERTAIN * np.eye(count)[choice]
    return logits


def compute_cross_entropy(mean: Tensor, label: Tensor, sharpness: float) -> Tensor:
    """Return the cross entropy (...) of a student's logits (..., n) with its teacher's.

    sharpness: factor of the teacher's logits
    """
    # H = -sum_k softmax(sharpness label)_k log softmax(mean)_k
    target = torch.softmax(sharpness * label, -1)
    return -(target * functional.log_softmax(mean, -1)).sum(-1)


Units = choices.Units


@dataclass(frozen=True)
class OwnSpaces:
    """Spaces of an environment before it is adapted, for teachers that know it so.

    Policies of ours see vectors and act in [-1, 1], or choose from 0; other people's teachers see
    the environment's own observations and give its own actions. This is the way between the two.

    name: name of the environment
    observation, action: Box or Discrete
    """

    name: str
    observation: Space[Any]
    action: Space[Any]

    @classmethod
    def from_env(cls, name: str, options: Mapping[str, Any]) -> "OwnSpaces":
        """Return the spaces of an environment, which is made for it."""
        env = envs.make(name, **options)
        found = cls.within(name, env)
        env.close()
        return found

    @classmethod
    def within(cls, name: str, env: Env[Any, Any]) -> "OwnSpaces":
        """Return the spaces of an environment that was made."""
        world = env.unwrapped  # disturbances wrap the adapted one
        inner = world.inner if isinstance(world, AdaptedEnv) else env
        return cls(name, inner.observation_space, inner.action_space)

    @property
    def observations(self) -> int:
        """Numbers that policies observe."""
        return _size(self.observation)

    @property
    def actions(self) -> int:
        """Numbers that policies put out."""
        return _size(self.action)

    def observed(self, vector: FloatArray) -> Any:  # noqa: ANN401
        """Return the observation, in its own shape and type, that policies see as (obs,)."""
        if isinstance(self.observation, Discrete):
            return int(vector.argmax()) + int(self.observation.start)
        return vector.reshape(self.observation.shape).astype(self.observation.dtype)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest action (act,) of a Box."""
        space = self.action
        if not isinstance(space, Box):
            raise ConfigError(f"{self.name} takes one of {self.actions} actions, without bounds")
        return np.float64(space.low).ravel(), np.float64(space.high).ravel()

    def labels(self, teacher: str, given: Any, robots: int, units: Units) -> FloatArray:  # noqa: ANN401
        """Return what B robots should do, (B, act) as policies act, from what a teacher gave.

        given: own actions or, with units "scaled", in [-1, 1]; of discrete actions the choice of
            each robot, or a logit for each choice
        """
        found = np.asarray(given)
        numeric = found.dtype.kind in "fiub" and found.size and found.size % robots == 0
        if not numeric or is_masked(given) or not np.isfinite(found).all():
            raise ConfigError(
                f"the teacher {teacher} gave no finite numbers for {robots} observations: {given}"
            )
        rows = found.reshape(robots, -1).astype(np.float64)
        if isinstance(self.action, Discrete):
            return self._logits(teacher, rows, self.action)
        return self._scaled(teacher, rows, units)

    def _logits(self, teacher: str, rows: FloatArray, space: Discrete) -> FloatArray:
        """Return logits (B, n) of choices (B, 1), counted as the environment does, or of logits."""
        count, start = int(space.n), int(space.start)
        if rows.shape[1] == count > 1:
            return rows
        choice = rows[:, 0] - start
        inside = (choice == np.rint(choice)) & (choice >= 0) & (choice < count)
        if rows.shape[1] != 1 or not inside.all():
            raise ConfigError(
                f"the teacher {teacher} gave {rows[0].tolist()}, and {self.name} takes one of "
                f"{count} actions: give its number, from {start} to {start + count - 1}, or "
                f"{count} logits"
            )
        return certain(choice.astype(np.int64), count)

    def _scaled(self, teacher: str, rows: FloatArray, units: Units) -> FloatArray:
        """Return actions in [-1, 1] of own ones (B, act)."""
        if rows.shape[1] != self.actions:
            raise ConfigError(
                f"the teacher {teacher} gives {rows.shape[1]} actions; {self.name} takes "
                f"{self.actions}"
            )
        if units == "own":
            low, high = self.bounds()
            # x = 2 (a - low) / (high - low) - 1; 0 where there is nothing to choose
            span = np.where(high > low, high - low, 1.0)
            rows = np.where(high > low, 2.0 * (rows - low) / span - 1.0, 0.0)
        return np.clip(rows, -1.0, 1.0)


def _size(space: Space[Any]) -> int:
    return int(space.n) if isinstance(space, Discrete) else int(np.prod(space.shape or ()))
