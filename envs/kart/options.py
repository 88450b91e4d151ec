"""Options of the karts: their checks, and the objects that they name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.lidar import LidarOptions
from spikedeploy.envs.kart.observation import CLASSIC_RAYS
from spikedeploy.envs.kart.reward import ClassicReward, PathReward, Reward


def one_of(name: str, found: object, allowed: Sequence[object]) -> None:
    """Raise EnvError unless the value of an option is one of those allowed."""
    if found not in allowed:
        raise EnvError(f"{name} {found!r} is unknown; known: {', '.join(map(repr, allowed))}")


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
    if index.shape or index.dtype.kind not in "iu" or not 0 <= index < len(names):
        raise EnvError(
            f"action {action!r} is none of the {len(names)} of this kart: 0 to {len(names) - 1}, "
            f"{', '.join(names)}"
        )
    return names[int(index)]
