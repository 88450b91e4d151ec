"""Options of the karts: their checks, and the objects that they name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.corridor import corridor, length_of
from spikedeploy.envs.kart.lidar import LidarOptions
from spikedeploy.envs.kart.observation import CLASSIC_RAYS
from spikedeploy.envs.kart.reward import ClassicReward, PathReward, Reward
from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.kart.track_file import load


def one_of(name: str, found: object, allowed: Sequence[object]) -> None:
    """Raise EnvError unless the value of an option is one of those allowed."""
    if found not in allowed:
        raise EnvError(f"{name} {found!r} is unknown; known: {', '.join(map(repr, allowed))}")


def steps_of(found: object) -> None:
    """Raise EnvError unless the value of max_steps is a whole number from 1."""
    if not isinstance(found, int) or found < 1:
        raise EnvError(f"max_steps must be a whole number from 1, found {found!r}")


def part(name: str, found: object) -> float:
    """The value of an option above 0 and up to 1; EnvError if it is another."""
    number = isinstance(found, (int, float)) and not isinstance(found, bool)
    if not number or not 0.0 < found <= 1.0:  # type: ignore[operator]
        raise EnvError(f"option {name}: {found!r} is not a number above 0 and up to 1")
    return float(found)  # type: ignore[arg-type]


def track_of(track: str | Path | Track) -> Track:
    """The track of this name, file or kind; of corridors, which are drawn anew, any one."""
    if isinstance(track, Track):
        return track
    cells = length_of(track) if isinstance(track, str) else None
    return load(track) if cells is None else corridor(cells, np.random.default_rng(0))


def lidar_options(
    given: LidarOptions | Mapping[str, Any] | None, reach: float, classic: bool
) -> LidarOptions:
    """The given options, over those of the preset and the environment's range `reach` [px]."""
    if isinstance(given, LidarOptions):
        return given
    defaults: dict[str, Any] = {"range": reach}
    if classic:
        # kart-simulator's rays begin straight behind the kart, and none points ahead
        defaults |= {"count": CLASSIC_RAYS, "facing": -math.pi}
    return LidarOptions.of(given or {}, **defaults)


def reward_of(reward: str | Mapping[str, float], classic: ClassicReward) -> Reward:
    """The reward of this name, or with these weights; `classic` is the environment's own."""
    if isinstance(reward, Mapping):
        return PathReward(reward)
    one_of("reward", reward, ("default", "classic"))
    return classic if reward == "classic" else PathReward()


def action_name(action: Any, names: Sequence[str]) -> str:  # noqa: ANN401
    """Name of a discrete action; EnvError if there is no such action."""
    index = np.asarray(action)
    whole = not index.shape and index.dtype.kind in "iu"
    if not whole or not 0 <= (place := int(index)) < len(names):
        raise EnvError(
            f"action {action!r} is none of the {len(names)} of this kart: 0 to {len(names) - 1}, "
            f"{', '.join(names)}"
        )
    return names[place]
