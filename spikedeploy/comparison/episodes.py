"""One episode of a comparison as a job: a pure function of its specification."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium

from spikedeploy import envs
from spikedeploy.comparison.agreement import Agreement, agreement
from spikedeploy.comparison.metrics import asked, measure
from spikedeploy.envs.rollout import Rollout, rollout
from spikedeploy.make_env import make_env
from spikedeploy.policies.costs import Costs
from spikedeploy.policies.interface import Candidate, Player
from spikedeploy.policies.registry import open_policy, price
from spikedeploy.runtime.chips.damage import Damage

_KEPT = 16  # environments and players of a process, for the next episode


@dataclass(frozen=True)
class EpisodeJob:
    """An episode to play.

    env        short name or id
    options    of the environment, as JSON, which can be a cache key
    candidate  the policy
    chip       as in lineup.Entry
    seed       of the episode
    others     name -> file with the rollout of a reference on the same seed
    record     file for its own rollout, None for none
    metrics    of the step infos, `name:mean|last|max`
    """

    env: str
    options: str
    candidate: Candidate
    chip: str | None
    seed: int
    others: Mapping[str, Path]
    record: Path | None = None
    metrics: tuple[str, ...] = ()


@dataclass(frozen=True)
class Episode:
    """The numbers that are kept of an episode.

    total      return
    steps      control steps, S
    success    as the environment defines it; None where it does not
    metrics    of metrics.measure
    costs      per inference
    agreement  name -> agreement with each of the job's `others`
    remarks    of the compiler, on where a chip departs from the file
    damage     what faults of the chip hit
    measured   text of a metric that was asked for -> its value
    """

    total: float
    steps: int
    success: bool | None
    metrics: Mapping[str, float]
    costs: Costs
    agreement: Mapping[str, Agreement]
    remarks: Sequence[str] = ()
    damage: Sequence[Damage] = ()
    measured: Mapping[str, float] = field(default_factory=dict)


def play(job: EpisodeJob) -> Episode:
    """Play the job's episode and measure it."""
    player = _player(job.env, job.options, job.candidate, job.chip)
    played = rollout(_environment(job.env, job.options), player, job.seed)
    if job.record:
        played.save(job.record)
    others = {name: Rollout.load(path) for name, path in job.others.items()}
    foreign = envs.spec(job.env).foreign
    return summarise(job.candidate, player, played, others, job.metrics, foreign)


def summarise(
    candidate: Candidate,
    player: Player,
    played: Rollout,
    others: Mapping[str, Rollout] = MappingProxyType({}),
    metrics: Sequence[str] = (),
    foreign: bool = False,
) -> Episode:
    """The summary of a rollout that the player has just played.

    metrics  that are asked for, of any environment
    foreign  whether the environment is not ours, so that its infos mean nothing to us
    """
    damage = getattr(player, "damage", ())  # first, like costs: agreement runs the player again
    return Episode(
        total=played.total,
        steps=played.steps,
        success=played.success,
        metrics={} if foreign else measure(played.info),
        costs=price(candidate, player, played),  # first: agreement runs the player again
        agreement={name: agreement(player, played, other) for name, other in others.items()},
        remarks=getattr(player, "remarks", ()),
        damage=damage,
        measured=asked(played.info, metrics),
    )


def foreign_period(env: str, options: str) -> float | None:
    """Time of a control step [s] of an environment that is not ours, where it says so."""
    if not envs.spec(env).foreign:
        return None
    world: Any = _environment(env, options).unwrapped
    period: float | None = world.CONTROL_DT
    return period


@lru_cache(_KEPT)
def _environment(name: str, options: str) -> gymnasium.Env[Any, Any]:
    return make_env(name, json.loads(options))


@lru_cache(_KEPT)
def _player(env: str, options: str, candidate: Candidate, chip: str | None) -> Player:
    return open_policy(candidate, chip, _environment(env, options))
