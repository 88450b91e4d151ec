"""The recorder: the ledger while it grows."""

from typing import Literal, get_args

import numpy as np

from runtime.errors import ConfigError
from runtime.ledger import EVENTS, Counts, Ledger
from runtime.program import Program
from runtime.tally import Observation, Tally

Rows = Literal["each", "total", "none"]

# observations that wait to be counted: many are counted in little more time than one
PENDING = 64


class Recorder:
    """Rows of counts, from observations that are counted when there are enough of them.

    rows: "each" keeps a row per control step; "total" adds them up; "none" keeps nothing.
    """

    def __init__(self, program: Program, rows: Rows = "each") -> None:
        if rows not in get_args(Rows):
            raise ConfigError(f"ledger {rows!r} is unknown. Choose 'each', 'total' or 'none'.")
        self.rows = rows
        self._program = program
        self._counts = np.zeros((1, len(program.layers), len(EVENTS)), np.int64)
        self._used = self._inferences = self._timesteps = self._steps = 0
        self._pending: list[Observation] = []
        self._tally: Tally | None = None

    @property
    def keeps(self) -> bool:
        """Whether it wants to know anything."""
        return self.rows != "none"

    def observe(self, tally: Tally, seen: Observation) -> None:
        """Take the observation of one inference, or step, of each of a batch."""
        if tally is not self._tally:
            self._count()
            self._tally = tally
        self._pending.append(seen)
        if len(self._pending) * tally.batch >= PENDING:
            self._count()

    def add(self, counts: Counts, timesteps: int, steps: int) -> None:
        """Take counts (S, L, E); each row took so many timesteps of a layer and of the chip."""
        self._count()
        self._append(counts, timesteps, steps)

    def ledger(self) -> Ledger:
        """Everything recorded so far."""
        self._count()
        return Ledger(
            layers=tuple(layer.name for layer in self._program.layers),
            neurons=tuple(layer.size for layer in self._program.layers),
            counts=self._counts[: self._used].copy(),
            inferences=self._inferences,
            timesteps=self._timesteps,
            steps=self._steps,
            several=self._program.chip.spikes_max > 1,
        )

    def _count(self) -> None:
        if self._tally and self._pending:
            pending, self._pending = self._pending, []
            self._append(self._tally.count(pending), self._tally.timesteps, self._tally.steps)

    def _append(self, counts: Counts, timesteps: int, steps: int) -> None:
        rows = len(counts)
        self._inferences += rows
        self._timesteps += rows * timesteps
        self._steps += rows * steps
        if self.rows == "total":
            # into memory that is there: a machine may come by a thousand times a second
            for row in counts:
                np.add(self._counts[0], row, self._counts[0])
            self._used = 1
            return
        end = self._used + len(counts)
        if end > len(self._counts):
            grown = np.zeros((2 * end, *self._counts.shape[1:]), np.int64)
            grown[: self._used] = self._counts[: self._used]
            self._counts = grown
        self._counts[self._used : end] = counts
        self._used = end
