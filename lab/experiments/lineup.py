"""The lineup experiment: shipped policies that were distilled, trained again with other seeds.

A comparison's rows are of one training each. Here every shipped policy that was distilled from a
float teacher is trained with more seeds, by the recipe and the settings of its card; the seed of
the card is the shipped file itself. Each row is a file, <runs>/evaluations/<member>.json, that says
what it was made with; rows of trainings that are not here are kept as they are in the table.
"""

import csv
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lab.experiments import QUICK, pages
from lab.experiments.fronts import read_table as read_pareto
from lab.experiments.networks import evaluate
from lab.experiments.pages import grouped, mean, percent, releases, versions_at_start, versions_text
from lab.experiments.runner import Design, Part, command_line
from lab.experiments.training import NUMBER, Record, StoredRow, TrainingJob, read_rows
from spikedeploy import zoo
from spikedeploy.comparison.statistics import nested_ratio, stratified_bootstrap, t_interval
from spikedeploy.reports.table import write_rows
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_json
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.trainers.recipes import RECIPES

TABLE = "lineup.csv"
_NARROW = "-256"  # ending of a PopSAN with half the neurons in each layer, which is not shipped
_FIELDS = (
    "chip", "episodes", "return_mean", "success_rate", "falls", "cot", "speed_rmse",
    "turn_rmse", "sops_per_inference", "macs_dense", "macs_effective",
)  # fmt: skip
_COLUMNS = (
    "env", "policy", "seed", "shipped", "kind", "chip", "episodes", "return_mean", "success_rate",
    "falls", "cot", "speed_rmse", "turn_rmse", "sops_per_inference", "macs_dense",
    "macs_effective", "quick", "versions", "returns", "successes",
)  # fmt: skip
_FORM = {
    **dict.fromkeys(("env", "policy", "kind"), str),
    "episodes": int,
    "returns": [NUMBER],
    "successes": [int],
}
_TEXT = ("env", "policy", "shipped", "kind", "chip", "quick", "versions")


@dataclass(frozen=True)
class Member:
    """A policy with a seed: the shipped one, or one that is trained as it was.

    env       short name of the environment
    policy    name of the shipped policy, or of the narrower one like it
    seed      of the training
    training  None for the shipped file, which is not trained again
    """

    env: str
    policy: str
    seed: int
    training: TrainingJob | None

    @property
    def name(self) -> str:
        """`hexapod-command-mlp-16-s1`."""
        return f"{self.env}-{self.policy}-s{self.seed}"

    @property
    def key(self) -> tuple[str, str, int]:
        """Environment, policy and seed: what tells rows apart."""
        return self.env, self.policy, self.seed

    @property
    def like(self) -> str:
        """`hexapod/popsan`: the shipped policy that this is, or is trained like."""
        return f"{self.env}/{self.policy.removesuffix(_NARROW)}"

    @property
    def shipped(self) -> Path:
        """The file of the shipped policy."""
        file = zoo.path(self.like)
        if file is None:
            raise ConfigError(f"no policy {self.like} is shipped")
        return file


