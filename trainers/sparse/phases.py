"""Phases of training: dense, levels of pruning, polish."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # pages of cards need LEVEL, and no pydantic
    from spikedeploy.trainers.sparse.config import SparseConfig

LEVEL = "ops-"  # and operations: names of the best checkpoints of the levels of pruning


@dataclass(frozen=True)
class Phase:
    """Updates between two collections of walks.

    begin, end: updates
    last: operations allowed at the end; None while dense
    highest, lowest: learning rate at the beginning, and at the end of a half cosine
    prune_until: share of the phase with prunings
    """

    begin: int
    end: int
    last: float | None
    highest: float
    lowest: float
    prune_until: float

    def _progress(self, update: int) -> float:
        return (update - self.begin) / (self.end - self.begin)

    def rate(self, update: int) -> float:
        """Learning rate of an update."""
        # lr = low + (high - low) (1 + cos(pi p)) / 2
        cosine = 0.5 * (1 + math.cos(math.pi * self._progress(update)))
        return self.lowest + (self.highest - self.lowest) * cosine

    def prunes(self, update: int) -> bool:
        """Whether synapses are still taken out."""
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


def phases(config: "SparseConfig") -> list[Phase]:
    """Return the phases of a run, in order."""
    return list(_phases(config))


def _phases(config: "SparseConfig") -> Iterator[Phase]:
    update = 0
    each = math.ceil(config.dense_updates / config.dense_rounds)
    for k in range(config.dense_rounds):
        final = k == config.dense_rounds - 1
        low = config.learning_rate * (0.05 if final else 0.3)
        yield Phase(update, update + each, None, config.learning_rate, low, 0.0)
        update += each
    for level in config.rounds:
        yield Phase(
            update, update + config.level_updates, level,
            config.level_rate, config.level_rate * 0.1, config.prune_until,
        )  # fmt: skip
        update += config.level_updates
    for _ in range(config.polish):
        # new events may cost a little more than before: prune what is above the budget at once
        yield Phase(
            update, update + config.polish_updates, config.budget,
            config.polish_rate, config.polish_rate * 0.05, config.prune_until,
        )  # fmt: skip
        update += config.polish_updates
