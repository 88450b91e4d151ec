"""A recorded evaluation played again, and every number of it compared with the recorded one.

Evaluations stand on the cards of shipped policies and in report.json of `compare`: rows, the seeds
that they were played with, the setup, and the SHA-256 of each policy.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from spikedeploy import envs, zoo
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.registry import BUILT_IN, Entry, find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text, read_json, suffix
from spikedeploy.runtime.schema import validate
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.versions import versions

REPORT = "report.json"
TOLERANCE = 1e-9
EQUAL, CLOSE, DIFFERS = "equal", f"equal up to {TOLERANCE:g}", "differs"
Row = Mapping[str, Any]  # of Comparison.as_json
Number = float | int | None
_RETURNS = "returns"  # of each episode; every other field is of all
# counted from the file, whatever episodes are played
_OF_THE_FILE = ("macs_dense", "footprint", "footprint_packed")
# fields of fewer units than 1e-9, whose numbers are compared in proportion alone
_SMALL = ("energy", "latency")
# which row it is
_IDENTITY = ("policy", "kind", "chip", "limits", "file", "episodes", "reference")
_MISSING = object()


# What a card or report must have, checked before anything of it is used.


def _file_name(name: str) -> str:
    if name in ("", "..") or Path(name).name != name:
        raise ValueError("it is not the name of a file beside it")
    return name


_Whole = Annotated[int, Field(ge=0, lt=2**63)]


class _Fields(BaseModel):
    model_config = ConfigDict(strict=True)


class _Row(_Fields):
    returns: list[FiniteFloat]
    episodes: _Whole
    policy: str
    chip: str | None
    reference: str | None = None
    file: str = ""
    limits: bool = True


class _Seeds(_Fields):
    first: _Whole = EVALUATION


class _World(_Fields):
    name: str
    options: dict[str, Any] = {}


class _Config(_Fields):
    env: _World


class _Card(_Fields):
    file: Annotated[str, AfterValidator(_file_name)]
    sha256: str
    config: _Config
    seeds: _Seeds = _Seeds()
    evaluated_with: dict[str, str | None] = {}
    evaluation: list[_Row]


class _Report(_Fields):
    env: str
    seeds: _Seeds
    sha256: dict[str, str | None] = {}
    versions: dict[str, str | None] = {}
    rows: list[_Row]
    setup: dict[str, Any]
    teachers: list[str] = []


@dataclass(frozen=True)
class RecordedEvaluation:
    """An evaluation that can be played again.

    name: name as it was asked for
    env: short name or id of the environment
    seeds: (n,)
    rows: as recorded
    entries: policy and chip of each row
    versions: package -> version that it was made with, None for one that was not installed
    card: card of the policy; None for a report
    """

    name: str
    env: str
    seeds: range
    rows: Sequence[Row]
    entries: Sequence[Entry]
    versions: Mapping[str, str | None]
    card: Path | None = None


def read_evaluation(reference: str) -> RecordedEvaluation:
    """Return the evaluation of a shipped policy, a card's path, or a folder with a report.

    Raises ConfigError where nothing is recorded, a field is of the wrong kind, or a policy is not
    the one that was evaluated.
    """
    place = Path(reference)
    if place.is_dir() or place.name == REPORT:
        return _read_report(reference, place / REPORT if place.is_dir() else place)
    if reference in BUILT_IN:
        raise ConfigError(f"{reference} is built in: it has no file, and so no card")
    file = place if suffix(place) == ".json" and place.is_file() else Path(find(reference).path)
    return _read_card(reference, file.with_suffix(".json"))


def _read_card(name: str, path: Path) -> RecordedEvaluation:
    content = _read(path, "evaluation")
    card = validate(_Card, content, path)
    # a link to a card need not have the policy beside it
    file = next(
        (each for each in (path.parent, path.resolve().parent) if (each / card.file).is_file()),
        path.parent,
    )
    file = file / card.file
    _check_file(name, file, card.sha256)
    world = card.config.env
    rows = [row.model_copy(update={"file": str(file)}) for row in card.evaluation]
    return RecordedEvaluation(
        name=name,
        env=world.name,
        seeds=_seeds(path, rows, card.seeds.first),
        rows=content["evaluation"],
        entries=_entries(rows, Setup.with_options(world.options)),
        versions=card.evaluated_with,
        card=path.resolve(),
    )


def _read_report(name: str, path: Path) -> RecordedEvaluation:
    content = _read(path, "rows")
    report = validate(_Report, content, path)
    envs.spec(report.env)  # refuses an unknown one
    for file, sha256 in report.sha256.items():  # which names no built-in and no run folder
        _check_file(name, zoo.resolve(file) or Path(file), sha256)
    if report.teachers:  # which may be code, and no file has that run
        raise ConfigError(
            f"the report has a row of the teacher {report.teachers[0]}, which a report does not "
            "have played: run its command again instead"
        )
    return RecordedEvaluation(
        name=name,
        env=report.env,
        seeds=_seeds(path, report.rows, report.seeds.first),
        rows=content["rows"],
        entries=_entries(report.rows, Setup.read(report.setup, path).check()),
        versions=report.versions,
    )


def _read(path: Path, rows: str) -> dict[str, Any]:
    """A card or report, which has rows."""
    if not path.is_file():
        raise ConfigError(
            f"{path}: there is no such card or report; `spikedeploy compare ENV -o FOLDER` writes "
            "a report"
        )
    found = read_json(path)
    if not found.get(rows):
        raise ConfigError(f"{path} records no evaluation: it has no {rows!r}")
    return found


def _check_file(name: str, file: Path, recorded: str | None) -> None:
    """Refuse a policy that is not the one that was evaluated."""
    if not file.is_file():
        raise ConfigError(f"{name}: {file}, the policy that was evaluated, is missing")
    if recorded not in (None, found := zoo.sha256(file)):
        raise ConfigError(
            f"{name}: {file} has sha256 {found[:12]}…, and {str(recorded)[:12]}… was evaluated: "
            "evaluate it anew, or restore the file"
        )


def _seeds(path: Path, rows: Sequence[_Row], first: int) -> range:
    """The seeds of the episodes, as many as each row has returns."""
    counts = {len(row.returns) for row in rows} | {row.episodes for row in rows}
    if len(counts) > 1 or counts == {0}:
        raise ConfigError(f"{path}: rows with {', '.join(map(str, sorted(counts)))} episodes")
    return range(first, first + counts.pop())


def _entries(rows: Sequence[_Row], setup: Setup) -> list[Entry]:
    """The entries that the rows were played with, each with its reference."""
    entries: dict[str, Entry] = {}
    for row in rows:
        if row.reference is not None and row.reference not in entries:
            raise ConfigError(f"the row of {row.policy} refers to {row.reference!r}: no such row")
        reference = entries[row.reference] if row.reference else None
        entry = Entry(replace(find(row.file), name=row.policy), row.chip, reference, setup)
        if entry.label in entries:
            raise ConfigError(f"there are two rows of {entry.label}")
        if entry.limits != row.limits:
            raise ConfigError(f"the row of {entry.label} has other limits than the setup")
        entries[entry.label] = entry
    return list(entries.values())


# The evaluation played again.


@dataclass(frozen=True)
class RowDifference:
    """A number that was found otherwise than recorded.

    row: policy and chip: `sparse · loihi1`
    field: field of the row: `returns`, `energy_per_inference_j.davies2018`
    seed: seed of the episode, None for what is of all episodes
    expected: recorded value
    found: now; "nothing" where the row has no such field any more
    """

    row: str
    field: str
    seed: int | None
    expected: Number
    found: Number | str

    def describe(self) -> str:
        """The difference in one line."""
        where = "" if self.seed is None else f", episode of seed {self.seed}"
        found = self.found if isinstance(self.found, str) else json.dumps(self.found)
        return f"{self.row}{where}, {self.field}: {json.dumps(self.expected)} then, {found} now"


@dataclass(frozen=True)
class Reproduction:
    """The result of playing an evaluation again.

    name: name of the evaluation
    episodes: number played of each row; `of` were recorded. Means over all recorded episodes are
        compared where all are played.
    rows: policies on chips
    numbers: count of the numbers that were compared
    verdict: EQUAL, CLOSE or DIFFERS
    difference: the first number of those that decide the verdict; None where all are equal
    differing: how many numbers are not equal
    versions: package -> [version then, version now]
    seconds: duration [s]
    """

    name: str
    episodes: int
    of: int
    rows: int
    numbers: int
    verdict: str
    difference: RowDifference | None
    differing: int
    versions: Mapping[str, Sequence[str | None]]
    seconds: float

    @property
    def equal(self) -> bool:
        """True where every number is equal, or is so up to TOLERANCE."""
        return self.verdict != DIFFERS

    def as_json(self) -> dict[str, Any]:
        """The fields, and whether it is equal."""
        return {"equal": self.equal, **asdict(self)}


def reproduce(
    recorded: RecordedEvaluation,
    episodes: int | None = None,
    processes: int | None = None,
) -> Reproduction:
    """Play an evaluation again and compare it with the record.

    episodes: the first of its seeds; by default all
    processes: one for each core by default
    """
    count = len(recorded.seeds) if episodes is None else episodes
    check_episodes(recorded, count)
    started = monotonic()
    played = compare_policies(recorded.env, recorded.entries, recorded.seeds[:count], processes)
    # as a file would have them: infinite bounds are null
    found = json.loads(as_text(played.as_json()))
    labels = [entry.label for entry in recorded.entries]
    expected = [_first_episodes(row, count) for row in recorded.rows]
    compared = list(_compare(labels, expected, found, recorded.seeds))
    unequal = [pair for pair in compared if pair[0] != EQUAL]
    verdict, first = min(unequal, key=lambda pair: pair[0] != DIFFERS, default=(EQUAL, None))
    now = versions()
    return Reproduction(
        name=recorded.name,
        episodes=count,
        of=len(recorded.seeds),
        rows=len(found),
        numbers=len(compared),
        verdict=verdict,
        difference=first,
        differing=len(unequal),
        versions={name: [recorded.versions.get(name, "not recorded"), now[name]] for name in now},
        seconds=round(monotonic() - started, 1),
    )


def check_episodes(recorded: RecordedEvaluation, count: int) -> None:
    """Refuse more episodes than were recorded, and none."""
    if not 1 <= count <= (of := len(recorded.seeds)):
        raise ConfigError(f"--episodes {count}: {recorded.name} records {of} episodes")


def _first_episodes(row: Row, count: int) -> Row:
    """The fields of a recorded row that hold for its first `count` episodes."""
    if count == row["episodes"]:
        return row
    returns = row[_RETURNS][:count]
    kept = {name: row[name] for name in _OF_THE_FILE if name in row}
    return {"return_mean": float(np.mean(returns)), _RETURNS: returns, **kept}


def numbers(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Number]]:  # noqa: ANN401
    """(path, number) of every number in plain data, and of every null in the place of one."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from numbers(each, (*path, key))
    elif isinstance(value, list):
        for key, each in enumerate(value):
            yield from numbers(each, (*path, key))
    elif value is None or isinstance(value, int | float):
        yield path, value