@dataclass(frozen=True)
class LineupDesign(Design):
    """The parts of the experiment.

    seeds  trainings of each policy, the shipped one among them
    tasks  short names of environments
    """

    seeds: int = 5
    tasks: Sequence[str] = ("hexapod", "hexapod-command")

    NAME = "lineup"
    OPTIONS: ClassVar = {name: name for name in ("seeds", "runs", "episodes", "chip", "quick")} | {
        "env": "tasks"
    }
    QUICK: ClassVar = {"seeds": 2, "episodes": 2}

    def __post_init__(self) -> None:
        for env in self.tasks:
            if not _distilled(env):
                raise ConfigError(f"no policy that was distilled is shipped for {env!r}")
        super().__post_init__()

    def members(self) -> list[Member]:
        """All policies of all tasks: the shipped ones and their teachers, then seed by seed."""
        found = []
        for env in self.tasks:
            cards = _distilled(env)
            teachers = dict.fromkeys(_teacher(card).partition("/")[2] for card in cards.values())
            found += [Member(env, name, 0, None) for name in teachers]
            found += [Member(env, name, card["seed"], None) for name, card in cards.items()]
            found += list(self._others(env, cards))
        return found

    def _others(self, env: str, cards: Mapping[str, Mapping[str, Any]]) -> Iterator[Member]:
        for seed in range(self.seeds):
            for name, card in cards.items():
                if seed != card["seed"]:
                    yield Member(env, name, seed, self._training(env, name, card, seed))
                if (narrow := f"{card['recipe']}{_NARROW}") in RECIPES:
                    own = self._training(env, f"{name}{_NARROW}", {**card, "recipe": narrow}, seed)
                    yield Member(env, f"{name}{_NARROW}", seed, own)

    def _training(self, env: str, name: str, card: Mapping[str, Any], seed: int) -> TrainingJob:
        own = [each for each in card["overrides"] if not each.startswith("teacher=")]
        settings = (
            f"env.name={json.dumps(env)}",
            *own,
            f"teacher={json.dumps(_teacher(card))}",
            *(QUICK["distill"] if self.quick else ()),
        )
        return TrainingJob(
            f"{env}-{name}-s{seed}", card["recipe"], seed, self.runs, settings, telling=settings
        )

    def trainings(self) -> list[TrainingJob]:
        """All trainings."""
        return [member.training for member in self.members() if member.training is not None]

    def check(self, results: Path) -> None:
        """Refuse unknown settings, and a table that the rows cannot stand in."""
        super().check(results)
        self.read_kept(results / TABLE)

    def parts(self) -> list[Part]:
        """Each policy with a seed: its training and its evaluation."""
        return [
            Part(member.name, partial(self._rows, member), member.training)
            for member in self.members()
        ]

    # rows

    def _rows(self, member: Member) -> list[StoredRow]:
        """The row of a policy that is there."""
        weights = member.training.checkpoint() if member.training else member.shipped
        made = {"policy": zoo.sha256(weights), "episodes": self.episodes, "chip": self.chip}
        file = Path(self.runs) / "evaluations" / f"{member.name}.json"
        return [StoredRow(file, made, partial(self._evaluate, member), form=_FORM)]

    def _evaluate(self, member: Member) -> Record:
        file = str(member.shipped)
        if member.training is not None:
            file = runnable(str(member.training.existing_run))
        *_, row = evaluate(member.env, {}, file, self.episodes, self.chip)
        about = {"env": member.env, "policy": member.policy, "seed": member.seed}
        about |= {"shipped": member.training is None, "kind": zoo.card(member.like)["kind"]}
        numbers = {name: row[name] for name in _FIELDS if row.get(name) is not None}
        successes = [int(each) for each in row["successes"]]
        return about | numbers | {"returns": row["returns"], "successes": successes}

    def all_rows(self) -> Iterator[Record]:
        """The results so far."""
        for member, part in zip(self.members(), self.parts(), strict=True):
            for row in part.found:
                versions = zoo.card(member.like)["versions"]
                if member.training is not None:
                    versions = read_json(member.training.existing_run / "versions.json")
                yield row | {"versions": versions_text(versions)}

    def read_kept(self, table: Path) -> list[Record]:
        """The rows of the table so far; ConfigError where they cannot stand beside its own.

        That is where they have other episodes, another chip, or quick trainings.
        """
        rows = read_table(table) if table.is_file() else []
        for row in rows:
            alike = row["episodes"] == self.episodes and bool(row["quick"]) == self.quick
            if not alike or row["chip"] not in (None, self.chip):
                raise ConfigError(
                    f"{table} has rows of {row['episodes']} episodes"
                    f"{', of quick trainings' if row['quick'] else ''}"
                    f"{', on ' + row['chip'] if row['chip'] else ''}: name another folder with -o"
                )
        return rows

    def write(self, results: Path) -> list[Path]:
        """Write page and table of the complete rows; return the files, the page first."""
        table = results / TABLE
        new, old = list(self.all_rows()), self.read_kept(table)
        here = {key(row) for row in new}
        rows = [*new, *(row for row in old if key(row) not in here)]
        # by weights, which are the same for all trainings of a policy
        rows.sort(key=lambda r: (r["env"], float(r.get("macs_dense") or 0), r["policy"], r["seed"]))
        about = {"quick": "yes" if self.quick else ""}
        write_rows(
            (row | {"shipped": "yes" if row["shipped"] else ""} | about for row in rows),
            _COLUMNS,
            table,
        )
        # as they stand in the table, so that the page can be written again from it
        rows = read_table(table)
        page, shown = pages.write_page(
            results / "lineup.md",
            {},
            command=command_line(),
            quick=self.quick,
            missing=self._missing(rows),
            tasks={
                env: _task(env, rows, results / "pareto" / f"{env}.csv", self.episodes)
                for env in dict.fromkeys(row["env"] for row in rows)
            },
            versions=[f"- {releases()}", *versions_at_start(row["versions"] for row in rows)],
        )
        return [page, table, shown]

    def _missing(self, rows: Sequence[Record]) -> str:
        """The trainings that have no row; empty where there are none."""
        there = {key(row) for row in rows}
        lack = [member for member in self.members() if member.key not in there]
        found = [
            f"{env}: {', '.join(f'{name} {count}' for name, count in counts.items())}"
            for env in self.tasks
            if (counts := Counter(member.policy for member in lack if member.env == env))
        ]
        text = f"**Trainings that are missing, or were not evaluated: {'; '.join(found)}.**"
        return text if lack else ""


def _distilled(env: str) -> dict[str, dict[str, Any]]:
    """Name -> card of the shipped policies of an environment that imitate a float teacher."""
    cards = {file.stem: zoo.card(f"{env}/{file.stem}") for file in zoo.policies(env)}
    return {
        name: card
        for name, card in cards.items()
        if card and RECIPES[card["recipe"]].algorithm == "distill"
    }


