"""Ghosts: compact records of kart episodes, for replaying a whole training.

A compressed .npz of n episodes with S1, S2, … steps, without pickled objects:

    header    JSON: layout version, env_id, options
    steps     (n,) int32, S of each episode
    start     (4, n) int32, initial x, y [1/16 px], heading [1/1024 rad], speed [1/16 px/s]
    moves     (4, sum of S) int32, differences from step to step
    action    (sum of S, …) uint8 if discrete, else float32
    reward    (sum of S,) float32, rounded to 12 bits
    finish, crash (n,) bool; gates (n,) int16; env_step, seed (n,) int64

A folder of such files, sorted by name, holds the iterations of a training.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs import archive
from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.rollout import Rollout

_VERSION = 1  # of the file layout
_UNITS = np.array([16.0, 16.0, 1024.0, 16.0])  # file units of x, y, heading and speed
_EACH = {  # arrays with one entry per episode
    "steps": np.int32,
    "finish": np.bool_,
    "crash": np.bool_,
    "gates": np.int16,
    "env_step": np.int64,
    "seed": np.int64,
}
_PARTS = ("start", "moves", "action", "reward", *_EACH)

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Ghost:
    """One kart episode of S steps, without observations.

    pose      (S + 1, 3) x, y [px], heading [rad]
    speed     (S + 1,) [px/s]
    action    (S,) int if discrete, or (S, act)
    reward    (S,)
    finish    whether it reached the finish
    crash     whether it ended at a wall
    gates     number of gates passed
    env_step  environment steps of the training at its end; 0 without training
    seed      of the episode, from which a random track is rebuilt; -1 if unknown
    """

    pose: Floats
    speed: Floats
    action: NDArray[Any]
    reward: Floats
    finish: bool
    crash: bool
    gates: int
    env_step: int = 0
    seed: int = -1

    @property
    def steps(self) -> int:
        """Control steps S."""
        return len(self.reward)

    @classmethod
    def from_rollout(cls, played: Rollout) -> Ghost:
        """The ghost of a rollout, whose infos must contain the poses."""
        missing = {"x", "y", "heading", "speed"} - played.info.keys()
        if missing:
            raise EnvError(
                f"a rollout of {played.env_id} has no {', '.join(sorted(missing))} in its infos, "
                "so it leaves no ghost; only karts do"
            )
        info = {name: values[-1] for name, values in played.info.items()}
        poses = np.stack([played.info[name] for name in ("x", "y", "heading", "speed")], axis=1)
        # the pose before the first step is not recorded
        path: Floats = np.concatenate((poses[:1], poses)).astype(np.float32)
        return cls(
            pose=path[:, :3],
            speed=path[:, 3],
            action=played.action,
            reward=played.reward.astype(np.float32),
            finish=bool(info.get("finish", False)),
            crash=bool(info.get("crash", False)),
            gates=int(info.get("gates", 0)),
            seed=played.seed,
        )


@dataclass(frozen=True)
class Ghosts:
    """Ghosts of one environment.

    env_id   gymnasium's identifier
    options  of the environment, as far as JSON can hold them
    drives   (n,) in the order in which they ended
    """

    env_id: str
    drives: Sequence[Ghost]
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def track(self) -> str:
        """Name or path of the track."""
        return str(self.options.get("track", "big_S"))

    @classmethod
    def from_rollout(cls, played: Rollout) -> Ghosts:
        """A rollout as the only ghost."""
        return cls(played.env_id, [Ghost.from_rollout(played)], played.options)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file described above, atomically."""
        archive.write(path, self._arrays())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Ghosts:
        """Read a file that save wrote."""
        arrays = archive.read(path, "ghost file")
        header = _header(arrays, path)
        try:
            _check_arrays(arrays)
            drives = _drives(arrays)
        except (KeyError, ValueError, IndexError, TypeError, OverflowError) as error:
            raise EnvError(f"{path}: its arrays do not fit together ({error})") from error
        return cls(header["env_id"], drives, header["options"])

    def _arrays(self) -> dict[str, Any]:
        header = {"version": _VERSION, "env_id": self.env_id, "options": dict(self.options)}
        paths = [_units(ghost) for ghost in self.drives]
        each: dict[str, Any] = {
            name: np.array([getattr(ghost, name) for ghost in self.drives], kind)
            for name, kind in _EACH.items()
        }
        return {
            "header": np.array(json.dumps(header, default=str)),
            "start": _join([path[:, :1] for path in paths], (4, 0), np.int32),
            "moves": _join([np.diff(path) for path in paths], (4, 0), np.int32),
            "action": _actions([ghost.action for ghost in self.drives]),
            "reward": _round(_join([g.reward for g in self.drives], (0,), np.float32)),
            **each,
        }