def _compare(
    labels: Sequence[str], expected: Sequence[Row], found: Sequence[Row], seeds: range
) -> Iterator[tuple[str, RowDifference]]:
    """(verdict, both numbers) of every recorded number; of each row the returns first."""
    for label, then, now in zip(labels, expected, found, strict=True):
        recorded = {name: value for name, value in then.items() if name not in _IDENTITY}
        there = dict(numbers(now))
        for path, number in sorted(numbers(recorded), key=lambda item: item[0][0] != _RETURNS):
            other: Any = there.get(path, _MISSING)
            seed = seeds[path[1]] if path[0] == _RETURNS else None
            field = _RETURNS if seed is not None else ".".join(map(str, path))
            shown = "nothing" if other is _MISSING else other
            difference = RowDifference(label, field, seed, number, shown)
            yield _verdict(number, other, str(path[0])), difference


def _verdict(then: Number, now: Any, field: str) -> str:  # noqa: ANN401
    """EQUAL, CLOSE or DIFFERS; integers are never close."""
    if then == now:
        return EQUAL
    if not (isinstance(then, float) and isinstance(now, float)):
        return DIFFERS
    near = 0.0 if field.startswith(_SMALL) else TOLERANCE
    close = math.isclose(then, now, rel_tol=TOLERANCE, abs_tol=near)
    return CLOSE if close else DIFFERS
