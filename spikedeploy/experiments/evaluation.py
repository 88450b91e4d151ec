"""Greedy episodes of one policy, or of a player that is built in, on seeds that no training saw."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spikedeploy.comparison.lineup import Entry
from spikedeploy.comparison.rounds import compare
from spikedeploy.files import as_text, write_text
from spikedeploy.policies.interface import FLOAT
from spikedeploy.policies.registry import find
from spikedeploy.seeds import EVALUATION

Rows = list[dict[str, Any]]


def drive(
    env: str, options: Mapping[str, Any], policy: str, episodes: int, chip: str | None
) -> Rows:
    """Rows of a report: the policy, or if it spikes its float twin and then itself on the chip."""
    candidate = find(policy)
    entries = [Entry(candidate)]
    if candidate.kind == "snn":
        twin = Entry(candidate, FLOAT)
        entries = [twin, Entry(candidate, chip, twin)]
    seeds = range(EVALUATION, EVALUATION + episodes)
    return compare(env, entries, seeds, processes=1, options=options).as_json()


@dataclass(frozen=True)
class Drive:
    """A player that is built in, evaluated in an environment.

    env       short name
    policy    "random" or "gap"
    folder    where <env>-<policy>.json is written
    episodes  as in Trial
    """

    env: str
    policy: str
    folder: str
    episodes: int

    @property
    def name(self) -> str:
        """`kart-grid-gap`."""
        return f"{self.env}-{self.policy}"

    @property
    def file(self) -> Path:
        """What it leaves behind."""
        return Path(self.folder) / f"{self.name}.json"

    @property
    def evaluation(self) -> dict[str, Any] | None:
        """What evaluating it found; None where that is missing, or of other episodes."""
        if not self.file.is_file():
            return None
        found: dict[str, Any] = json.loads(self.file.read_text(encoding="utf-8"))
        return found if found["of"] == {"episodes": self.episodes} else None

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""
        return self.evaluation is not None

    def arguments(self) -> dict[str, Any]:
        """Itself as the arguments of `perform`."""
        return asdict(self)


def perform(**arguments: Any) -> bool:  # noqa: ANN401
    """Evaluate the built-in player with these fields."""
    job = Drive(**arguments)
    rows = drive(job.env, {}, job.policy, job.episodes, None)
    write_text(job.file, as_text({"of": {"episodes": job.episodes}, "rows": rows}))
    return True
