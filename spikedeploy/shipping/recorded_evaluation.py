"""Evaluations as cards of policies and reports of comparisons record them."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from spikedeploy import envs, zoo
from spikedeploy.comparison.lineup import Entry
from spikedeploy.policies.registry import BUILT_IN, FLOAT, find
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import NONE, Faults
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.record_fields import check_card, check_report

Row = Mapping[str, Any]  # of Comparison.as_json
REPORT = "report.json"
_NO_HASH = "sha256 of {}, so whether that was changed since is not checked"
_OF_TRAINING = "versions of the evaluation; those shown are of the training"


@dataclass(frozen=True)
class Settings:
    """What a report records in its command alone.

    options       of the environment
    quantisation  of spiking policies on chips
    faults        of those chips
    tables        energy tables to price by; empty for those of each row's chip
    metrics       of the step infos, `name:mean|last|max`
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    quantisation: Quantisation = PLAIN
    faults: Faults = NONE
    tables: Sequence[str] = ()
    metrics: Sequence[str] = ()


@dataclass(frozen=True)
class RecordedEvaluation:
    """An evaluation that can be made again.

    name          as it was asked for
    env           short name or id of the environment
    settings      of environment and chips
    seeds         (n,)
    rows          as recorded
    entries       policy and chip of each row
    versions      package -> version that it was made with, None for one that was not installed
    not_recorded  what it lacks, in words
    card          of the policy; None of a report
    """

    name: str
    env: str
    settings: Settings
    seeds: range
    rows: Sequence[Row]
    entries: Sequence[Entry]
    versions: Mapping[str, str | None]
    not_recorded: Sequence[str]
    card: Path | None = None


def recorded(reference: str, settings_of: Callable[[str], Settings]) -> RecordedEvaluation:
    """The evaluation of a shipped policy, of a card's path, or of a folder with a report.

    settings_of  a report's command -> its settings
    """
    place = Path(reference)
    if place.is_dir():
        if not (place / REPORT).is_file():
            raise ConfigError(_no_report(place))
        return _of_report(reference, place / REPORT, settings_of)
    if place.name == REPORT:
        return _of_report(reference, place, settings_of)
    return _of_card(reference, _card(reference))


def _card(reference: str) -> Path:
    """The card of a policy: beside its file."""
    if reference in BUILT_IN:
        raise ConfigError(
            f"{reference} is built in: it has no file, and so no card. Rows of it stand in reports "
            "of `compare`: name a folder with one, such as results/hexapod."
        )
    place = Path(reference)
    file = place if place.suffix == ".json" and place.is_file() else Path(find(reference).path)
    card = file.with_suffix(".json")
    if not card.is_file():
        raise ConfigError(f"{reference}: no card {card.name} beside it, so nothing is recorded")
    return card


def _no_report(folder: Path) -> str:
    if (folder / "config.json").is_file():
        return (
            f"{folder} is a run folder, whose evaluation is not recorded: `spikedeploy publish` "
            "writes a card, which can be reproduced"
        )
    return f"{folder} has no {REPORT}, which `spikedeploy compare ENV -o {folder}` would write"


def _of_card(name: str, path: Path) -> RecordedEvaluation:
    """The evaluation on the card of one policy."""
    card = _read(path, "evaluation")
    check_card(path, card)
    real = path.resolve()  # of a link, beside which neither policy nor page need lie
    rows, file = card["evaluation"], path.parent / card["file"]
    file = file if file.is_file() else real.parent / card["file"]
    _check_file(name, file, card.get("sha256"))
    world = card.get("config", {}).get("env", {"name": card["env"]})
    settings = Settings(world.get("options", {}))
    first = card.get("seeds", {}).get("first", EVALUATION)
    lacks = [] if "sha256" in card else [_NO_HASH.format(card["file"])]
    lacks += [] if "evaluated_with" in card else [_OF_TRAINING]
    return RecordedEvaluation(
        name=name,
        env=world["name"],
        settings=settings,
        seeds=_seeds(path, rows, first),
        rows=rows,
        entries=_entries(rows, settings, lambda _: str(file)),
        versions=card.get("evaluated_with") or card.get("versions", {}),
        not_recorded=lacks,
        card=real,
    )


def _of_report(name: str, path: Path, settings_of: Callable[[str], Settings]) -> RecordedEvaluation:
    """The rows of a report."""
    report = _read(path, "rows")
    check_report(path, report)
    rows, known = report["rows"], report.get("sha256", {})
    envs.spec(report["env"])  # refuses an unknown one
    files = [row["file"] for row in rows]
    for file, sha in known.items():  # which names no built-in and no run folder
        _check_file(name, zoo.resolve(file) or Path(file), sha)
    missing = [file for file in zoo.hashes(files) if file not in known]
    settings = settings_of(report["command"])
    return RecordedEvaluation(
        name=name,
        env=report["env"],
        settings=settings,
        seeds=_seeds(path, rows, report["seeds"]["first"]),
        rows=rows,
        entries=_entries(rows, settings, lambda row: str(row["file"])),
        versions=report.get("versions", {}),
        not_recorded=[_NO_HASH.format(", ".join(missing))] if missing else [],
    )


def _read(path: Path, rows: str) -> dict[str, Any]:
    """A card or report, which has rows."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not JSON: {error}") from error
    if not isinstance(found, dict) or not found.get(rows):
        raise ConfigError(f"{path} records no evaluation: it has no {rows!r}")
    return found


def _check_file(name: str, file: Path, recorded_hash: str | None) -> None:
    """Refuse a policy that is not the one that was evaluated."""
    if not file.is_file():
        raise ConfigError(f"{name}: {file}, the policy that was evaluated, is missing")
    if recorded_hash not in (None, found := zoo.sha256(file)):
        raise ConfigError(
            f"{name}: {file} has sha256 {found[:12]}…, and {str(recorded_hash)[:12]}… was "
            "evaluated: the file was changed or replaced. Evaluate it anew, or restore the file."
        )


def _seeds(path: Path, rows: Sequence[Row], first: int) -> range:
    """The seeds of the episodes, as many as each row has returns."""
    counts = {len(row["returns"]) for row in rows} | {row["episodes"] for row in rows}
    if len(counts) > 1:
        raise ConfigError(
            f"{path}: rows with {', '.join(map(str, sorted(counts)))} episodes or returns; all "
            "rows of an evaluation have the same number"
        )
    if counts == {0}:
        raise ConfigError(f"{path} records 0 episodes, so there is nothing to play again")
    return range(first, first + counts.pop())


def _entries(rows: Sequence[Row], settings: Settings, file_of: Callable[[Row], str]) -> list[Entry]:
    """The entries that the rows were played with, each with its reference."""
    entries: dict[str, Entry] = {}
    for row in rows:
        candidate = replace(find(file_of(row)), name=row["policy"])
        if row["chip"] is not None:
            candidate = replace(candidate, quantisation=settings.quantisation)
        if row["chip"] not in (None, FLOAT):
            limits = row.get("limits", True)
            candidate = replace(candidate, limits=limits, faults=settings.faults)
        reference = row.get("reference")
        if reference is not None and reference not in entries:
            raise ConfigError(f"the row of {row['policy']} refers to {reference!r}: no such row")
        entry = Entry(candidate, row["chip"], entries[reference] if reference else None)
        if entry.label in entries:
            raise ConfigError(f"there are two rows of {entry.label}, of which one was evaluated")
        entries[entry.label] = entry
    return list(entries.values())