def teachers(env: str) -> str:
    """Which policies imitate which teacher, in a sentence."""
    found: dict[str, list[str]] = {}
    for name, card in _distilled(env).items():
        found.setdefault(_teacher(card).partition("/")[2], []).append(name)
    said = (f"{', '.join(names)} imitate `{teacher}`" for teacher, names in found.items())
    return f"{'; '.join(said)}."


def _teacher(card: Mapping[str, Any]) -> str:
    """`hexapod/sac`, however the settings of the training named it."""
    path = Path(card["config"]["teacher"])
    return f"{path.parent.name}/{path.stem}"


def key(row: Record) -> tuple[str, str, int]:
    """Environment, policy and seed: what tells rows apart."""
    return row["env"], row["policy"], row["seed"]


def read_table(table: Path) -> list[Record]:
    """The rows of the table; ConfigError where it is damaged."""
    try:
        rows = read_rows(table, _TEXT)
        for row in rows:
            if tuple(row) != _COLUMNS or len(row["returns"] or ()) != row["episodes"]:
                raise ValueError(f"a row of {row.get('policy')}")
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{table} is damaged ({error}): put it back, or move it away") from error
    return rows


# the page

_SPARSE = "sparse-gated"


def _task(env: str, rows: Sequence[Record], sparse: Path, episodes: int) -> Record:
    """Facts that the template shows of a task; sparse: the table of the pareto experiment."""
    shown = [row for row in rows if row["env"] == env]
    shown += _sparse_rows(env, sparse, episodes) if sparse.is_file() else []
    returns = {policy: [row["returns"] for row in of] for policy, of in grouped(shown, "policy")}
    return {
        "teachers": teachers(env),
        "policies": [_facts(policy, of, returns) for policy, of in grouped(shown, "policy")],
        "verdicts": "\n".join(f"- {line}" for line in _verdicts(shown, returns)),
    }


def _facts(policy: str, rows: Sequence[Record], returns: Mapping[str, Any]) -> Record:
    """Facts on a policy in all its trainings."""
    means, mine, teacher = [row["return_mean"] for row in rows], returns[policy], returns.get("sac")
    spikes = rows[0]["kind"] == "snn"
    successes = [row["successes"] for row in rows if row.get("successes")]
    return {
        "name": policy,
        "operations": mean(rows, "sops_per_inference" if spikes else "macs_effective"),
        "unit": "SOPs" if spikes else "MACs",
        "found": stratified_bootstrap(mine, np.random.default_rng(0)),
        "of_teacher": nested_ratio(mine, teacher) if teacher and policy != "sac" else None,
        "over_trainings": t_interval(np.array(means) / np.mean(teacher))
        if teacher and policy != "sac" and len(means) > 1
        else None,
        "shipped": next((row["return_mean"] for row in rows if row.get("shipped")), None),
        "means": means,
        "success": stratified_bootstrap(successes, np.random.default_rng(0)).mean
        if successes
        else None,
        "failed": mean(rows, "falls"),
    }


def _sparse_rows(env: str, table: Path, episodes: int) -> list[Record]:
    """The trainings of the sparse policy that went on with reward, at its last level."""
    tuned = [
        row
        for row in read_pareto(table)
        if (row["student"], row["trained_by"], row["place"]) == ("sparse", "reward", "loihi1")
    ]
    last = min((row["level"] for row in tuned), default=0)
    shipped = zoo.card(f"{env}/{_SPARSE}").get("seed")
    return [
        {
            "policy": _SPARSE, "seed": row["seed"], "kind": "snn", "returns": row["scores"],
            "return_mean": row["return_mean"], "sops_per_inference": row["operations"],
            "falls": row["falls"],
            "shipped": row["seed"] == shipped,
        }
        for row in tuned
        if (row["level"], row["episodes"]) == (last, episodes)
    ]  # fmt: skip


def _verdicts(rows: Sequence[Record], returns: Mapping[str, Any]) -> Iterator[str]:
    """The smallest float policies that earn as much, and how lucky the shipped ones are."""
    controls = dict(grouped((row for row in rows if row["kind"] == "control"), "policy"))
    macs = {name: mean(of, "macs_effective") or 0.0 for name, of in controls.items()}
    for other in ("sac", _SPARSE) if controls else ():
        if other not in returns:
            continue
        shares = {name: nested_ratio(returns[name], returns[other]) for name in controls}
        equal = [name for name in controls if shares[name].ci95[1] >= 1]
        if not equal:
            yield f"All of these float policies are shown to earn less than `{other}`."
            continue
        least = min(equal, key=macs.__getitem__)
        yield (
            f"The smallest of these float policies not shown to earn less than `{other}` is "
            f"{least}: {macs[least]:,.0f} MACs, {percent(shares[least], 1)} of its return."
        )
    above = []
    for own in controls.values():
        shipped = [row["return_mean"] for row in own if row.get("shipped")]
        if shipped and len(own) > 1:
            above.append(shipped[0] > np.mean([row["return_mean"] for row in own]))
    if above:
        yield (
            f"{sum(above)} of {len(above)} shipped float policies earn more than the mean of their "
            "trainings."
        )
