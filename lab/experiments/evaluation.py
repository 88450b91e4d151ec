"""Greedy evaluation episodes of a policy file or a built-in policy."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.comparison.lineup import alone
from spikedeploy.files import as_text, read_json, write_text
from spikedeploy.policies.registry import find
from spikedeploy.seeds import EVALUATION

Rows = list[dict[str, Any]]


def evaluate(
    env: str, options: Mapping[str, Any], policy: str, episodes: int, chip: str | None
) -> Rows:
    """Rows of a report: the policy; if it spikes, its float twin and the chip."""
    entries, seeds = alone(find(policy), chip), range(EVALUATION, EVALUATION + episodes)
    return compare_policies(env, entries, seeds, processes=1, options=options).as_json()


@dataclass(frozen=True)
class BuiltInEvaluation:
    """The evaluation of a built-in policy in an environment.

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
        """The file with the result."""
        return Path(self.folder) / f"{self.name}.json"

    @property
    def evaluation(self) -> dict[str, Any] | None:
        """The result; None where it is missing, or has another number of episodes."""
        if not self.file.is_file():
            return None
        found = read_json(self.file)
        return found if found.get("of") == {"episodes": self.episodes} else None

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""
        return self.evaluation is not None

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of `perform`."""
        return asdict(self)


def perform(**arguments: Any) -> bool:  # noqa: ANN401
    """Evaluate the built-in policy with these fields."""
    job = BuiltInEvaluation(**arguments)
    rows = evaluate(job.env, {}, job.policy, job.episodes, None)
    write_text(job.file, as_text({"of": {"episodes": job.episodes}, "rows": rows}))
    return True
