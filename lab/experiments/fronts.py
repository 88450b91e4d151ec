"""Points of the front: the trainings of a student at one level, and their cheapest baselines."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from lab.experiments.costs import INT8, TERMS, energies, is_spiking, terms, total
from lab.experiments.pages import grouped, mean
from lab.experiments.pareto import FLOAT, LABELS, LEVELS, REWARD, SPIKING, STUDENTS
from lab.experiments.training import Record, read_rows
from spikedeploy.comparison.statistics import (
    Estimate,
    ReturnEstimates,
    nested_ratio,
    stratified_bootstrap,
)
from spikedeploy.reports.table import write_rows

_FIRST = (
    "env", "student", "trained_by", "seed", "level", "place", "part", "episodes", "return_mean",
    "falls", "lap_time", "crashes", "operations", "graded_operations", "bias_operations", "neurons",
    "neuron_updates", "readout_updates", "neuron_idle", "messages", "events", "spikes_out",
    "sparsity", "saturations", "observations", "constants", "on_host", "refusal",
    "training_seeds",
)  # fmt: skip
_LAST = "scores"  # of the episodes, in the order of their seeds
_POINT = ("student", "trained_by", "level", "place", "part")  # rows that differ in the seed alone


def write_table(found: Iterable[Record], path: Path) -> Path:
    """Write rows with their energies, one a training; missing fields stay empty.

    `training_seeds` says how many trainings a policy has at that level and place. `scores` are
    returns of walkers; of karts they are finishes, and `returns` stand beside.
    """
    rows = [row | energies(row) for row in found]
    for _, of in grouped(rows, *_POINT):
        for row in of:
            if row.get("level") is not None:  # shipped references have none
                row["training_seeds"] = len(of)
    names = dict.fromkeys(name for row in rows for name in row)
    more = [name for name in names if name not in _FIRST and name != _LAST]
    return write_rows(rows, [*_FIRST, *more, _LAST], path)


def read_table(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, ("env", "student", "trained_by", "place", "part", "refusal"))


@dataclass(frozen=True, eq=False)
class Point:
    """A policy at one level and place, in all its trainings.

    rows       of each training seed
    teacher    scores of the teacher on the same episodes
    reference  those of the reference; empty where there is none
    lowest     the score that counts as none
    """

    rows: Sequence[Record]
    teacher: Sequence[float]
    reference: Sequence[float] = ()
    lowest: float = 0.0

    @cached_property
    def of_teacher(self) -> Estimate:
        """Score in parts of the teacher's; the interval covers trainings and episodes."""
        return self._of(self.teacher)

    @cached_property
    def of_reference(self) -> Estimate | None:
        """Score in parts of the reference's, likewise."""
        return self._of(self.reference) if self.reference else None

    def _of(self, reference: Sequence[float]) -> Estimate:
        scores = np.array([row["scores"] for row in self.rows])
        return nested_ratio(scores - self.lowest, np.array(reference) - self.lowest)

    @property
    def single(self) -> list[float]:
        """Score of each training in parts of the teacher's."""
        teacher = float(np.mean(self.teacher)) or math.nan
        return [float(np.mean(row["scores"])) / teacher for row in self.rows]

    def mean(self, field: str) -> float | None:
        """Mean of a field over the trainings; None where no row has it."""
        return mean(self.rows, field)

    def energy(self, of: str, table: str = INT8, lean: bool = False) -> float:
        """Mean energy [J] of a total (costs.TOTALS)."""
        return float(np.mean([total(row, table, of, lean) for row in self.rows]))

    def terms(self, lean: bool = False, table: str = INT8) -> dict[str, float]:
        """Mean energy [J] of each term."""
        each = [terms(row, table, lean) for row in self.rows]
        return {name: float(np.mean([one[name] for one in each])) for name in TERMS}

    @property
    def student(self) -> str:
        """Its kind."""
        return str(self.rows[0]["student"])

    @property
    def level(self) -> float:
        """Operations that it aims at."""
        return float(self.rows[0]["level"])

    @property
    def place(self) -> str:
        """Where it ran."""
        return str(self.rows[0]["place"])

    @property
    def is_rewarded(self) -> bool:
        """Return whether it was trained on with reward."""
        return self.rows[0].get("trained_by") == REWARD

    @property
    def label(self) -> str:
        """`LIF`, or `LIF, with reward`."""
        return f"{LABELS[self.student]}{', with reward' if self.is_rewarded else ''}"

    @property
    def is_spiking(self) -> bool:
        """Return whether it spikes, or is delta-coded."""
        return is_spiking(self.rows[0])


