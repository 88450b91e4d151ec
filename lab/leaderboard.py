"""Rows of the public table from committed results, and its page: docs/leaderboard.md.

    python -m lab leaderboard -o docs

Ours are made anew: the shipped policies that run in a Loihi's own clock by their cards, the same
recipes over trainings by results/clocks.csv, and beside each the float policy of results/energy.csv
by its rows in results/pareto/. Rows of publications and those that others sent stay as they are in
results/leaderboard/. Then the tables of OUTPUT/leaderboard.md are written from all of them.
"""

import argparse
import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel

from lab.experiments import clocks, energy_ratio, fronts, hidden_neurons
from lab.fpga import put
from spikedeploy import zoo
from spikedeploy.comparison.statistics import risk
from spikedeploy.envs import spec
from spikedeploy.reports.table import escape_markdown, format_si, markdown_text
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import write_text
from spikedeploy.runtime.metrics.energy_tables import TABLES
from spikedeploy.shipping import leaderboard
from spikedeploy.shipping.leaderboard import (
    Energy,
    LeaderboardRow,
    OverTrainings,
    PolicyEntry,
)

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "results"
FOLDER = RESULTS / "leaderboard"
OWN = "spikedeploy-"  # the names of our rows begin so
UNKNOWN = "not reported"
# a chip's own prices, and those that float networks have too
_SHOWN = ("davies2018", "horowitz45-int8")
_INT8 = "horowitz45-int8"
_SOURCE = "spikedeploy, [cards](../spikedeploy/zoo), [clocks](../results/clocks.md)"


def main() -> None:
    """Write our rows, and the page of all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs", help="of the page")
    page = parser.parse_args().output / "leaderboard.md"
    for name, row in own_rows():
        leaderboard.write_row(row, FOLDER / f"{name}.json")
    write_text(page, filled(page.read_text(encoding="utf-8"), all_rows()))
    print(f"wrote {page}")


def all_rows() -> dict[str, LeaderboardRow]:
    """The rows of all files by name, in the order of the table; ConfigError of one that is bad."""
    found = {path.stem: leaderboard.read_row(path) for path in sorted(FOLDER.glob("*.json"))}
    for name, row in found.items():
        for fault in leaderboard.faults(row):
            raise ConfigError(f"{name}.json: {fault}")
    return found


# Our rows.


def own_rows() -> Iterator[tuple[str, LeaderboardRow]]:
    """The name and the row of each task with a policy for a Loihi's own clock."""
    over, hidden = clocks.read(RESULTS / "clocks.csv"), hidden_neurons.read()
    for task in energy_ratio.WALKS_AND_KARTS:
        card = zoo.card(f"{task}/sparse")
        reference = zoo.card(str(zoo.teacher(task)))
        (row,) = (each for each in card["evaluation"] if each["chip"] not in (None, "float"))
        name = f"{task}/sparse"
        evidence = {
            "command": f"spikedeploy run {name} --chip {row['chip']} --episodes {row['episodes']}",
            "reproduce": f"spikedeploy reproduce {name}",
            "first_seed": card["seeds"]["first"],
            "sha256": {f"{name}.nir": card["sha256"]},
            "versions": card["evaluated_with"],
        }
        made = leaderboard.row_of_rows(
            spec(task).id,
            {**row, "file": f"{name}.nir", "failure_rate": _failure_rate(row)},
            reference["evaluation"][0],
            None,
            evidence,
            {
                "source": _SOURCE,
                "rival": _rival(task),
                "over_trainings": _over_trainings(task, clocks.shipped_kind(card), over),
                "without_hidden": hidden.get(name, {}).get("kept"),
                "note": "Share over all trainings; operations and energy of the shipped one.",
            },
        )
        yield f"{OWN}{task}", made


def _failure_rate(row: Mapping[str, Any]) -> float:
    """Failures of a card's row; before they were kept, what ends episodes of ours by failing."""
    found: float | None = row.get("failure_rate")
    ends = [float(row.get(name, 0)) for name in ("falls", "crashes", "stalls")]
    return sum(ends) if found is None else found


