"""Cards of shipped policies: their page, the evaluation that they and reports record.

A card stands beside its policy, as JSON and as a page in Markdown: how it was trained, that the
file is the trained policy, what it earns. Its evaluation, and that of a report of `compare`, can be
made again (`shipping.reproduce`).
"""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from spikedeploy import envs, zoo
from spikedeploy.comparison.lineup import Entry
from spikedeploy.outputs import check_output
from spikedeploy.policies import run_record
from spikedeploy.policies.registry import BUILT_IN, find
from spikedeploy.reports.columns import markdown_tables
from spikedeploy.reports.table import escape_markdown
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text, read_json, replacing, suffix
from spikedeploy.runtime.schema import validate
from spikedeploy.seeds import EVALUATION
from spikedeploy.setup import Setup
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import LEVEL
from spikedeploy.trainers.versions import versions

Row = Mapping[str, Any]  # of Comparison.as_json
REPORT = "report.json"
KINDS = {
    "ann": "float network (ONNX)",
    "snn": "spiking network (NIR)",
    "control": "control: a small float policy, a baseline for the spiking ones (ONNX)",
}
# settings of algorithms that follow from the run that they start from
_DERIVED = {"sparse-ppo": ("policy.",)}
_NO_HASH = "sha256 of {}, so whether that was changed since is not checked"
_OF_TRAINING = "versions of the evaluation; those shown are of the training"
_REMEDY = ". Restore the file, or evaluate the policy anew."


# The page of a card.


def training_of(run: Path, checkpoint: str | None = None) -> dict[str, Any]:
    """Fields of a card: the training of a run up to a checkpoint."""
    settings = run_record.settings(run)
    steps, unit = run_record.steps(run, checkpoint)
    return {
        "recipe": settings["recipe"],
        "seed": settings["seed"],
        "checkpoint": run_record.deployed_checkpoint(run, checkpoint),
        "steps": steps,
        "steps_unit": unit,
        "overrides": _overrides(run),
    }


def _overrides(run: Path) -> list[str]:
    """Settings that differ from the recipe."""
    from spikedeploy.trainers.config import differences
    from spikedeploy.trainers.run_folder import RunFolder
    from spikedeploy.trainers.train import algorithm

    name = run_record.settings(run)["algorithm"]
    found = differences(RunFolder(run).config(algorithm(name).Config))
    return [each for each in found if not each.startswith(_DERIVED.get(name, ()))]


def training_command(record: Mapping[str, Any]) -> str:
    """The command that trained the policy."""
    changes = dict(change.partition("=")[::2] for change in record["overrides"])
    what = record["recipe"]
    if what in RECIPES and RECIPES[what].any_env:
        what = f"{json.loads(changes.pop('env.name'))} --recipe {what}"
    options = [f"--set {shlex.quote(f'{key}={value}')}" for key, value in changes.items()]
    return " ".join([f"spikedeploy train {what} --seed {record['seed']}", *options])


def evaluation_fields(file: str, seeds: range, rows: Sequence[Row]) -> dict[str, Any]:
    """The fields of a card that an evaluation fills."""
    return {
        "seeds": {"first": seeds[0], "count": len(seeds)},
        "evaluated_with": versions(),
        "evaluation": [{**row, "file": file} for row in rows],
    }


def markdown(name: str, record: Mapping[str, Any]) -> str:
    """The page: provenance, evaluation, parity, learning curve."""
    checkpoint = record["checkpoint"]
    return fill(
        "card",
        name=name,
        record=record,
        kinds=KINDS,
        level=checkpoint.removeprefix(LEVEL) if checkpoint.startswith(LEVEL) else "",
        tables=markdown_tables(record["evaluation"]),
    )


