"""How far two policies agree: on the same observations, and each in its own closed loop."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies.interface import Player

_TOLERANCE = 0.01  # of an action in [-1, 1]: far below the resolution of a servo


@dataclass(frozen=True)
class Agreement:
    """Agreement of two episodes of the same seed.

    squared_error     sum over control steps and actions of the squared difference, both policies
                      on the observations that the *other* recorded, so that trajectories which
                      drift apart do not count
    actions           terms in that sum
    first_divergence  first control step at which the two closed loops act differently by more than
                      TOLERANCE, or at which only one of them still acts; None if that never happens
    equal             equal choices of one action of several, where a squared error has no meaning;
                      None where actions are numbers
    """

    squared_error: float
    actions: int
    first_divergence: int | None
    equal: int | None = None


def agreement(player: Player, played: Rollout, other: Rollout) -> Agreement:
    """The player, which acted in `played`, against the policy of the other rollout."""
    player.reset(other.seed)
    error = player.replay(other.observation[:-1]) - other.action
    return Agreement(
        squared_error=float(np.square(error).sum()),
        actions=error.size,
        first_divergence=first_divergence(played.action, other.action),
        equal=int(np.count_nonzero(error == 0)) if error.ndim == 1 else None,
    )


def first_divergence(left: NDArray[np.float64], right: NDArray[np.float64]) -> int | None:
    """First step at which actions (S, act) or (S,) differ by more than TOLERANCE, or None."""
    shared = min(len(left), len(right))
    apart = np.abs(left[:shared] - right[:shared]).reshape(shared, -1)
    differs = apart.max(axis=1) > _TOLERANCE
    if differs.any():
        return int(differs.argmax())
    return shared if len(left) != len(right) else None


def pooled_rmse(agreements: Sequence[Agreement]) -> float | None:
    """The root of the mean squared action difference over all episodes; None for choices."""
    if any(each.equal is not None for each in agreements):
        return None
    total = sum(each.squared_error for each in agreements)
    return float(np.sqrt(total / sum(each.actions for each in agreements)))


def pooled_equality(agreements: Sequence[Agreement]) -> float | None:
    """The share of equal choices over all episodes; None where actions are numbers."""
    equal = [each.equal for each in agreements if each.equal is not None]
    return sum(equal) / sum(each.actions for each in agreements) if equal else None


def median_divergence(agreements: Sequence[Agreement]) -> float | None:
    """The median first divergence; None where at least half of the episodes never diverge."""
    steps = [np.inf if e.first_divergence is None else e.first_divergence for e in agreements]
    median = float(np.median(steps))
    return median if np.isfinite(median) else None
