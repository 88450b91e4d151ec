"""Paired comparison: every row of a line-up plays the same seeds, in processes side by side."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

from spikedeploy import envs
from spikedeploy.comparison.comparison import Comparison, Row
from spikedeploy.comparison.episodes import Episode, EpisodeJob, play
from spikedeploy.comparison.lineup import Entry
from spikedeploy.console import progress
from spikedeploy.make_env import make_env
from spikedeploy.parallel import workers
from spikedeploy.policies.interface import FLOAT, check_fit
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import EVALUATION


def compare(
    env: str,
    entries: Sequence[Entry],
    seeds: Sequence[int],
    processes: int | None = None,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> Comparison:
    """Play every entry on every seed.

    env        short name or id of the environment
    entries    of spikedeploy.lineup; an entry's reference is an entry too
    seeds      (n,) from EVALUATION up, which no training sees
    processes  that play, one for each core by default
    options    of the environment
    """
    _check(env, options, entries, seeds)
    played: dict[Entry, list[Episode]] = {}
    with (
        TemporaryDirectory() as folder,
        workers(processes) as jobs,
        progress(f"{env}: {len(entries)} policies", len(entries) * len(seeds)) as done,
    ):
        plan = Plan(env, json.dumps(dict(options)), entries, seeds, Path(folder))
        for wave in plan.waves():
            episodes = jobs.run(play, [job for entry in wave for job in plan.jobs(entry)], done)
            for place, entry in enumerate(wave):
                played[entry] = episodes[place * len(seeds) : (place + 1) * len(seeds)]
    rows = [Row(entry, played[entry]) for entry in entries]
    return Comparison(envs.spec(env).id, seeds, rows)


@dataclass(frozen=True)
class Plan:
    """Which jobs a comparison needs, and in which order.

    env      short name or id
    options  of the environment, as JSON
    entries  all of them
    seeds    (n,)
    folder   where the rollouts lie that others are measured against
    """

    env: str
    options: str
    entries: Sequence[Entry]
    seeds: Sequence[int]
    folder: Path

    def waves(self) -> list[list[Entry]]:
        """The entries, references before those that refer to them."""
        ranks = range(1 + max(entry.rank for entry in self.entries))
        return [[entry for entry in self.entries if entry.rank == rank] for rank in ranks]

    def jobs(self, entry: Entry) -> list[EpisodeJob]:
        """An entry's jobs, one a seed."""
        referred = any(entry is other.reference for other in self.entries)
        return [
            EpisodeJob(
                env=self.env,
                options=self.options,
                candidate=entry.candidate,
                chip=entry.chip,
                seed=seed,
                others={other.label: self._rollout(other, seed) for other in entry.references},
                record=self._rollout(entry, seed) if referred else None,
            )
            for seed in self.seeds
        ]

    def _rollout(self, entry: Entry, seed: int) -> Path:
        return self.folder / f"{self.entries.index(entry)}-{seed}.npz"


def _check(
    env: str, options: Mapping[str, Any], entries: Sequence[Entry], seeds: Sequence[int]
) -> None:
    """Refuse training seeds, strangers' policies and unknown chips before anything is played."""
    if min(seeds) < EVALUATION:
        raise ConfigError(
            f"seed {min(seeds)} may have been trained on; evaluation starts at {EVALUATION}"
        )
    world = make_env(env, options)
    for entry in entries:
        check_fit(entry.candidate, world)
        if entry.chip not in (None, FLOAT):
            chip(entry.chip)  # refuses a name that it does not know
    world.close()
