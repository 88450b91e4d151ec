"""A double pendulum on a cart, balanced by policies that act late.

An LQR of the linearised simulation says what a linear policy can do, at once and one control step
late. `shown` is the environment in which students that act late observe their last actions, too.
"""

from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from spikedeploy.trainers.distill.teacher import Teacher
from spikedeploy.trainers.distill.teachers import teacher

NAME = "InvertedDoublePendulum-v5"
TEACHER = Path(__file__).parents[2] / "results" / "students" / f"{NAME}.zip"
_OBSERVED = 9
_SEEN = [0, 1, 2, 5, 6, 7]  # of them: the cart's position, sines of both angles, velocities
_SHOWN = 2  # last actions
_EPS = 1e-5  # of central differences
_SWEEPS = 2_000  # of Riccati's recursion
_EFFORT = 30.0  # weight of the action in the cost; each of _SEEN has 1
_MOST = 127  # of 8 bits

FloatArray = NDArray[np.float64]


# -- for students: two targets, as `distill lab.experiments.late:taught --env …:shown` takes them


class LastActions(gymnasium.Wrapper[Any, Any, Any, Any]):
    """The last actions stand behind the observation, the latest first; before the first, zeros."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        seen: Any = env.observation_space
        acted: Any = env.action_space
        low, high = (np.tile(each, _SHOWN) for each in (acted.low, acted.high))
        self.observation_space = gymnasium.spaces.Box(
            np.concatenate([seen.low, low]), np.concatenate([seen.high, high]), dtype=np.float64
        )
        self._acted = np.zeros((_SHOWN, *acted.shape))

    def reset(self, **options: Any) -> tuple[FloatArray, dict[str, Any]]:  # noqa: ANN401
        """Start an episode, without an action."""
        self._acted[:] = 0.0
        seen, info = self.env.reset(**options)
        return np.concatenate([seen, self._acted.ravel()]), info

    def step(self, action: Any) -> tuple[FloatArray, Any, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Act, and show it."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        self._acted[1:], self._acted[0] = self._acted[:-1].copy(), action
        return np.concatenate([seen, self._acted.ravel()]), reward, terminated, truncated, info


def shown() -> LastActions:
    """The double pendulum, and its last actions."""
    return LastActions(gymnasium.make(NAME))


@cache
def _teacher() -> Teacher:
    return teacher(str(TEACHER), NAME)


def taught(observations: FloatArray) -> FloatArray:
    """What the teacher does (B, 1), which is not shown the last actions."""
    return _teacher().act_all(observations[:, :_OBSERVED])


taught.vectorised = True  # type: ignore[attr-defined]  # as teachers of one's own say so


# -- the linear quadratic regulator


def gain(shown: bool) -> FloatArray:
    """Gains (1, 6) on _SEEN; or (1, 7), on the last action too, for one that acts a step late.

    Rounded to 8 bits.
    """
    move, push = _linearised()
    if shown:  # x' = A x + B a, where a was chosen a control step before
        move = np.block([[move, push], [np.zeros((1, 7))]])
        push = np.eye(7)[:, 6:]
    weight = np.diag([1.0] * 6 + [0.0] * shown)
    value = weight
    for _ in range(_SWEEPS):
        found = np.linalg.solve(_EFFORT + push.T @ value @ push, push.T @ value @ move)
        value = weight + move.T @ value @ (move - push @ found)
    scale = np.abs(found).max() / _MOST
    rounded: FloatArray = np.rint(found / scale) * scale
    return rounded


def _linearised() -> tuple[FloatArray, FloatArray]:
    """A (6, 6) and B (6, 1) of a control step about the upright, by central differences.

    MuJoCo's own derivatives are not for the Runge-Kutta integrator of this model.
    """
    world: Any = gymnasium.make(NAME).unwrapped
    model, data = world.model, world.data

    def after(state: FloatArray, action: float) -> FloatArray:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = state[:3], state[3:], action
        mujoco.mj_step(model, data, world.frame_skip)
        return np.concatenate([data.qpos, data.qvel])

    rest, moves = np.zeros(6), _EPS * np.eye(6)
    move = [(after(each, 0.0) - after(-each, 0.0)) / (2 * _EPS) for each in moves]
    push = (after(rest, _EPS) - after(rest, -_EPS)) / (2 * _EPS)
    return np.stack(move, 1), push[:, None]


class Regulator:
    """The LQR as a BatchController, whose actions reach the pendulum at once or a step late."""

    def __init__(self, gains: FloatArray, late: bool) -> None:
        self._gains, self._late = gains, late

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._last = np.zeros((robots, 1))

    def act_batch(self, observation: FloatArray) -> FloatArray:
        """Actions (B, 1) for observations (B, 9)."""
        seen = observation[:, _SEEN]
        if self._gains.shape[1] > len(_SEEN):
            seen = np.concatenate([seen, self._last], axis=1)
        before, self._last = self._last, np.clip(-seen @ self._gains.T, -1.0, 1.0)
        return before if self._late else self._last