def _units(ghost: Ghost) -> NDArray[np.int64]:
    """x, y, heading and speed (4, S + 1) in file units."""
    path = np.column_stack((ghost.pose, ghost.speed)).astype(np.float64)
    whole: NDArray[np.int64] = np.rint(path * _UNITS).astype(np.int64).T
    return whole


def _join(parts: list[Any], empty: tuple[int, ...], kind: type) -> NDArray[Any]:
    """Arrays joined along their last axis; an empty one if there are none."""
    return np.concatenate([np.zeros(empty), *parts], axis=-1).astype(kind)


def _actions(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """All actions in the smallest type that holds them."""
    if not parts:
        return np.zeros(0, np.uint8)
    joined = np.concatenate(parts)
    return joined.astype(np.uint8 if np.issubdtype(joined.dtype, np.integer) else np.float32)


def _round(values: Floats) -> Floats:
    """The values with 11 bits of mantissa, which halves the file."""
    bits = values.view(np.uint32)
    rounded: Floats = ((bits + np.uint32(1 << 11)) & np.uint32(0xFFFFF000)).view(np.float32)
    return rounded


def _header(arrays: dict[str, Any], path: str | os.PathLike[str]) -> dict[str, Any]:
    missing = {"header", *_PARTS} - arrays.keys()
    if missing:
        raise EnvError(f"{path}: not a ghost file, {', '.join(sorted(missing))} missing")
    try:
        header: dict[str, Any] = json.loads(str(arrays["header"]))
    except (ValueError, RecursionError) as error:
        raise EnvError(f"{path}: its header is not JSON ({error})") from error
    kinds = {"version": int, "env_id": str, "options": dict}
    for name, kind in kinds.items():
        if not isinstance(header, dict) or type(header.get(name)) is not kind:
            raise EnvError(
                f"{path}: its header must be a JSON object in which {name} is of type "
                f"{kind.__name__}; found {str(header)[:80]}"
            )
    if header["version"] != _VERSION:
        raise EnvError(f"{path}: layout version {header['version']}, this program reads {_VERSION}")
    return header


def _check_arrays(arrays: dict[str, Any]) -> None:
    """Raise ValueError where an array has other axes than its kind, or no finite numbers."""
    axes = {"start": 2, "moves": 2, "reward": 1, **dict.fromkeys(_EACH, 1)}
    for name in _PARTS:
        found = arrays[name]
        if found.dtype.kind not in "biuf" or not np.isfinite(found).all():
            raise ValueError(f"{name} holds {found.dtype} values, or not finite ones")
        if not found.ndim or found.ndim != axes.get(name, found.ndim):
            raise ValueError(f"{name} has the shape {found.shape}")
    count = len(arrays["steps"])
    if any(len(arrays[name]) != count for name in _EACH) or arrays["start"].shape != (4, count):
        raise ValueError(f"{count} episodes, but arrays of other lengths")
    if len(arrays["moves"]) != 4 or (count and arrays["steps"].min() < 0):
        raise ValueError("moves do not have four values, or an episode has negative steps")


def _drives(arrays: dict[str, Any]) -> list[Ghost]:
    """The ghosts in the arrays of a file."""
    steps = arrays["steps"].astype(np.int64)
    total = int(steps.sum())
    for name in ("moves", "action", "reward"):
        found = arrays[name].shape[1 if name == "moves" else 0]
        if found != total:
            raise ValueError(f"{name} of {found} steps, the episodes have {total}")
    ends = np.cumsum(steps)
    return [_drive(arrays, k, slice(end - steps[k], end)) for k, end in enumerate(ends)]


def _drive(arrays: dict[str, Any], k: int, span: slice) -> Ghost:
    start, moves = arrays["start"][:, k : k + 1], arrays["moves"][:, span]
    path = (np.cumsum(np.concatenate((start, moves), axis=1), axis=1).T / _UNITS).astype(np.float32)
    return Ghost(
        pose=path[:, :3],
        speed=path[:, 3],
        action=arrays["action"][span],
        reward=arrays["reward"][span],
        finish=bool(arrays["finish"][k]),
        crash=bool(arrays["crash"][k]),
        gates=int(arrays["gates"][k]),
        env_step=int(arrays["env_step"][k]),
        seed=int(arrays["seed"][k]),
    )


POSE = ("x", "y", "heading", "speed")


class GhostRecorder:
    """Collects the resets and steps of several environments into ghosts.

    env_id   gymnasium's identifier
    options  of the environments
    copies   number of environments
    """

    def __init__(self, env_id: str, options: Mapping[str, Any], copies: int = 1) -> None:
        self._env_id, self._options = env_id, dict(options)
        self._copies = [_Drive() for _ in range(copies)]
        self._ended: list[Ghost] = []

    def begin(self, copy: int, info: Mapping[str, Any], seed: int = -1) -> None:
        """Record a reset; the info, or any other mapping, holds the initial POSE."""
        self._copies[copy] = _Drive(info, seed)

    def add(
        self, copy: int, info: Mapping[str, Any], action: NDArray[Any] | float, reward: float
    ) -> None:
        """Record a step."""
        self._copies[copy].add(info, action, reward)

    def end(self, copy: int, env_step: int = 0) -> None:
        """Finish the episode of a copy, after `env_step` environment steps of the training."""
        self._ended.append(self._copies[copy].ghost(env_step))

    def take(self) -> Ghosts:
        """Ghosts of the episodes that ended since the last call, in that order."""
        ended, self._ended = self._ended, []
        return Ghosts(self._env_id, ended, self._options)


class _Drive:
    """An unfinished episode."""

    def __init__(self, info: Mapping[str, Any] | None = None, seed: int = -1) -> None:
        self._path = [] if info is None else [_pose(info)]
        self._actions: list[NDArray[Any]] = []
        self._rewards: list[float] = []
        self._last: Mapping[str, Any] = {}
        self._seed = seed

    def add(self, info: Mapping[str, Any], action: NDArray[Any] | float, reward: float) -> None:
        if not self._path:
            raise EnvError("a ghost needs the pose at reset: call begin before add")
        self._path.append(_pose(info))
        self._actions.append(np.array(action))
        self._rewards.append(reward)
        self._last = info

    def ghost(self, env_step: int) -> Ghost:
        path = np.array(self._path, np.float32)
        return Ghost(
            pose=path[:, :3],
            speed=path[:, 3],
            action=np.array(self._actions),
            reward=np.array(self._rewards, np.float32),
            finish=bool(self._last.get("finish", False)),
            crash=bool(self._last.get("crash", False)),
            gates=int(self._last.get("gates", 0)),
            env_step=env_step,
            seed=self._seed,
        )


def _pose(info: Mapping[str, Any]) -> tuple[float, ...]:
    try:
        return tuple(float(info[name]) for name in POSE)
    except KeyError as error:
        raise EnvError(f"a ghost needs {', '.join(POSE)} in the info; {error} is missing") from None
