"""Rows of one part of the robustness experiment: each policy in each condition, in batches.

Each row is a file of its own, <runs>/<condition>/<policy>.json, which says what it was made with: a
stopped experiment goes on after the last row, and a row whose policy, level or sizes have changed
is made again. All policies of a part share the copies of the environment.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lab.experiments.robustness.design import (
    DISTURBANCE,
    FAULT,
    Condition,
    RobustnessDesign,
)
from lab.experiments.robustness.lineup import Tested
from lab.experiments.stored_row import StoredRow
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.damage import Damage, summed
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.faults import NONE, Faults, faults
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.sparse.pool import BatchController, Episodes, Stateless

Record = dict[str, Any]
_VERSION = 1  # of what a row holds; a higher one makes all rows again


def stored(design: RobustnessDesign, condition: Condition, tested: Tested) -> StoredRow:
    """The row of a policy in a condition."""
    made = {
        "env": design.env,
        "policy": tested.digest,
        "chip": tested.chip,
        "condition": condition.text,
        "number": condition.number,
        "episodes": design.episodes,
        "specimens": design.specimens if condition.part == FAULT else None,
        "first_seed": EVALUATION,
        "limit": design.limit,
        "version": _VERSION,
        **({"options": dict(design.options)} if design.options else {}),
    }
    folder = Path(design.runs) / condition.text.replace(":", "-")
    name = f"{tested.candidate.name}{f'@{tested.chip}' if tested.chip else ''}.json"
    return StoredRow(folder / name.replace(":", "-"), made)


def missing(design: RobustnessDesign, part: str) -> bool:
    """Whether a row of a part is missing."""
    return any(
        stored(design, condition, tested).found is None
        for condition in design.conditions(part)
        for tested in design.tested(part)
    )


def all_rows(design: RobustnessDesign) -> Iterator[Record]:
    """The results so far, part by part."""
    for part in design.parts:
        for condition in design.conditions(part):
            for tested in design.tested(part):
                found = stored(design, condition, tested).found
                if found is not None:
                    yield found


def perform(design: Record, parts: Sequence[str]) -> bool:
    """Make the missing rows of some parts (a job of `resumable`)."""
    asked = RobustnessDesign(**design)
    for part in parts:
        _complete(asked, part)
    return True


def _complete(asked: RobustnessDesign, part: str) -> None:
    episodes: Episodes | None = None
    for condition in asked.conditions(part):
        if condition.part == DISTURBANCE:
            episodes = None  # each level is another world
        for tested in asked.tested(part):
            row = stored(asked, condition, tested)
            if row.found is None:
                episodes = episodes or _episodes(asked, condition)
                row.write(_evaluated(asked, condition, tested, episodes))


def _episodes(design: RobustnessDesign, condition: Condition) -> Episodes:
    disturb = [condition.text] if condition.part == DISTURBANCE else []
    options = {**design.options, **({"disturb": disturb} if disturb else {})}
    config = EnvConfig(name=design.env, options=options, count=design.episodes)
    return Episodes(config, design.episodes, design.limit)


def _evaluated(
    design: RobustnessDesign, condition: Condition, tested: Tested, episodes: Episodes
) -> Record:
    """What the policy earns, episode by episode, and what faults of the chip hit."""
    seeds = range(EVALUATION, EVALUATION + design.episodes)
    returns, successes = np.zeros(design.episodes), np.zeros(design.episodes, np.bool_)
    known = True  # whether the environment says what a success is
    damages: list[Sequence[Damage]] = []
    groups = groups_of(design, condition)
    for specimen in range(max(groups) + 1 if condition.part == FAULT else 1):
        places = [
            k for k, group in enumerate(groups) if condition.part != FAULT or group == specimen
        ]
        broken = faults([condition.text], specimen) if condition.part == FAULT else NONE
        player = _Player(tested, broken, [seeds[k] for k in places])
        _, earned, infos = episodes.play([seeds[k] for k in places], player.controller)
        returns[places] = earned
        successes[places] = [bool(info.get("success", False)) for info in infos]
        known = known and all("success" in info for info in infos)
        damages.append(player.damage)
    return {
        "env": design.env,
        "policy": tested.label,
        "kind": tested.candidate.kind,
        "chip": tested.chip,
        "part": condition.part,
        "name": condition.name,
        "level": condition.level,
        "number": condition.number,
        "unit": condition.unit,
        "episodes": design.episodes,
        "return_mean": float(returns.mean()),
        "success_rate": float(successes.mean()) if known else None,
        **_hits(damages),
        "groups": groups,
        "returns": returns.tolist(),
        "successes": successes.astype(int).tolist() if known else None,
    }


def groups_of(design: RobustnessDesign, condition: Condition) -> list[int]:
    """What an interval resamples together (n,): the specimen of each episode, else each alone."""
    if condition.part == FAULT:
        return [k % design.specimens for k in range(design.episodes)]
    return list(range(design.episodes))


def _hits(damages: Sequence[Sequence[Damage]]) -> Record:
    """Parts of all specimens together, or what happened in all episodes."""
    found = summed([each for each in damages if each])
    return {"hit": found[0].hit, "of": found[0].of, "what": found[0].what} if found else {}


class _Player:
    """A policy for a batch of robots.

    controller  of the batch
    """

    def __init__(self, tested: Tested, broken: Faults, seeds: Sequence[int]) -> None:
        self._spiking: SpikingController | None = None
        path = tested.candidate.path
        if tested.chip is None:
            self.controller: BatchController = Stateless(OnnxController(path).replay)
            return
        self._spiking = SpikingController(load(path), chip(tested.chip), "none", faults=broken)
        self.controller = _BatchOnChip(self._spiking, seeds)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What faults hit."""
        return self._spiking.damage if self._spiking is not None else ()


class _BatchOnChip:
    """A spiking policy as a BatchController whose robots have upsets of their own."""

    def __init__(self, spiking: SpikingController, seeds: Sequence[int]) -> None:
        self._spiking, self._seeds = spiking, seeds
        self.act_batch = spiking.act_batch

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._spiking.reset(0, each=self._seeds)
