"""Points of the front: the trainings of a student at one level, and their cheapest baselines."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from lab.experiments.pareto.costs import INT8, TERMS, spikes, terms, total
from lab.experiments.pareto.design import FLOAT, LABELS, LEVELS, SPIKING, STUDENTS
from lab.experiments.pareto.tuning import RewardTraining
from spikedeploy.comparison.statistics import (
    Estimate,
    ReturnEstimates,
    nested_ratio,
    stratified,
)

Record = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Point:
    """A level of a student at one place, in all its trainings.

    student, level, place  as in its rows
    rows                   of each training seed
    teacher                scores of the teacher on the same episodes
    reference              those of the reference; empty where there is none
    """

    student: str
    level: float
    place: str
    rows: Sequence[Record]
    teacher: Sequence[float]
    reference: Sequence[float] = ()

    @cached_property
    def of_teacher(self) -> Estimate:
        """Score in parts of the teacher's; the interval covers trainings and episodes."""
        return self._of(self.teacher)

    @cached_property
    def of_reference(self) -> Estimate | None:
        """Score in parts of the reference's, likewise."""
        return self._of(self.reference) if self.reference else None

    def _of(self, reference: Sequence[float]) -> Estimate:
        scores = [row["scores"] for row in self.rows]
        return nested_ratio(scores, reference, np.random.default_rng(0))

    @property
    def single(self) -> list[float]:
        """Score of each training in parts of the teacher's."""
        teacher = float(np.mean(self.teacher)) or math.nan
        return [float(np.mean(row["scores"])) / teacher for row in self.rows]

    def mean(self, field: str) -> float | None:
        """Mean of a field over the trainings; None where no row has it."""
        found = [row[field] for row in self.rows if row.get(field) is not None]
        return float(np.mean(found)) if found else None

    def energy(self, of: str, table: str = INT8, lean: bool = False) -> float:
        """Mean energy [J] of a total (costs.TOTALS)."""
        return float(np.mean([total(row, table, of, lean) for row in self.rows]))

    def terms(self, lean: bool = False, table: str = INT8) -> dict[str, float]:
        """Mean energy [J] of each term."""
        each = [terms(row, table, lean) for row in self.rows]
        return {name: float(np.mean([one[name] for one in each])) for name in TERMS}

    @property
    def rewarded(self) -> bool:
        """Whether it was trained on with reward; rows of older tables do not say it."""
        return _rewarded(self.rows[0])

    @property
    def label(self) -> str:
        """`LIF`, or `LIF, with reward`."""
        return f"{LABELS[self.student]}{', with reward' if self.rewarded else ''}"

    @property
    def spiking(self) -> bool:
        """Whether it spikes, or is delta-coded."""
        return spikes(self.rows[0])


def earned(rows: Sequence[Record]) -> ReturnEstimates | None:
    """Mean, IQM and risk of the returns of rows on the same episodes; None where these lack."""
    returns = [row.get("returns") or ([] if drives(row) else row["scores"]) for row in rows]
    return _estimates(tuple(map(tuple, returns))) if all(returns) else None


def score(rows: Sequence[Record]) -> Estimate:
    """Mean score of rows on the same episodes: the return of walkers, finishes of karts."""
    return _estimates(tuple(tuple(row["scores"]) for row in rows)).mean


@cache  # the page is written again after every part of the experiment
def _estimates(values: tuple[tuple[float, ...], ...]) -> ReturnEstimates:
    return stratified(values, np.random.default_rng(0))


def drives(row: Record) -> bool:
    """Whether a row is of a kart, whose scores are finishes."""
    return row.get("crashes") is not None


def _rewarded(row: Record) -> bool:
    return row.get("trained_by") == RewardTraining.trained_by


def reference_row(rows: Iterable[Record], name: str = "teacher") -> Record | None:
    """The row of a policy beside which students stand: `teacher` or `reference`."""
    return next((row for row in rows if row["student"] == name), None)


