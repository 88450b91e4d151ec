"""Episodes of a comparison: played as jobs, summarised, and compared action by action."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.comparison.episode_metrics import measure, measure_named
from spikedeploy.envs.rollout import Rollout, rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.registry import Candidate, Controller, Entry, open_policy
from spikedeploy.runtime.chips.damage import Damage

if TYPE_CHECKING:
    from spikedeploy.policies.costs import Costs

_TOLERANCE = 0.01  # of an action in [-1, 1]: far below the resolution of a servo


@dataclass(frozen=True)
class Agreement:
    """Agreement of two episodes of the same seed.

    squared_error: sum over control steps and actions of the squared difference, both policies on
        the observations that the *other* recorded, so that trajectories which drift apart do not
        count
    actions: terms in that sum
    first_divergence: first control step at which the two closed loops act differently by more than
        _TOLERANCE, or at which only one of them still acts; None if that never happens
    equal: equal choices of one action of several, where a squared error has no meaning; None where
        actions are numbers
    """

    squared_error: float
    actions: int
    first_divergence: int | None
    equal: int | None = None


def agreement(controller: Controller, played: Rollout, other: Rollout) -> Agreement:
    """Compare the controller, which acted in `played`, with the policy of the other rollout."""
    controller.reset(other.seed)
    error = controller.replay(other.observation[:-1]) - other.action
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


_KEPT = 16  # environments and controllers of a process, for the next episode


@dataclass(frozen=True)
class EpisodeJob:
    """An episode to play.

    env: short name or id
    entry: policy, chip and setup
    seed: seed of the episode
    others: name -> file with the rollout of a reference on the same seed
    record: file for its own rollout, None for none
    """

    env: str
    entry: Entry
    seed: int
    others: Mapping[str, Path] = field(default_factory=dict)
    record: Path | None = None


@dataclass(frozen=True)
class Episode:
    """The numbers that are kept of an episode.

    total: return
    steps: control steps, S
    success: as the environment defines it; None where it does not
    failed: whether it ended without success before its time limit, by Rollout.failed
    metrics: as episode_metrics.measure returns them
    costs: per inference
    agreement: name -> agreement with each of the job's `others`
    remarks: remarks of the compiler, on where a chip departs from the file
    damage: what faults of the chip hit
    measured: text of a metric that was asked for -> its value
    """

    total: float
    steps: int
    success: bool | None
    failed: bool | None
    metrics: Mapping[str, float]
    costs: "Costs"
    agreement: Mapping[str, Agreement]
    remarks: Sequence[str] = ()
    damage: Sequence[Damage] = ()
    measured: Mapping[str, float] = field(default_factory=dict)


def play(job: EpisodeJob) -> Episode:
    """Play the job's episode and measure it."""
    entry, setup = job.entry, job.entry.setup
    controller = _controller(job.env, setup, entry.candidate, entry.chip)
    played = rollout(_environment(job.env, setup), controller, job.seed)
    if job.record:
        played.save(job.record)
    others = {name: Rollout.load(path) for name, path in job.others.items()}
    return summarise(controller, played, others, setup.metric, envs.spec(job.env).foreign)


def summarise(
    controller: Controller,
    played: Rollout,
    others: Mapping[str, Rollout] = MappingProxyType({}),
    metrics: Sequence[str] = (),
    foreign: bool = False,
) -> Episode:
    """Summarise a rollout that the controller has just played.

    metrics: those of --metric, for any environment
    foreign: whether the environment is of another package, whose infos have no metrics here
    """
    # first: agreement runs the controller again
    damage, costs = controller.damage, controller.costs(played)
    return Episode(
        total=played.total,
        steps=played.steps,
        success=played.success,
        failed=played.failed,
        metrics={} if foreign else measure(played.info),
        costs=costs,
        agreement={name: agreement(controller, played, other) for name, other in others.items()},
        remarks=controller.remarks,
        damage=damage,
        measured=measure_named(played.info, metrics),
    )


def period_of(env: str, setup: Setup) -> float | None:
    """Time of a control step [s]; None where it is not known."""
    world: Any = _environment(env, setup).unwrapped
    return getattr(world, "CONTROL_DT", None)


@lru_cache(_KEPT)
def _environment(name: str, setup: Setup) -> gymnasium.Env[Any, Any]:
    return envs.make(name, **setup.options())


@lru_cache(_KEPT)
def _controller(env: str, setup: Setup, candidate: Candidate, chip: str | None) -> Controller:
    return open_policy(candidate, chip, _environment(env, setup), setup)
