"""Rollouts: one episode of a controller in an environment, recorded step by step."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs import archive
from spikedeploy.runtime.errors import EnvError

FloatArray = NDArray[np.float64]
_VERSION = 1  # of the file layout
_SCALARS = (bool, int, float, np.integer, np.floating, np.bool_)
_LARGEST = sys.float_info.max
_LARGEST_REWARD = 1e100  # squares of sums of such rewards are finite


class _Controller(Protocol):
    """A map from observations to actions."""

    def reset(self, seed: int) -> None:
        """Start a new episode; stochastic controllers draw from the seed."""

    def act(self, observation: FloatArray) -> NDArray[Any]:
        """Return the action for an observation (obs,): (act,), or () int if discrete."""


@dataclass(frozen=True)
class Rollout:
    """Record of one episode of S control steps.

    env_id: gymnasium's identifier
    seed: of the episode
    observation: (S + 1, obs)
    action: (S, act) as the controller returned it; (S,) int64 if discrete
    reward: (S,)
    terminated: ended by a terminal state: a fall, a crash, the finish
    truncated: ended by the time limit
    info: (S,) each: the numbers in the step infos; reward terms as "reward/<name>"
    options: of the environment, as far as JSON can hold them
    """

    env_id: str
    seed: int
    observation: FloatArray
    action: NDArray[Any]
    reward: FloatArray
    terminated: bool
    truncated: bool
    info: dict[str, FloatArray]
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def steps(self) -> int:
        """Control steps S."""
        return len(self.reward)

    @property
    def total(self) -> float:
        """Return, the sum of the rewards."""
        return float(self.reward.sum())

    @property
    def success(self) -> bool | None:
        """Success by the last step's info; None where the info has no such entry."""
        return bool(self.info["success"][-1]) if "success" in self.info else None

    @property
    def failed(self) -> bool | None:
        """True where a terminal state other than success ended it: a fall, a crash, being lost.

        None where the environment does not define success. An episode that runs to its time
        limit without success is neither.
        """
        return None if self.success is None else self.terminated and not self.success

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a .npz file atomically."""
        infos = {f"info/{name}": values for name, values in self.info.items()}
        header = np.array([self.seed, self.terminated, self.truncated, _VERSION])
        options = np.array(json.dumps(dict(self.options)))
        arrays = {"header": header, "env_id": np.array(self.env_id), "options": options}
        rows = {name: getattr(self, name) for name in ("observation", "action", "reward")}
        archive.write(path, {**infos, **rows, **arrays})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Rollout:
        """Read a file that save wrote."""
        arrays = archive.read(path, "rollout")
        try:
            return cls._parse(arrays, path)
        except (ValueError, TypeError, OverflowError, RecursionError) as error:
            raise EnvError(f"{path}: not a whole rollout ({error})") from error

    @classmethod
    def _parse(cls, arrays: dict[str, Any], path: str | os.PathLike[str]) -> Rollout:
        missing = {"observation", "action", "reward", "header", "env_id"} - arrays.keys()
        if missing:
            raise EnvError(f"{path}: not a rollout file, {', '.join(sorted(missing))} missing")
        seed, terminated, truncated, version = arrays["header"].tolist()
        if version != _VERSION:
            raise EnvError(f"{path}: layout version {version}, this program reads {_VERSION}")
        infos = {name: values for name, values in arrays.items() if name.startswith("info/")}
        _check_rows(arrays, infos)
        options = json.loads(str(arrays.get("options", "{}")))  # missing in files of version 0.1
        if not isinstance(options, dict):
            raise ValueError(f"its options are no JSON object: {str(options)[:60]}")
        return cls(
            env_id=str(arrays["env_id"]),
            seed=seed,
            observation=arrays["observation"],
            action=arrays["action"],
            reward=arrays["reward"],
            terminated=bool(terminated),
            truncated=bool(truncated),
            info={name.removeprefix("info/"): values for name, values in infos.items()},
            options=options,
        )


def _check_rows(arrays: Mapping[str, Any], infos: Mapping[str, Any]) -> None:
    """Raise ValueError where the arrays are not those of one episode of numbers."""
    steps = arrays["reward"].shape
    rows = {"observation": (steps[0] + 1,) if len(steps) == 1 else (), "action": steps}
    for name, found in {**{n: arrays[n] for n in (*rows, "reward")}, **infos}.items():
        wanted = rows.get(name, steps)
        fits = found.shape[: len(wanted)] == wanted if name in rows else found.shape == wanted
        if found.dtype.kind not in "biuf" or len(steps) != 1 or not fits or found.ndim > 2:
            raise ValueError(f"{name} is {found.dtype} of shape {found.shape}, reward {steps}")


class EpisodeRecorder:
    """Recorder of an episode that the caller steps.

    observation: (obs,) latest
    info: of the latest step
    """

    def __init__(self, env: gymnasium.Env[Any, Any], seed: int) -> None:
        self._env, self._seed = env, seed
        first, self.info = env.reset(seed=seed)
        self.observation = _finite("observation", first, env.observation_space, 0)
        self._observations = [self.observation]
        self._actions: list[NDArray[Any]] = []
        self._rewards: list[float] = []
        self._infos: list[dict[str, float]] = []
        self._terminated = self._truncated = False

    @property
    def steps(self) -> int:
        """Control steps so far."""
        return len(self._actions)

    @property
    def reward(self) -> float:
        """Reward of the latest step."""
        return self._rewards[-1]

    @property
    def action(self) -> NDArray[Any]:
        """Action of the latest step."""
        return self._actions[-1]

    @property
    def numbers(self) -> Mapping[str, float]:
        """Numbers in the latest step's info."""
        return self._infos[-1]

    @property
    def over(self) -> bool:
        """True once the episode has ended."""
        return self._terminated or self._truncated

    def step(self, choice: object) -> None:
        """Step the environment with an action (act,), or () if discrete."""
        step = self.steps
        action = _action(choice, self._env.action_space, step)
        # environments index lists of actions with it
        given = action if action.ndim else int(action)
        observation, reward, terminated, truncated, self.info = self._env.step(given)
        space = self._env.observation_space
        self.observation = _finite("observation", observation, space, step + 1)
        self._observations.append(self.observation)
        self._actions.append(action)
        self._rewards.append(_reward(reward, step + 1))
        self._infos.append(_numbers(self.info))
        self._terminated, self._truncated = bool(terminated), bool(truncated)

    def rollout(self) -> Rollout:
        """The record of at least one step; an unfinished episode counts as truncated."""
        return Rollout(
            env_id=self._env.spec.id if self._env.spec else type(self._env.unwrapped).__name__,
            seed=self._seed,
            observation=np.stack(self._observations),
            action=np.stack(self._actions),
            reward=np.array(self._rewards),
            terminated=self._terminated,
            truncated=self._truncated or not self._terminated,
            info={
                # infos of foreign environments may lack a number at some steps
                name: np.array([numbers.get(name, np.nan) for numbers in self._infos])
                for name in self._infos[-1]
            },
            options=_options_of(self._env),
        )


