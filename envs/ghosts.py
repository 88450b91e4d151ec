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
from spikedeploy.envs.rollout import Rollout
from spikedeploy.runtime.errors import EnvError

POSE = ("x", "y", "heading", "speed")
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
    def of(
        cls,
        path: Any,  # noqa: ANN401
        action: Any,  # noqa: ANN401
        reward: Any,  # noqa: ANN401
        last: Mapping[str, Any],
        **of: int,
    ) -> Ghost:
        """The ghost of a drive.

        path  (S + 1, 4) x, y, heading and speed
        last  info of the last step
        of    env_step and seed
        """
        path = np.asarray(path, np.float32)
        return cls(
            pose=path[:, :3],
            speed=path[:, 3],
            action=np.asarray(action),
            reward=np.asarray(reward, np.float32),
            finish=bool(last.get("finish", False)),
            crash=bool(last.get("crash", False)),
            gates=int(last.get("gates", 0)),
            **of,
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
        """A rollout as the only ghost; its infos must contain the poses."""
        if missing := set(POSE) - played.info.keys():
            raise EnvError(
                f"a rollout of {played.env_id} has no {', '.join(sorted(missing))} in its infos, "
                "so it leaves no ghost; only karts do"
            )
        poses = np.stack([played.info[name] for name in POSE], axis=1)
        last = {name: values[-1] for name, values in played.info.items()}
        # the pose before the first step is not recorded
        path = np.concatenate((poses[:1], poses))
        ghost = Ghost.of(path, played.action, played.reward, last, seed=played.seed)
        return cls(played.env_id, [ghost], played.options)

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
        # x, y, heading and speed (4, S + 1) in file units
        tables = (np.column_stack((ghost.pose, ghost.speed)) for ghost in self.drives)
        paths = [np.rint(table.astype(np.float64) * _UNITS).astype(np.int64).T for table in tables]
        actions = [ghost.action for ghost in self.drives] or [np.zeros(0, np.uint8)]
        action = np.concatenate(actions)
        each: dict[str, Any] = {
            name: np.array([getattr(ghost, name) for ghost in self.drives], kind)
            for name, kind in _EACH.items()
        }
        return {
            "header": np.array(json.dumps(header, default=str)),
            "start": _join([path[:, :1] for path in paths], (4, 0), np.int32),
            "moves": _join([np.diff(path) for path in paths], (4, 0), np.int32),
            "action": action.astype(np.uint8 if action.dtype.kind in "iu" else np.float32),
            "reward": _round(_join([g.reward for g in self.drives], (0,), np.float32)),
            **each,
        }


def _join(parts: list[Any], empty: tuple[int, ...], kind: type) -> NDArray[Any]:
    """Arrays joined along their last axis; an empty one if there are none."""
    return np.concatenate([np.zeros(empty), *parts], axis=-1).astype(kind)


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
    """Raise ValueError where arrays hold no finite numbers, or are not of the same episodes."""
    for name in _PARTS:
        found = arrays[name]
        if found.dtype.kind not in "biuf" or not np.isfinite(found).all():
            raise ValueError(f"{name} holds {found.dtype} values, or not finite ones")
    count = arrays["steps"].size
    if count and arrays["steps"].min() < 0:
        raise ValueError("an episode has negative steps")
    total = int(arrays["steps"].sum())
    shapes = {"start": (4, count), "moves": (4, total), "reward": (total,)}
    shapes |= dict.fromkeys(_EACH, (count,)) | {"action": (total, *arrays["action"].shape[1:])}
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} has shape {arrays[name].shape}, the episodes ask for {shape}")


def _drives(arrays: dict[str, Any]) -> list[Ghost]:
    found, end = [], 0
    for k, steps in enumerate(arrays["steps"].tolist()):
        span = slice(end, end := end + steps)
        units = np.concatenate((arrays["start"][:, k : k + 1], arrays["moves"][:, span]), axis=1)
        path = (np.cumsum(units, axis=1).T / _UNITS).astype(np.float32)
        last = {name: arrays[name][k] for name in ("finish", "crash", "gates")}
        of = {name: int(arrays[name][k]) for name in ("env_step", "seed")}
        found.append(Ghost.of(path, arrays["action"][span], arrays["reward"][span], last, **of))
    return found


class GhostRecorder:
    """Collects the resets and steps of several environments into ghosts.

    env_id   gymnasium's identifier
    options  of the environments
    copies   number of environments
    """

    def __init__(self, env_id: str, options: Mapping[str, Any], copies: int = 1) -> None:
        self._env_id, self._options = env_id, dict(options)
        self._copies: list[_Drive | None] = [None] * copies
        self._ended: list[Ghost] = []

    def begin(self, copy: int, info: Mapping[str, Any], seed: int = -1) -> None:
        """Record a reset; the info, or any other mapping, holds the initial POSE."""
        self._copies[copy] = _Drive(seed, [_pose(info)])

    def add(
        self, copy: int, info: Mapping[str, Any], action: NDArray[Any] | float, reward: float
    ) -> None:
        """Record a step."""
        drive = self._copies[copy]
        if drive is None:
            raise EnvError("a ghost needs the pose at reset: call begin before add")
        drive.path.append(_pose(info))
        drive.actions.append(np.array(action))
        drive.rewards.append(reward)
        drive.last = info

    def end(self, copy: int, env_step: int = 0) -> None:
        """Finish the episode of a copy, after `env_step` environment steps of the training."""
        drive, self._copies[copy] = self._copies[copy] or _Drive(-1), None
        made = (drive.path, drive.actions, drive.rewards, drive.last)
        self._ended.append(Ghost.of(*made, env_step=env_step, seed=drive.seed))

    def take(self) -> Ghosts:
        """Ghosts of the episodes that ended since the last call, in that order."""
        ended, self._ended = self._ended, []
        return Ghosts(self._env_id, ended, self._options)


@dataclass
class _Drive:
    """An unfinished episode."""

    seed: int
    path: list[tuple[float, ...]] = field(default_factory=list)
    actions: list[NDArray[Any]] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    last: Mapping[str, Any] = field(default_factory=dict)


def _pose(info: Mapping[str, Any]) -> tuple[float, ...]:
    try:
        return tuple(float(info[name]) for name in POSE)
    except KeyError as error:
        raise EnvError(f"a ghost needs {', '.join(POSE)} in the info; {error} is missing") from None