def points(rows: Sequence[Record], part: str = LEVELS) -> list[Point]:
    """All points of a part, student by student: imitation by falling operations, then reward."""
    teacher, reference = reference_row(rows), reference_row(rows, "reference")
    if teacher is None:
        return []
    groups: dict[tuple[str, float, str, bool], list[Record]] = {}
    for row in rows:
        if row.get("part") == part and row.get("operations") is not None:
            key = row["student"], row["level"], row["place"], _rewarded(row)
            groups.setdefault(key, []).append(row)
    beside = [each["scores"] if each else [] for each in (teacher, reference)]
    found = [
        Point(*key[:3], of, *(scores[: len(of[0]["scores"])] for scores in beside))
        for key, of in groups.items()
    ]
    return sorted(found, key=lambda p: (STUDENTS.index(p.student), p.rewarded, -p.level))


def refusals(rows: Sequence[Record]) -> dict[tuple[str, str], str]:
    """(student, place) -> the chip's rule, for chips that refuse the network."""
    return {(r["student"], r["place"]): r["refusal"] for r in rows if r.get("refusal")}


@dataclass(frozen=True)
class Pairing:
    """A spiking point beside the cheapest float one that is as good, by some measure.

    baseline  None where no float student is
    """

    point: Point
    baseline: Point | None
    of: str
    lean: bool
    table: str = INT8

    @property
    def energies(self) -> tuple[float, float | None]:
        """Of the point and of its baseline [J]."""
        mine = self.point.energy(self.of, self.table, self.lean)
        return mine, self.baseline.energy(self.of, self.table) if self.baseline else None

    @property
    def ratio(self) -> float | None:
        """Energy of the point over its baseline's."""
        mine, theirs = self.energies
        return None if theirs is None else mine / theirs


def pairing(found: Sequence[Point], point: Point, of: str, lean: bool = False) -> Pairing:
    """A spiking point beside its baseline by a total (costs.TOTALS) of horowitz45-int8."""
    equal = [p for p in found if p.student in FLOAT and p.of_teacher.mean >= point.of_teacher.mean]
    return Pairing(point, min(equal, key=lambda p: p.energy(of), default=None), of, lean)


def pairing_at(
    found: Sequence[Point], share: float, of: str, lean: bool = False, table: str = INT8
) -> Pairing | None:
    """The cheapest spiking and the cheapest float point with a share of the teacher's score.

    None where no spiking point has it.
    """
    good = [p for p in found if p.of_teacher.mean >= share]
    spiking = [p for p in good if p.student in SPIKING]
    if not spiking:
        return None
    baselines = [p for p in good if p.student in FLOAT]
    mine = min(spiking, key=lambda p: p.energy(of, table, lean))
    baseline = min(baselines, key=lambda p: p.energy(of, table), default=None)
    return Pairing(mine, baseline, of, lean, table)


def span_at(
    found: Sequence[Point], share: float, of: str, lean: bool = False, table: str = INT8
) -> tuple[float | None, float | None]:
    """The least and the largest ratio of `pairing_at`, as the intervals of the scores allow.

    Least: the cheapest spiking point whose interval reaches the share, over the cheapest float one
    that is above it with the whole interval; largest: the other way round. None where either lacks.
    """
    reaching = [p for p in found if p.of_teacher.ci95[1] >= share]
    above = [p for p in found if p.of_teacher.ci95[0] >= share]

    def cheapest(points: Sequence[Point], kinds: Sequence[str], lean: bool) -> float | None:
        return min((p.energy(of, table, lean) for p in points if p.student in kinds), default=None)

    def ratio(spiking: Sequence[Point], baselines: Sequence[Point]) -> float | None:
        mine, theirs = cheapest(spiking, SPIKING, lean), cheapest(baselines, FLOAT, False)
        return mine / theirs if mine and theirs else None

    return ratio(reaching, above), ratio(above, reaching)
