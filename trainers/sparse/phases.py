"""Phases of a sparse training: planned for a budget, or found one after another.

A search trains in dense rounds until validation stops to improve. Then it prunes to a fixed share
of the operations before, level by level, until two levels in a row keep less than the share of the
return of the teacher that was asked for; one level may do so by chance. Shares are of what the
teacher earns more than random actions do, since returns may be negative.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from spikedeploy.trainers.sparse.settings import SparseConfig

_BETTER = 0.01  # share of the teacher's return by which a round is better than those before
_MISSES = 2  # levels one after the other that keep too little: the search is over
_FEWEST = 3.0  # operations below which a search prunes no further
_EXPECTED = 3_000.0  # operations of a dense student, while they are not known


@dataclass(frozen=True)
class Phase:
    """Updates between two collections of walks.

    begin, end: updates
    last: operations allowed at the end; None while dense
    highest, lowest: learning rate at the beginning, and at the end of a half cosine
    prune_until: share of the phase with prunings
    polish: whether the encoder may be left as it is
    """

    begin: int
    end: int
    last: float | None
    highest: float
    lowest: float
    prune_until: float
    polish: bool = False

    def _progress(self, update: int) -> float:
        return (update - self.begin) / (self.end - self.begin)

    def rate(self, update: int) -> float:
        """Learning rate of an update."""
        # lr = low + (high - low) (1 + cos(pi p)) / 2
        cosine = 0.5 * (1 + math.cos(math.pi * self._progress(update)))
        return self.lowest + (self.highest - self.lowest) * cosine

    def prunes(self, update: int) -> bool:
        """Return True if synapses are still taken out."""
        return self.last is not None and self._progress(update) <= self.prune_until

    def goal(self, update: int, first: float) -> float | None:
        """Operations allowed at an update, along a quadratic ramp; None while dense.

        first: operations when the phase began
        """
        if self.last is None:
            return None
        if not self.prune_until:
            return self.last
        left = max(0.0, 1 - self._progress(update) / self.prune_until)
        return self.last + max(0.0, first - self.last) * left * left


@dataclass(frozen=True)
class Ended:
    """The result of a phase of a search.

    goal: operations allowed at its end; None while dense
    operations: operations of a control step, at its end
    share: the best of its validations, of the teacher's return over that of random actions
    """

    goal: float | None
    operations: float
    share: float


def planned(config: SparseConfig) -> list[Phase]:
    """Return the phases of a run whose levels are set, in order."""
    plan = _Plan(config)
    for k in range(config.dense_rounds):
        low = 0.05 if k == config.dense_rounds - 1 else 0.3
        plan.add(plan.dense_length, None, config.learning_rate, low, 0.0)
    for level in config.levels_in_order:
        plan.level(level)
    for _ in range(config.polish):
        plan.polish(config.budget)
    return plan.found


def searched(config: SparseConfig, ended: Sequence[Ended]) -> list[Phase]:
    """Return the phases of a search, of which so many ended; one more unless it is over."""
    plan = _Plan(config)
    for count in range(len(ended) + 1):
        before = ended[:count]
        if not _has_dense(config, before):
            plan.add(plan.dense_length, None, config.learning_rate, 0.05, 0.0)
            continue
        goal = _goal(config, before)
        if goal is not None:
            again = before[-1].goal == goal
            (plan.polish if again else plan.level)(goal)
    return plan.found


def expected_updates(config: SparseConfig, ended: Sequence[Ended]) -> int:
    """Return the updates that a search takes, about: no level is trained on."""
    done = searched(config, ended)
    dense = [each for each in ended if each.goal is None]
    rounds = len(dense) if _has_dense(config, ended) else config.dense_rounds
    first = dense[-1].operations if _has_dense(config, ended) else _EXPECTED
    last = config.budget or _FEWEST
    levels = math.ceil(math.log(max(first / last, 1.0)) / -math.log(config.shrink))
    whole = rounds * _Plan(config).dense_length + levels * config.level_updates
    return max(whole + config.polish * config.polish_updates, done[-1].end)


def target(config: SparseConfig, ended: Sequence[Ended]) -> float:
    """Return the share that pruning keeps: all of it, where the dense student has less."""
    return min(config.keep, max((each.share for each in ended if each.goal is None), default=1.0))


def _has_dense(config: SparseConfig, ended: Sequence[Ended]) -> bool:
    """Return whether enough dense rounds have ended: validation has stopped to improve."""
    shares = [each.share for each in ended if each.goal is None]
    if len(shares) >= config.dense_rounds:
        return True
    before, latest = shares[: -config.patience], shares[-config.patience :]
    return bool(before) and max(latest) < max(before) + _BETTER


def _goal(config: SparseConfig, ended: Sequence[Ended]) -> float | None:
    """Return the operations of the level behind those that ended; None at the end."""
    last = ended[-1]
    tried = sum(each.goal == last.goal for each in ended)
    lower = last.operations if last.goal is None else min(last.goal, last.operations)
    if config.budget:
        if lower <= config.budget:
            over = last.goal == config.budget and tried > config.polish
            return None if over else config.budget
        return max(config.budget, config.shrink * lower)
    wanted = target(config, ended)
    if last.goal is not None and last.share < wanted:
        if tried <= config.polish:
            return last.goal
        if _missed(ended, wanted) == _MISSES:
            return None
    return config.shrink * lower if config.shrink * lower >= _FEWEST else None


def _missed(ended: Sequence[Ended], wanted: float) -> int:
    """Return how many of the latest levels kept too little, each for as often as it was tried."""
    best: dict[float, float] = {}
    for each in ended:
        if each.goal is not None:
            best[each.goal] = max(each.share, best.get(each.goal, each.share))
    kept = [share >= wanted for share in reversed(best.values())]
    return kept.index(True) if True in kept else len(kept)


class _Plan:
    """Phases in order."""

    def __init__(self, config: SparseConfig) -> None:
        self._config = config
        self.found: list[Phase] = []
        self.dense_length = math.ceil(config.dense_updates / max(config.dense_rounds, 1))

    def add(
        self, length: int, last: float | None, high: float, low: float, until: float,
        polish: bool = False,
    ) -> None:  # fmt: skip
        begin = self.found[-1].end if self.found else 0
        self.found.append(Phase(begin, begin + length, last, high, high * low, until, polish))

    def level(self, last: float) -> None:
        c = self._config
        self.add(c.level_updates, last, c.level_rate, 0.1, c.prune_until)

    def polish(self, last: float) -> None:
        # new events may cost a little more than before: prune what is above the goal at once
        c = self._config
        self.add(c.polish_updates, last, c.polish_rate, 0.05, c.prune_until, polish=True)
