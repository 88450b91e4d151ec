"""The ledger while it grows."""

from collections.abc import Sequence
from typing import Any, Literal, Protocol, get_args

import numpy as np

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import EVENTS, Counts, Ledger
from spikedeploy.runtime.errors import ConfigError

Rows = Literal["each", "total", "none"]

# observations that wait to be counted: many are counted in little more time than one
PENDING = 64


class Counter(Protocol):
    """Counts the events of many windows at once.

    batch: B.
    timesteps, steps: of a window, in a layer and in the chip.
    """

    batch: int
    timesteps: int
    steps: int

    def count(self, observations: Sequence[Any]) -> Counts:
        """Counts (S, L, E): a row for each observation and each of its batch."""


class LedgerBuilder:
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
        self._pending: list[Any] = []
        self._counter: Counter | None = None

    @property
    def keeps(self) -> bool:
        """Whether it wants to know anything."""
        return self.rows != "none"

    def observe(self, counter: Counter, observation: Any) -> None:  # noqa: ANN401
        """Take what a counter needs of one inference, or step, of each of a batch."""
        if counter is not self._counter:
            self._count()
            self._counter = counter
        self._pending.append(observation)
        if len(self._pending) * counter.batch >= PENDING:
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

    def __getstate__(self) -> dict[str, Any]:
        """A counter belongs to the memory of one machine, and does not go with a copy."""
        self._count()
        return {**self.__dict__, "_counts": self._counts.copy(), "_counter": None}

    def _count(self) -> None:
        if self._counter and self._pending:
            pending, self._pending = self._pending, []
            counts = self._counter.count(pending)
            self._append(counts, self._counter.timesteps, self._counter.steps)

    def _append(self, counts: Counts, timesteps: int, steps: int) -> None:
        rows = len(counts)
        self._inferences += rows
        self._timesteps += rows * timesteps
        self._steps += rows * steps
        if self.rows == "total":
            # into the memory that is there: a machine may run a thousand times a second
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
