"""Points of a task: the trainings of a policy at one place, beside teacher and dense network."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lab.experiments.gymnasium.design import DENSE, RANDOM, ROLES, SPARSE, TEACHER, TUNED
from lab.experiments.gymnasium.tasks import TASKS
from spikedeploy.comparison.statistics import Estimate, nested_ratio, stratified
from spikedeploy.reports.csv_rows import Record


@dataclass(frozen=True, eq=False)
class TaskPoint:
    """A policy at a place, in all its trainings.

    role, place  as in its rows
    rows         of each training seed
    teacher      scores of the teacher on the same episodes
    lowest       what counts as no score: 0, or where the teacher earns less, random actions' mean
    """

    role: str
    place: str
    rows: Sequence[Record]
    teacher: Sequence[float]
    lowest: float

    @cached_property
    def of_teacher(self) -> Estimate:
        """Score in parts of the teacher's; the interval covers trainings and episodes."""
        scores = np.array([row["scores"] for row in self.rows]) - self.lowest
        return nested_ratio(scores, np.array(self.teacher) - self.lowest, np.random.default_rng(0))

    @cached_property
    def earned(self) -> Estimate:
        """Mean return, with the stratified bootstrap over trainings and episodes."""
        return stratified([row["scores"] for row in self.rows], np.random.default_rng(0)).mean

    def mean(self, field: str) -> float | None:
        """Mean of a field over the trainings; None where no row has it."""
        found = [row[field] for row in self.rows if row.get(field) is not None]
        return float(np.mean(found)) if found else None


def points(rows: Sequence[Record]) -> list[TaskPoint]:
    """All points of a task, role by role; none before the teacher is evaluated."""
    scores = {row["role"]: row["scores"] for row in rows if row.get("scores")}
    teacher, drawn = scores.get(TEACHER), scores.get(RANDOM)
    if teacher is None:
        return []
    lowest = 0.0 if np.mean(teacher) > 0 or drawn is None else float(np.mean(drawn))
    groups: dict[tuple[str, str], list[Record]] = {}
    for row in rows:
        if row.get("scores") and len(row["scores"]) == len(teacher):
            groups.setdefault((row["role"], row["place"]), []).append(row)
    order = (TEACHER, DENSE, SPARSE, TUNED, *ROLES, RANDOM)
    found = [TaskPoint(*key, of, teacher, lowest) for key, of in groups.items()]
    return sorted(found, key=lambda point: order.index(point.role))


@dataclass(frozen=True)
class Reference:
    """SOPs of the dense PopSAN in a control step, and whether they were measured."""

    operations: float
    measured: bool


def reference(env: str, found: Sequence[TaskPoint], chip: str) -> Reference:
    """Those of the PopSAN that was trained, else what layer sizes and a rate give."""
    for point in found:
        if (point.role, point.place) == (DENSE, chip):
            return Reference(point.mean("operations") or 0.0, measured=True)
    return Reference(TASKS[env].dense_operations(), measured=False)


def rate_of_trained(tasks: Mapping[str, Sequence[TaskPoint]], chip: str) -> float | None:
    """Mean spike rate on the chip of the dense networks that were trained; None without one."""
    dense = {env: reference(env, found, chip) for env, found in tasks.items()}
    rates = [
        d.operations / TASKS[env].dense_operations(1) for env, d in dense.items() if d.measured
    ]
    return float(np.mean(rates)) if rates else None


def judged(found: Sequence[TaskPoint], chip: str) -> TaskPoint | None:
    """The policy that a verdict is about: with reward where it was trained so, on the chip."""
    at = {point.role: point for point in found if point.place == chip}
    return at.get(TUNED) or at.get(SPARSE)
