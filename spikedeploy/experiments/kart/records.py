"""Results of the kart experiment: a record for each training and each evaluation, also as CSV."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from spikedeploy.experiments.finishes import steps_to
from spikedeploy.experiments.kart.design import ExperimentDesign
from spikedeploy.experiments.trial import Trial
from spikedeploy.files import replacing

COUNT = 300  # of finishes, as kart-simulator's table has it
NTH = f"finish_{COUNT}"
Record = dict[str, Any]


def learning(design: ExperimentDesign) -> list[Record]:
    """A record for each complete training: steps to the first and to the 300th finish."""
    return [
        {
            **_identity(trial),
            "env_steps": trial.counters["env_steps"],
            "finishes": len(trial.finishes),
            "first_finish": steps_to(1, trial.finishes),
            NTH: steps_to(COUNT, trial.finishes),
        }
        for trial in design.trials()
        if trial.trained
    ]


def driving(design: ExperimentDesign) -> list[Record]:
    """A record for each row of each complete evaluation."""
    found = []
    for trial in design.trials():
        evaluation = trial.evaluation
        if evaluation:
            facts = {**_identity(trial), "parameters": evaluation["parameters"]}
            found += [facts | _driven(row) for row in evaluation["rows"]]
    for part in design.built_in():
        if part.evaluation:
            facts = {"world": part.env, "policy": part.policy, "seed": None, "parameters": None}
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
    return {field: row.get(field) for field in _FIELDS} | prices


def _identity(trial: Trial) -> Record:
    world = trial.config.env.name
    return {"world": world, "policy": trial.recipe.removeprefix(f"{world}-"), "seed": trial.seed}


def write_csv(rows: Sequence[Record], path: Path) -> Path:
    """Write the rows; missing fields stay empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return path


def _cell(value: object) -> object:
    return f"{value:.10g}" if isinstance(value, float) else value
