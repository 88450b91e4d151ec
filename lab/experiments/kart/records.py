"""Results of the kart experiment: a record for each training and each evaluation, also as CSV."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from lab.experiments.evaluation import BuiltInEvaluation
from lab.experiments.finishes import steps_to
from lab.experiments.kart.design import COUNT, DEFAULT, GREEDY, ExperimentDesign, preset_of
from lab.experiments.kart.heldout import UNSEEN
from lab.experiments.trial import Trial
from spikedeploy.files import replacing
from spikedeploy.policies.run_record import whole
from spikedeploy.runtime.errors import ConfigError

FIRST, NTH = "first_finish", f"finish_{COUNT}"
HELD = f"greedy_{GREEDY:.0%}".removesuffix("%")
Record = dict[str, Any]
_KEYS = ("world", "preset", "policy", "seed")  # of a training


def learning(design: ExperimentDesign) -> list[Record]:
    """A record for each complete training: steps to the first and 300th finish, and greedily."""
    return [_learned(trial) for trial in design.trials() if trial.trained]


def lost(design: ExperimentDesign, folder: Path) -> int:
    """How many rows of tables that were written before are not among those of the design.

    folder  of learning.csv, driving.csv and tracks.csv
    """
    made = {"learning": _trained, "driving": driving, "tracks": heldout}
    return sum(
        len(_keys(_read(table)) - _keys(records(design)))
        for name, records in made.items()
        if (table := folder / f"{name}.csv").is_file()
    )


def _trained(design: ExperimentDesign) -> list[Record]:
    """What tells complete trainings apart; their episodes, which are many, are not read."""
    return [_identity(trial) for trial in design.trials() if trial.trained]


def _keys(rows: Iterable[Mapping[str, Any]]) -> set[tuple[str, ...]]:
    """What tells rows of a table apart, as it stands in the table."""
    names = (*_KEYS, "chip", "track")
    return {tuple("" if row.get(n) is None else str(row[n]) for n in names) for row in rows}


def _read(table: Path) -> list[dict[str, str]]:
    try:
        with table.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{table} is damaged ({error}): put it back, or move it away") from error


def _learned(trial: Trial) -> Record:
    finishes = trial.finishes
    return {
        **_identity(trial),
        "env_steps": trial.counters["env_steps"],
        "finishes": len(finishes),
        FIRST: steps_to(1, finishes),
        NTH: steps_to(COUNT, finishes),
        HELD: trial.steps_to_greedy(GREEDY),
    }


def driving(design: ExperimentDesign) -> list[Record]:
    """A record for each row of each complete evaluation."""
    found = []
    for trial in design.trials():
        evaluation = trial.evaluation
        if evaluation:
            with whole((trial.run or Path()) / "evaluation.json"):
                facts = {**_identity(trial), "parameters": evaluation["parameters"]}
                found += [facts | _driven(row) for row in evaluation["rows"]]
    for part in design.built_in():
        if part.evaluation:
            with whole(part.file):
                facts = {**_script(part), "parameters": None}
                found += [facts | _driven(row) for row in part.evaluation["rows"]]
    return found


_FIELDS = (
    "chip",
    "episodes",
    "success_rate",
    "lap_time",
    "crashes",
    "stalls",
    "gates",
    "return_mean",
    "success_difference_mean",
    "actions_equal",
    "sparsity",
    "spikes_per_inference",
    "sops_per_inference",
    "effective_macs",
    "macs_dense",
)


def _driven(row: Mapping[str, Any]) -> Record:
    energies = row["energy_per_inference_j"]
    prices = {f"energy_{table}_j": joules for table, joules in energies.items()}
    bounds = row.get("energy_interval_j", {})
    # evaluations of before took the price of a neuron update for the least too, which none is
    spikes = row.get("sops_per_inference") is not None
    lower = [n for n, joules in energies.items() if not spikes and bounds.get(n) == [joules, None]]
    return {
        **{field: row.get(field) for field in _FIELDS},
        "energies_at_least": " ".join(lower),
        **prices,
    }


def heldout(design: ExperimentDesign) -> list[Record]:
    """A record for each driver and track; `finished` (n,) of its starts."""
    found = []
    for part in design.on_tracks():
        identity = _identity(part.of) if isinstance(part.of, Trial) else _script(part.of)
        chip = part.of.chip if isinstance(part.of, Trial) and identity["policy"] == "snn" else None
        found += [
            {
                **identity,
                "chip": chip,
                "track": track,
                "unseen": track in UNSEEN,
                "finished": finished,
            }
            for track, finished in (part.finished or {}).items()
        ]
    return found


def _script(part: BuiltInEvaluation) -> Record:
    return {"world": part.env, "preset": DEFAULT, "policy": part.policy, "seed": None}


def _identity(trial: Trial) -> Record:
    world, policy = trial.config.env.name, trial.recipe.rpartition("-")[2]
    return dict(zip(_KEYS, (world, preset_of(trial), policy, trial.seed), strict=True))


def write_csv(rows: Sequence[Record], path: Path) -> Path:
    """Write the rows; missing fields stay empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return path


def _cell(value: object) -> object:
    if isinstance(value, list):
        return "".join(map(str, value))  # 1 for an episode that finished, 0 for one that did not
    return f"{value:.10g}" if isinstance(value, float) else value
