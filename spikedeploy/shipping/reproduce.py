"""A recorded evaluation made again, and every number of it compared with the recorded one."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from spikedeploy import zoo
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text
from spikedeploy.shipping.cards import RecordedEvaluation, Row, check_rewritable, write_evaluation
from spikedeploy.trainers.versions import versions

TOLERANCE = 1e-9
EQUAL, CLOSE, DIFFERS = "equal", f"equal up to {TOLERANCE:g}", "differs"
_RETURNS = "returns"  # of each episode; every other field is of all
# counted from the file, whatever episodes are played
_OF_THE_FILE = ("macs_dense", "footprint", "footprint_packed")
# fields of fewer units than 1e-9, whose numbers are compared in proportion alone
_SMALL = ("energy", "latency")
# which row it is
_IDENTITY = ("policy", "kind", "chip", "limits", "file", "episodes", "reference")
_MISSING = object()

Number = float | int | None


@dataclass(frozen=True)
class NumberThatDiffers:
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
    """The result of making an evaluation again.

    name: name of the evaluation
    episodes: number played of each row; `of` were recorded
    rows: policies on chips
    numbers: count of the numbers that were compared
    verdict: EQUAL, CLOSE or DIFFERS
    difference: the first number of those that decide the verdict; None where all are equal
    differing: how many numbers are not equal
    not_compared: fields that are means over all recorded episodes, when fewer were played
    not_recorded: what the record lacks, in words
    versions: package -> [version then, version now]
    seconds: duration [s]
    """

    name: str
    episodes: int
    of: int
    rows: int
    numbers: int
    verdict: str
    difference: NumberThatDiffers | None
    differing: int
    not_compared: Sequence[str]
    not_recorded: Sequence[str]
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
    update: bool = False,
    force: bool = False,
) -> Reproduction:
    """Play an evaluation again and compare it with the record.

    episodes: the first of its seeds; by default all
    processes: one for each core by default
    update: write what was found into the card, where every return is as recorded
    force: where that would replace a page that is not the card's
    """
    count = len(recorded.seeds) if episodes is None else episodes
    check_episodes(recorded, count)
    if update:
        if recorded.card is None:
            raise ConfigError(
                f"{recorded.name} is a report: --update is of cards; run its command again instead"
            )
        if count < len(recorded.seeds):
            raise ConfigError("--update needs all episodes: leave --episodes out")
        check_rewritable(recorded.card, force)
    started = monotonic()
    played = compare_policies(recorded.env, recorded.entries, recorded.seeds[:count], processes)
    found = json.loads(
        as_text(played.as_json())
    )  # as a file would have them: infinite bounds are null
    expected = [first_episodes(row, count) for row in recorded.rows]
    labels = [entry.label for entry in recorded.entries]
    compared = list(_compare(labels, expected, found, recorded.seeds))
    unequal = [pair for pair in compared if pair[0] != EQUAL]
    verdict, first = min(unequal, key=lambda pair: pair[0] != DIFFERS, default=(EQUAL, None))
    if update:
        _update(recorded, found, unequal)
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
        not_compared=_left_out(recorded.rows, expected),
        not_recorded=recorded.not_recorded,
        versions={name: [recorded.versions.get(name, "not recorded"), now[name]] for name in now},
        seconds=round(monotonic() - started, 1),
    )


def check_episodes(recorded: RecordedEvaluation, count: int) -> None:
    """Refuse more episodes than were recorded, and none."""
    of = len(recorded.seeds)
    if not 1 <= count <= of:
        raise ConfigError(
            f"{recorded.name} records {of} episodes: --episodes {count} is more"
            if count > of
            else f"{count} episodes: at least one is played"
        )


def _update(
    recorded: RecordedEvaluation,
    found: Sequence[Row],
    unequal: Sequence[tuple[str, NumberThatDiffers]],
) -> None:
    """Write the rows into the card, unless a return differs: then the policy acts otherwise."""
    for _, pair in unequal:
        if pair.field == _RETURNS:
            raise ConfigError(
                f"{recorded.name}: {pair.describe()}. The card is kept: --update is for numbers "
                "that are counted otherwise than before, not for other returns."
            )
    if recorded.card is not None:
        sha256 = zoo.sha256(Path(recorded.entries[0].candidate.path))
        write_evaluation(recorded.card, sha256, recorded.seeds, found)


def first_episodes(row: Row, count: int) -> Row:
    """The fields of a recorded row that hold for its first `count` episodes."""
    if count == row["episodes"]:
        return row
    returns = row[_RETURNS][:count]
    kept = {name: row[name] for name in _OF_THE_FILE if name in row}
    return {"return_mean": float(np.mean(returns)), _RETURNS: returns, **kept}


def _left_out(rows: Sequence[Row], kept: Sequence[Row]) -> list[str]:
    """Fields with numbers that are compared in no row."""
    named = dict.fromkeys(name for row in rows for name in row if name not in _IDENTITY)
    return [
        name
        for name in named
        if not any(name in row for row in kept)
        and any(number is not None for row in rows for _, number in numbers(row.get(name)))
    ]


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
) -> Iterator[tuple[str, NumberThatDiffers]]:
    """(verdict, both numbers) of every recorded number; of each row the returns first."""
    expected = [{n: v for n, v in row.items() if n not in _IDENTITY} for row in expected]
    for label, then, now in zip(labels, expected, found, strict=True):
        there = dict(numbers(now))
        for path, number in sorted(numbers(then), key=lambda item: item[0][0] != _RETURNS):
            other: Any = there.get(path, _MISSING)
            seed = seeds[path[1]] if path[0] == _RETURNS else None
            field = _RETURNS if seed is not None else ".".join(map(str, path))
            shown = "nothing" if other is _MISSING else other
            pair = NumberThatDiffers(label, field, seed, number, shown)
            yield _verdict(number, other, str(path[0])), pair


def _verdict(then: Number, now: Any, field: str) -> str:  # noqa: ANN401
    """EQUAL, CLOSE or DIFFERS; integers are never close."""
    if then == now:
        return EQUAL
    if not (isinstance(then, float) and isinstance(now, float)):
        return DIFFERS
    near = 0.0 if field.startswith(_SMALL) else TOLERANCE
    close = math.isclose(then, now, rel_tol=TOLERANCE, abs_tol=near)
    return CLOSE if close else DIFFERS