def fill(template: str, **values: object) -> str:
    """The Markdown of a template; lines that nothing fills leave no gap."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader(__package__),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.globals.update(command=training_command, json=json.dumps)
    made.filters.update(plain=escape_markdown, quote=shlex.quote)
    return made.get_template(f"{template}.md.j2").render(values)


# What a card or report must have, checked before anything of it is used.


def _file_name(name: str) -> str:
    if name in ("", "..") or Path(name).name != name:
        raise ValueError("it is not the name of a file beside it")
    return name


Whole = Annotated[int, Field(ge=0, lt=2**63)]


class _Fields(BaseModel):
    model_config = ConfigDict(strict=True)


class _Row(_Fields):
    returns: list[FiniteFloat]
    episodes: Whole
    policy: str
    chip: str | None
    limits: bool = True
    reference: str | None = None


class _ReportRow(_Row):
    file: str


class _Seeds(_Fields):
    first: Whole


class _World(_Fields):
    name: str
    options: dict[str, Any] = {}


class _Config(_Fields):
    env: _World | None = None


class _Card(_Fields):
    file: Annotated[str, AfterValidator(_file_name)]
    env: str
    sha256: str | None = None
    config: _Config = _Config()
    seeds: _Seeds = _Seeds(first=EVALUATION)
    versions: dict[str, str | None] = {}
    evaluated_with: dict[str, str | None] = {}
    evaluation: list[_Row]


class _Report(_Fields):
    env: str
    seeds: _Seeds
    sha256: dict[str, str | None] = {}
    versions: dict[str, str | None] = {}
    rows: list[_ReportRow]
    setup: dict[str, Any] = {}
    teachers: list[str] = []


# An evaluation that was recorded.


@dataclass(frozen=True)
class RecordedEvaluation:
    """An evaluation that can be made again.

    name: name as it was asked for
    env: short name or id of the environment
    seeds: (n,)
    rows: as recorded
    entries: policy and chip of each row
    versions: package -> version that it was made with, None for one that was not installed
    not_recorded: what it lacks, in words
    card: card of the policy; None for a report
    """

    name: str
    env: str
    seeds: range
    rows: Sequence[Row]
    entries: Sequence[Entry]
    versions: Mapping[str, str | None]
    not_recorded: Sequence[str]
    card: Path | None = None


def read_evaluation(reference: str) -> RecordedEvaluation:
    """Return the evaluation of a shipped policy, a card's path, or a folder with a report."""
    place = Path(reference)
    if place.is_dir() or place.name == REPORT:
        path = place / REPORT if place.is_dir() else place
        return _evaluation_of_report(reference, path)
    if reference in BUILT_IN:
        raise ConfigError(
            f"{reference} is built in: it has no file, and so no card. Rows of it stand in reports "
            "of `compare`: name a folder with one, such as results/hexapod."
        )
    file = place if suffix(place) == ".json" and place.is_file() else Path(find(reference).path)
    card = file.with_suffix(".json")
    if not card.is_file():
        raise ConfigError(f"{reference}: no card {card.name} beside it, so nothing is recorded")
    return _evaluation_of_card(reference, card)


def _evaluation_of_card(name: str, path: Path) -> RecordedEvaluation:
    """The evaluation on the card of one policy."""
    content = _read(path, "evaluation")
    card = validate(_Card, content, path, _REMEDY)
    real = path.resolve()  # of a link, beside which neither policy nor page need lie
    file = path.parent / card.file
    file = file if file.is_file() else real.parent / card.file
    _check_file(name, file, card.sha256)
    world = card.config.env or _World(name=card.env)
    setup = Setup.with_options(world.options)
    lacks = [] if card.sha256 else [_NO_HASH.format(card.file)]
    return RecordedEvaluation(
        name=name,
        env=world.name,
        seeds=_seeds(path, card.evaluation, card.seeds.first),
        rows=content["evaluation"],
        entries=_entries([(row, str(file)) for row in card.evaluation], setup),
        versions=card.evaluated_with or card.versions,
        not_recorded=lacks if card.evaluated_with else [*lacks, _OF_TRAINING],
        card=real,
    )