def draw_action(space: gymnasium.Space[Any], rng: np.random.Generator) -> Any:  # noqa: ANN401
    """Return an action of a policy drawn uniformly: (act,) in [-1, 1], or one of several."""
    if isinstance(space, gymnasium.spaces.Discrete):
        return int(rng.integers(space.n))
    return rng.uniform(-1.0, 1.0, space.shape or ())


def rollout(
    env: gymnasium.Env[Any, Any],
    controller: _Controller,
    seed: int,
    on_step: Callable[[EpisodeRecorder], object] | None = None,
) -> Rollout:
    """Run one episode; `on_step` is called with its recorder after the reset and every step."""
    recorder = EpisodeRecorder(env, seed)
    controller.reset(seed)
    while True:
        if on_step is not None:
            on_step(recorder)
        if recorder.over:
            return recorder.rollout()
        recorder.step(controller.act(recorder.observation))


def _options_of(env: gymnasium.Env[Any, Any]) -> dict[str, Any]:
    """Options as JSON holds them, without render_mode; of a Track and its like the name."""
    given = getattr(env, "given", env.spec.kwargs if env.spec else {})  # of disturbed ones
    shown = {name: value for name, value in given.items() if name != "render_mode"}
    text = json.dumps(shown, default=lambda value: str(getattr(value, "name", value)))
    options: dict[str, Any] = json.loads(text)
    return options


def _action(value: object, space: gymnasium.Space[Any], step: int) -> NDArray[Any]:
    """Copy of an action: float64 (act,), or int64 () for a discrete space."""
    action = _finite("action", value, space, step)
    if not isinstance(space, gymnasium.spaces.Discrete):
        return action
    if action % 1 or not space.start <= action < space.start + space.n:
        last = space.start + space.n - 1
        raise EnvError(f"action of step {step}: {action:g} is none of {space.start} to {last}")
    return action.astype(np.int64)


def _reward(value: Any, step: int) -> float:  # noqa: ANN401
    """A reward; EnvError if it is no number, or so large that squares of returns overflow."""
    try:
        reward = float(value)
    except (TypeError, ValueError, OverflowError):
        reward = math.nan
    if not abs(reward) <= _LARGEST_REWARD:
        raise EnvError(
            f"reward of step {step}: {str(value)[:40]} is no number of at most {_LARGEST_REWARD:g}"
        )
    return reward


def _finite(what: str, value: object, space: gymnasium.Space[Any], step: int) -> FloatArray:
    """Copy of a vector in float64; EnvError if its shape is wrong or a value is not finite."""
    vector = np.array(value, dtype=np.float64)
    if vector.shape != space.shape:
        raise EnvError(f"{what} of step {step}: shape {vector.shape} instead of {space.shape}")
    if not np.isfinite(vector).all():
        where = np.flatnonzero(~np.isfinite(vector)).tolist()
        raise EnvError(f"{what} of step {step}: not a finite number at {where}")
    return vector


def _numbers(info: Mapping[str, Any]) -> dict[str, float]:
    """Numeric scalars of a step info that float64 holds, reward terms as reward/<name>."""
    terms = info.get("reward_terms")  # somebody else's may be anything
    named = {f"reward/{name}": of for name, of in terms.items()} if isinstance(terms, dict) else {}
    scalars = {k: v for k, v in {**info, **named}.items() if isinstance(v, _SCALARS)}
    # a whole number may be larger than any float64
    held = {k: v for k, v in scalars.items() if not (isinstance(v, int) and abs(v) > _LARGEST)}
    return {name: float(value) for name, value in held.items()}