def return_estimates(rows: Sequence[Record]) -> ReturnEstimates | None:
    """Mean, IQM and risk of the returns of rows on the same episodes; None where these lack."""
    returns = [row.get("returns") or ([] if is_kart(row) else row["scores"]) for row in rows]
    return _estimates(tuple(map(tuple, returns))) if all(returns) else None


def mean_score(rows: Sequence[Record]) -> Estimate:
    """Mean score of rows on the same episodes: the return of walkers, finishes of karts."""
    return _estimates(tuple(tuple(row["scores"]) for row in rows)).mean


@cache  # the page is written again while the experiment runs
def _estimates(values: tuple[tuple[float, ...], ...]) -> ReturnEstimates:
    return stratified_bootstrap(values, np.random.default_rng(0))


def is_kart(row: Record) -> bool:
    """Return whether a row is of a kart, whose scores are finishes."""
    return row.get("crashes") is not None


def reference_rows(rows: Iterable[Record]) -> dict[str, Record]:
    """Name -> row of the policies beside which students stand: `teacher` and `reference`."""
    found = {row["student"]: row for row in reversed(list(rows))}
    return {name: found[name] for name in ("teacher", "reference") if name in found}


def points(rows: Sequence[Record], part: str = LEVELS) -> list[Point]:
    """All points of a part, student by student: imitation by falling operations, then reward."""
    references = reference_rows(rows)
    if "teacher" not in references:
        return []
    beside = [row["scores"] for row in references.values()]
    here = (row for row in rows if row.get("part") == part and row.get("operations") is not None)
    found = [
        Point(of, *(scores[: len(of[0]["scores"])] for scores in beside))
        for _, of in grouped(here, "student", "level", "place", "trained_by")
    ]
    return sorted(found, key=lambda p: (STUDENTS.index(p.student), p.is_rewarded, -p.level))


@dataclass(frozen=True)
class Pairing:
    """A spiking point beside the cheapest float one that is as good, by some measure.

    baseline   None where no float student is
    of, table  the total (costs.TOTALS), and the prices
    lean       as in costs.terms
    """

    point: Point
    baseline: Point | None
    of: str
    lean: bool = False
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
    equal = [p for p in found if p.of_teacher.mean >= point.of_teacher.mean]
    return Pairing(point, _cheapest(equal, FLOAT, of), of, lean)


def pairing_at(
    found: Sequence[Point], share: float, of: str, lean: bool = False, table: str = INT8
) -> Pairing | None:
    """The cheapest spiking and the cheapest float point with a share of the teacher's score.

    None where no spiking point has it.
    """
    good = [p for p in found if p.of_teacher.mean >= share]
    return _pair(good, good, of, lean, table)


def span_at(
    found: Sequence[Point], share: float, of: str, lean: bool = False, table: str = INT8
) -> tuple[float | None, float | None]:
    """The least and the largest ratio of `pairing_at`, as the intervals of the scores allow.

    Least: the cheapest spiking point whose interval reaches the share, over the cheapest float one
    that is above it with the whole interval; largest: the other way round. None where either lacks.
    """
    reaching = [p for p in found if p.of_teacher.ci95[1] >= share]
    above = [p for p in found if p.of_teacher.ci95[0] >= share]
    least = _pair(reaching, above, of, lean, table)
    largest = _pair(above, reaching, of, lean, table)
    return least.ratio if least else None, largest.ratio if largest else None


def _pair(
    spiking: Sequence[Point], baselines: Sequence[Point], of: str, lean: bool, table: str
) -> Pairing | None:
    mine = _cheapest(spiking, SPIKING, of, table, lean)
    theirs = _cheapest(baselines, FLOAT, of, table)
    return Pairing(mine, theirs, of, lean, table) if mine else None


def _cheapest(
    found: Sequence[Point], students: Sequence[str], of: str, table: str = INT8, lean: bool = False
) -> Point | None:
    here = (p for p in found if p.student in students)
    return min(here, key=lambda p: p.energy(of, table, lean), default=None)
