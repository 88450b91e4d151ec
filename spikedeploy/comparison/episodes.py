"""One episode of one row of a comparison, as a job: a pure function of its specification."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium

from spikedeploy.comparison.agreement import Agreement, agreement
from spikedeploy.comparison.metrics import measure
from spikedeploy.envs.rollout import Rollout, rollout
from spikedeploy.make_env import make_env
from spikedeploy.policies.costs import Costs
from spikedeploy.policies.interface import Candidate, Player
from spikedeploy.policies.registry import open_policy, price


@dataclass(frozen=True)
class EpisodeJob:
    """An episode to play.

    env        short name or id
    options    of the environment, as JSON, so that jobs can be told apart
    candidate  the policy
    chip       as in lineup.Entry
    seed       of the episode
    others     name -> file with the rollout of the same seed that it is measured against
    record     where its own rollout is kept, None for nowhere
    """

    env: str
    options: str
    candidate: Candidate
    chip: str | None
    seed: int
    others: Mapping[str, Path]
    record: Path | None = None


@dataclass(frozen=True)
class Episode:
    """What is kept of an episode: numbers, so that thousands fit in memory.

    total      return
    steps      control steps, S
    success    as the environment says
    metrics    of spikedeploy.metrics
    costs      per inference
    agreement  name -> with each of the job's `others`
    remarks    on what a chip does otherwise than the file says
    """

    total: float
    steps: int
    success: bool
    metrics: Mapping[str, float]
    costs: Costs
    agreement: Mapping[str, Agreement]
    remarks: Sequence[str] = ()


def play(job: EpisodeJob) -> Episode:
    """Play the job's episode and measure it."""
    player = _player(job.env, job.options, job.candidate, job.chip)
    played = rollout(_environment(job.env, job.options), player, job.seed)
    if job.record:
        played.save(job.record)
    others = {name: Rollout.load(path) for name, path in job.others.items()}
    return summarise(job.candidate, player, played, others)


def summarise(
    candidate: Candidate,
    player: Player,
    played: Rollout,
    others: Mapping[str, Rollout] = MappingProxyType({}),
) -> Episode:
    """What is kept of a rollout that the player has just played."""
    return Episode(
        total=played.total,
        steps=played.steps,
        success=played.success,
        metrics=measure(played.info),
        costs=price(candidate, player, played),  # first: agreement asks the player anew
        agreement={name: agreement(player, played, other) for name, other in others.items()},
        remarks=getattr(player, "remarks", ()),
    )


@cache
def _environment(name: str, options: str) -> gymnasium.Env[Any, Any]:
    return make_env(name, json.loads(options))


@cache
def _player(env: str, options: str, candidate: Candidate, chip: str | None) -> Player:
    return open_policy(candidate, chip, _environment(env, options))