def _evaluation_of_report(name: str, path: Path) -> RecordedEvaluation:
    """The rows of a report."""
    content, report = read_report(path)
    envs.spec(report.env)  # refuses an unknown one
    for file, sha256 in report.sha256.items():  # which names no built-in and no run folder
        _check_file(name, zoo.resolve(file) or Path(file), sha256)
    missing = [
        file for file in zoo.hashes(r.file for r in report.rows) if file not in report.sha256
    ]
    if report.teachers:  # which may be code, and no file has that run
        raise ConfigError(
            f"the report has a row of the teacher {report.teachers[0]}, which a report does not "
            "have played: run its command again instead"
        )
    setup = Setup.read(report.setup, path).check()
    return RecordedEvaluation(
        name=name,
        env=report.env,
        seeds=_seeds(path, report.rows, report.seeds.first),
        rows=content["rows"],
        entries=_entries([(row, row.file) for row in report.rows], setup),
        versions=report.versions,
        not_recorded=[_NO_HASH.format(", ".join(missing))] if missing else [],
    )


def read_report(path: Path) -> tuple[dict[str, Any], _Report]:
    """A report.json as data, and the fields of it that were checked."""
    if not path.is_file():
        raise ConfigError(
            f"{path.parent} is a run folder, whose evaluation is not recorded: `spikedeploy "
            "publish` writes a card, which can be reproduced"
            if (path.parent / "config.json").is_file()
            else f"{path.parent} has no {REPORT}, which `spikedeploy compare ENV -o "
            f"{shlex.quote(str(path.parent))}` would write"
        )
    content = _read(path, "rows")
    return content, validate(_Report, content, path, _REMEDY)


def _read(path: Path, rows: str) -> dict[str, Any]:
    """A card or report, which has rows."""
    found = read_json(path)
    if not found.get(rows):
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


def _seeds(path: Path, rows: Sequence[_Row], first: int) -> range:
    """The seeds of the episodes, as many as each row has returns."""
    counts = {len(row.returns) for row in rows} | {row.episodes for row in rows}
    if len(counts) > 1:
        raise ConfigError(
            f"{path}: rows with {', '.join(map(str, sorted(counts)))} episodes or returns; all "
            "rows of an evaluation have the same number"
        )
    if counts == {0}:
        raise ConfigError(f"{path} records 0 episodes, so there is nothing to play again")
    return range(first, first + counts.pop())


def _entries(rows: Sequence[tuple[_Row, str]], setup: Setup) -> list[Entry]:
    """The entries that the rows (row, file) were played with, each with its reference."""
    entries: dict[str, Entry] = {}
    for row, file in rows:
        candidate = replace(find(file), name=row.policy)
        if row.reference is not None and row.reference not in entries:
            raise ConfigError(f"the row of {row.policy} refers to {row.reference!r}: no such row")
        reference = entries[row.reference] if row.reference else None
        entry = Entry(candidate, row.chip, reference, setup)
        if entry.label in entries:
            raise ConfigError(f"there are two rows of {entry.label}, of which one was evaluated")
        entries[entry.label] = entry
    return list(entries.values())


# A new evaluation on an old card.


def check_rewritable(card: Path, force: bool = False) -> None:
    """Refuse a card that lacks what its page says, and a page that is not of this card."""
    from jinja2 import TemplateError

    try:
        text = markdown(card.stem, read_json(card))
    except (LookupError, TypeError, ValueError, AttributeError, TemplateError) as error:
        raise ConfigError(f"{card} lacks what its page says: {error}{_REMEDY}") from error
    head = text.encode()[: text.index("\n- environment")]
    page = card.with_suffix(".md")
    check_output("--update", page, (card,), force, lambda path: path.read_bytes().startswith(head))


def write_evaluation(card: Path, sha256: str, seeds: range, rows: Sequence[Row]) -> None:
    """Write rows of a new evaluation into a card and its page: into both or neither."""
    record = read_json(card)
    kept = {key: value for key, value in record.items() if key not in ("file", "sha256")}
    identity = {"file": record["file"], "sha256": sha256}
    record = identity | kept | evaluation_fields(record["file"], seeds, rows)
    texts = as_text(record), markdown(card.stem, record)
    with replacing(card) as data, replacing(card.with_suffix(".md")) as page:
        for part, text in zip((data, page), texts, strict=True):
            part.write_text(text, encoding="utf-8")
