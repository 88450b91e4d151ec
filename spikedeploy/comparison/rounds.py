"""Every entry of a line-up on the same seeds, in parallel, references before their dependants."""

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
from spikedeploy.make_env import disturbed_by, make_env
from spikedeploy.parallel import workers
from spikedeploy.policies.interface import FLOAT, check_fit
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import EVALUATION


def compare_policies(
    env: str,
    entries: Sequence[Entry],
    seeds: Sequence[int],
    processes: int | None = None,
    options: Mapping[str, Any] = MappingProxyType({}),
    metrics: Sequence[str] = (),
) -> Comparison:
    """Play every entry on every seed.

    env        short name or id of the environment
    entries    of lineup.line_up; the reference of an entry is an entry too
    seeds      (n,) from EVALUATION up, which no training uses
    processes  one for each core by default
    options    of the environment
    metrics    of its step infos, `name:mean|last|max`
    """
    period = _check(env, options, entries, seeds)
    played: dict[Entry, list[Episode]] = {}
    with (
        TemporaryDirectory() as folder,
        workers(processes) as jobs,
        progress(f"{env}: {len(entries)} policies", len(entries) * len(seeds)) as done,
    ):
        plan = _Plan(env, json.dumps(dict(options)), entries, seeds, Path(folder), tuple(metrics))
        for group in plan.rounds():
            episodes = jobs.run(play, [job for entry in group for job in plan.jobs(entry)], done)
            for place, entry in enumerate(group):
                played[entry] = episodes[place * len(seeds) : (place + 1) * len(seeds)]
    rows = [Row(entry, played[entry]) for entry in entries]
    spec, disturb = envs.spec(env), disturbed_by(options)
    return Comparison(spec.id, seeds, rows, (), disturb, spec.foreign, period)


@dataclass(frozen=True)
class _Plan:
    """The jobs of a comparison, in rounds.

    env      short name or id
    options  of the environment, as JSON
    seeds    (n,)
    folder   for the rollouts of entries that are references
    metrics  of the step infos
    """

    env: str
    options: str
    entries: Sequence[Entry]
    seeds: Sequence[int]
    folder: Path
    metrics: tuple[str, ...] = ()

    def rounds(self) -> list[list[Entry]]:
        """The entries, references before those that refer to them."""
        ranks = range(1 + max(entry.rank for entry in self.entries))
        return [[entry for entry in self.entries if entry.rank == rank] for rank in ranks]

    def jobs(self, entry: Entry) -> list[EpisodeJob]:
        """The jobs of an entry, one for each seed."""
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
                metrics=self.metrics,
            )
            for seed in self.seeds
        ]

    def _rollout(self, entry: Entry, seed: int) -> Path:
        return self.folder / f"{self.entries.index(entry)}-{seed}.npz"


def _check(
    env: str, options: Mapping[str, Any], entries: Sequence[Entry], seeds: Sequence[int]
) -> float | None:
    """Refuse training seeds, policies of other environments and unknown chips at once.

    Return the time of a control step [s] of an environment that is not ours, where it says so.
    """
    if min(seeds) < EVALUATION:
        raise ConfigError(
            f"seed {min(seeds)} may have been trained on; evaluation starts at {EVALUATION}"
        )
    world: Any = make_env(env, options)
    for entry in entries:
        check_fit(entry.candidate, world)
        if entry.chip not in (None, FLOAT):
            chip(entry.chip)  # raises on an unknown name
    period: float | None = world.unwrapped.CONTROL_DT if envs.spec(env).foreign else None
    world.close()
    return period
