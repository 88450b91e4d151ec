"""Results of the kart experiment: a record for each training and each evaluation, also as CSV."""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from lab.experiments.kart import (
    COUNT,
    DEFAULT,
    GREEDY,
    LEARNING,
    UNSEEN,
    KartDesign,
    KartTraining,
    Script,
    read_tracks,
)
from lab.experiments.training import Record
from spikedeploy.files import replacing
from spikedeploy.policies.run_record import checked_record
from spikedeploy.runtime.errors import ConfigError

FIRST, NTH = "first_finish", f"finish_{COUNT}"
HELD = f"greedy_{GREEDY:.0%}".removesuffix("%")
_KEYS = ("world", "preset", "policy", "seed")  # of a training


def learning(design: KartDesign) -> list[Record]:
    """A record for each complete training: steps to the first and 300th finish, and greedily."""
    return [_learned(training) for training in design.trainings() if training.is_trained]


def _learned(training: KartTraining) -> Record:
    finishes = training.finishes

    def steps_to(count: int) -> float:
        return float(finishes[count - 1]) if len(finishes) >= count else math.inf

    return {
        **_identity(training),
        "env_steps": training.env_steps,
        "finishes": len(finishes),
        FIRST: steps_to(1),
        NTH: steps_to(COUNT),
        HELD: training.steps_to_greedy(GREEDY),
    }


def each_finish(design: KartDesign) -> list[Record]:
    """A record for each finish of each complete training on big_S, up to COUNT."""
    return [
        {"recipe": t.recipe, "seed": t.seed, "finish": n, "env_steps": steps}
        for t in design.trainings()
        if t.is_trained and t.preset in LEARNING
        for n, steps in enumerate(map(int, t.finishes[:COUNT]), start=1)
    ]


def count_lost(design: KartDesign, folder: Path) -> int:
    """The number of rows of earlier tables that are not among those of the design.

    folder  of learning.csv, driving.csv and tracks.csv
    """
    made = {"learning": _trained, "driving": driving, "tracks": heldout}
    return sum(
        len(_keys(_read(table)) - _keys(records(design)))
        for name, records in made.items()
        if (table := folder / f"{name}.csv").is_file()
    )


def _trained(design: KartDesign) -> list[Record]:
    """Complete trainings; their episodes, which are many, are not read."""
    return [_identity(training) for training in design.trainings() if training.is_trained]


def _keys(rows: Iterable[Mapping[str, Any]]) -> set[tuple[str, ...]]:
    """Keys of the rows of a table, as they stand in it."""
    names = (*_KEYS, "chip", "track")
    return {tuple("" if row.get(n) is None else str(row[n]) for n in names) for row in rows}


def _read(table: Path) -> list[dict[str, str]]:
    try:
        with table.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{table} is damaged ({error}): put it back, or move it away") from error


def driving(design: KartDesign) -> list[Record]:
    """A record for each row of each complete evaluation."""
    found = []
    drivers: list[KartTraining | Script] = [*design.trainings(), *design.scripts()]
    for part in drivers:
        if (evaluation := part.evaluation) is not None:
            is_script = isinstance(part, Script)
            with checked_record(part.file):
                parameters = None if is_script else evaluation["parameters"]
                facts = {**_identity(part), "parameters": parameters}
                found += [facts | _driven(row) for row in evaluation["rows"]]
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
    spikes = row.get("sops_per_inference") is not None
    lower = [n for n, joules in energies.items() if not spikes and bounds.get(n) == [joules, None]]
    return {
        **{field: row.get(field) for field in _FIELDS},
        "energies_at_least": " ".join(lower),
        **prices,
    }


def heldout(design: KartDesign) -> list[Record]:
    """A record for each driver and track; `finished` (n,) of its starts."""
    return [
        {
            **_identity(driver),
            "chip": getattr(driver, "chip", None) if driver.policy == "snn" else None,
            "track": track,
            "unseen": track in UNSEEN,
            "finished": each,
        }
        for driver in design.drivers()
        for track, each in (read_tracks(driver, design.starts) or {}).items()
    ]


def _identity(part: KartTraining | Script) -> Record:
    of = (DEFAULT, None) if isinstance(part, Script) else (part.preset, part.seed)
    return {"world": part.world, "preset": of[0], "policy": part.policy, "seed": of[1]}


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