def _over_trainings(task: str, kind: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    (row,) = (each for each in rows if (each["task"], each["kind"]) == (task, kind))
    beside = next(row for row in rows if row["task"] == task)  # the reference, which comes first
    of_trainings = clocks.share_over_trainings(row)
    return {
        "training_seeds": row["trainings"],
        "episodes": row["episodes"],
        "first_seed": clocks.FIRST_SEED,
        "share": row["share"],
        "share_ci95": [row["share_low"], row["share_high"]],
        "share_t95": list(of_trainings.ci95) if of_trainings else None,
        "success_rate": row["succeeded"],
        "failure_rate": clocks.failed(row),
        "worst_share": None if row["worst"] is None else row["worst"] / beside["mean"],
        "reference_success_rate": beside["succeeded"],
        "source": f"results/clocks.csv: {task}, {kind}",
    }


def _rival(task: str) -> dict[str, Any]:
    """The cheapest float policy with 98 % of the teacher's score, as results/energy.csv has it.

    Of karts the share is of mean returns, and has no interval: their scores are finishes. Success
    on the command task was not recorded, nor how many karts stalled.
    """
    pair = _pair(task)
    table = fronts.read_table(RESULTS / "pareto" / f"{task}.csv")
    (point,) = (
        each
        for each in fronts.points([row for row in table if row.get("clock") != "free"])
        if f"{each.label} at {each.level:g}" == pair["baseline"]
        and each.place == "int8"
        and math.isclose(each.mean("operations") or 0, float(pair["macs"]), rel_tol=1e-8)
    )
    races = "kart" in task
    of = point.of_reference or point.of_teacher
    earned = float(np.mean([row["return_mean"] for row in point.rows]))
    (teacher,) = (row for row in table if row["student"] == "teacher")
    return {
        "name": pair["baseline"],
        "return_mean": earned,
        "share": earned / teacher["return_mean"] if races else of.mean,
        "share_ci95": None if races else list(of.ci95),
        "success_rate": clocks.succeeded(task, point),
        "failure_rate": None if races else point.mean("falls"),
        "risk": risk([row["returns" if races else "scores"] for row in point.rows]),
        "training_seeds": len(point.rows),
        "effective_macs": float(pair["macs"]),
        "energy": [{"prices": _INT8, "dynamic_j": float(pair["float_j"])}],
    }


def _pair(task: str) -> dict[str, str]:
    """Sums in registers, reading observations counted, the update by its own price."""
    meant = {
        "task": task, "accumulator_bits": "none", "encoder": "chip", "clock": "pipelined",
        "update_price_of": energy_ratio.OWN,
    }  # fmt: skip
    with (RESULTS / "energy.csv").open(newline="", encoding="utf-8") as file:
        (found,) = (row for row in csv.DictReader(file) if meant.items() <= row.items())
    return found


# The page.


def filled(text: str, rows: Mapping[str, LeaderboardRow]) -> str:
    """The page with its tables."""
    for place, table in tables(rows).items():
        text = put(text, place, table)
    return text


def tables(rows: Mapping[str, LeaderboardRow]) -> dict[str, str]:
    """The tables of the page, by place."""
    counted = [row for row in rows.values() if row.evidence]
    published = [row for row in rows.values() if not row.evidence]
    return {
        "counted": _table(counted),
        "published": _table(published),
        "fields": markdown_text([["field", "type", "is"], *_fields(LeaderboardRow)]),
    }


def _table(rows: Sequence[LeaderboardRow]) -> str:
    return markdown_text([list(_COLUMNS), *([cell(r) for cell in _COLUMNS.values()] for r in rows)])


def _without_hidden(row: LeaderboardRow) -> str:
    """What stands after the name of a policy that was tried with all hidden neurons dead."""
    if row.without_hidden is None:
        return ""
    measured, files = hidden_neurons.read(), row.evidence.sha256 if row.evidence else ()
    found = [measured[name] for file in files if (name := file.removesuffix(".nir")) in measured]
    label = "linear in events, " if any(map(hidden_neurons.is_linear, found)) else ""
    return f", {label}{row.without_hidden:.1%} of its return with all hidden neurons dead"


def _share(policy: PolicyEntry, reference: str | None) -> str:
    if policy.share is None:
        earned = policy.return_mean
        return UNKNOWN if earned is None else f"{earned:,.0f}"
    return f"{_percent(policy.share, policy.share_ci95)} of {reference or 'the reference'}"


def _percent(share: float, interval: Sequence[float] | None) -> str:
    between = f" [{interval[0]:.1%}, {interval[1]:.1%}]" if interval else ""
    return f"{share:.1%}{between}"


def _earned(row: LeaderboardRow) -> str:
    of = row.over_trainings
    if of:
        t = of.share_t95
        between = f", t [{t[0]:.1%}, {t[1]:.1%}]" if t else ""
        return f"{_percent(of.share, of.share_ci95)}{between} of {row.reference}"
    return _share(row.spiking, row.reference)


def _success(row: LeaderboardRow) -> str:
    """`59.2%; sac 91.0%`."""
    of, beside = row.over_trainings, row.reference_success_rate
    share = of.success_rate if of else row.spiking.success_rate
    beside = of.reference_success_rate if of else beside
    words = [UNKNOWN if share is None else f"{share:.1%}"]
    if beside is not None:
        words.append(f"{row.reference} {beside:.1%}")
    return "; ".join(words)


def _ended_early(row: LeaderboardRow) -> str:
    of = row.over_trainings
    return _over_or_own(of.failure_rate if of else None, row.spiking.failure_rate, "{:.1%}", of)


def _worst(row: LeaderboardRow) -> str:
    """In parts of the reference's mean return where that is known."""
    of, own = row.over_trainings, row.spiking
    if own.risk is None or not own.share or own.return_mean is None:
        return _over_or_own(None, own.risk, "{:,.0f}", None)
    share = own.risk * own.share / own.return_mean
    return _over_or_own(of.worst_share if of else None, share, "{:.1%}", of)


def _over_or_own(
    over: float | None, own: float | None, form: str, trainings: OverTrainings | None
) -> str:
    """A number over all trainings; where they have none that of the shipped one, which it says."""
    if over is not None:
        return form.format(over)
    return UNKNOWN if own is None else form.format(own) + (", shipped one" if trainings else "")


def _operations(policy: PolicyEntry) -> str:
    """Every count that is known, with its name."""
    counts = {
        "SOPs": policy.sops,
        "ACs": policy.effective_acs if policy.sops is None else None,
        "MACs": policy.effective_macs or None,
        "dense MACs": policy.macs_dense
        if policy.sops is None and not policy.effective_macs
        else None,
    }
    known = [
        f"{count:,.1f} {name}" if count < 100 else f"{count:,.0f} {name}"
        for name, count in counts.items()
        if count is not None
    ]
    return ", ".join(known) or UNKNOWN


def _number(value: float | None, form: str) -> str:
    return UNKNOWN if value is None else format(value, form)


def _energies(policy: PolicyEntry, field: str) -> str:
    """Each energy that is known, with its prices; static power with its measurement."""
    known: dict[str, str] = {}
    for energy in policy.energy:
        joules = getattr(energy, field)
        if joules is not None and _is_shown(energy):
            of = energy.static_power if field == "with_static_j" else None
            known[f"{format_si(joules)}J ({of or energy.prices})"] = ""
    return ", ".join(known) or UNKNOWN


def _is_shown(energy: Energy) -> bool:
    return energy.prices in _SHOWN or energy.prices not in TABLES


def _trainings(row: LeaderboardRow) -> str:
    of = row.over_trainings
    return _number(of.training_seeds if of else row.spiking.training_seeds, "d")


def _rival_cell(row: LeaderboardRow) -> str:
    rival = row.rival
    if rival is None:
        return UNKNOWN
    energy = _energies(rival, "dynamic_j")
    words = [_operations(rival), "" if energy == UNKNOWN else energy]
    if rival.share is not None and rival.name != row.reference:
        words.insert(0, _percent(rival.share, rival.share_ci95))
        earned = (rival.return_mean or 0) / rival.share if rival.share else 0  # of the reference
        worst = rival.risk / earned if rival.risk is not None and earned else None
        outcomes = {
            "succeeds": rival.success_rate,
            "ended early": rival.failure_rate,
            "worst 5 %": worst,
        }
        words[1:1] = [f"{name} {x:.1%}" for name, x in outcomes.items() if x is not None]
    if rival.training_seeds:
        words.append(f"{rival.training_seeds} trainings")
    return f"{escape_markdown(rival.name)}: {', '.join(filter(None, words))}"


def _source_cell(row: LeaderboardRow) -> str:
    read = f" ({row.read})" if row.read else ""
    link = f", {row.link}" if row.link else ""
    return f"{row.source}{link}{read}" + (f". {row.note}" if row.note else "")


_COLUMNS: Mapping[str, Callable[[LeaderboardRow], str]] = {
    "task": lambda row: row.task.removeprefix("spikedeploy/"),
    "policy": lambda row: escape_markdown(row.spiking.name) + _without_hidden(row),
    "chip": lambda row: row.chip or UNKNOWN,
    "return": _earned,
    "success": _success,
    "ended early": _ended_early,
    "worst 5 %": _worst,
    "operations": lambda row: _operations(row.spiking),
    "neuron updates": lambda row: _number(row.spiking.neuron_updates, ",.1f"),
    "encoder": lambda row: row.spiking.encoder or UNKNOWN,
    "energy without static power": lambda row: _energies(row.spiking, "dynamic_j"),
    "with static power": lambda row: _energies(row.spiking, "with_static_j"),
    "trainings": _trainings,
    "episodes": lambda row: _number(row.episodes, "d"),
    "float rival": _rival_cell,
    "source": _source_cell,
}


def _fields(model: type[BaseModel], path: str = "") -> Iterator[list[str]]:
    """Name, type and meaning of every field of a schema, those of its parts below it."""
    for name, field in model.model_fields.items():
        inside = _models(field.annotation)
        kinds = _kinds(field.annotation)
        meaning = " ".join((field.description or "").split())
        yield [f"`{path}{field.alias or name}`", kinds, meaning]
        # a policy's fields are listed once, under `spiking`
        for each in inside if name != "rival" else ():
            yield from _fields(each, f"{path}{field.alias or name}.")


def _models(kind: Any) -> list[type[BaseModel]]:  # noqa: ANN401
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [found for each in get_args(kind) for found in _models(each)]


_WORDS = {float: "number", int: "integer", str: "text", type(None): "null"}


def _kinds(kind: Any) -> str:  # noqa: ANN401
    """`number or null`, `list`, `object`."""
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        return " or ".join(_kinds(each) for each in get_args(kind))
    if hasattr(kind, "__metadata__"):
        return _kinds(get_args(kind)[0])
    if origin is list:
        return f"list of {_kinds(get_args(kind)[0])}"
    if origin is dict or _models(kind):
        return "object"
    if kind in _WORDS:
        return _WORDS[kind]
    return ", ".join(f"`{each}`" for each in get_args(kind))
