"""Tables that a training appends to, checked against a checkpoint before it goes on."""

import csv
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.atomic import flush
from spikedeploy.trainers.metrics import Metrics, read, renamed


@dataclass(frozen=True)
class Table:
    """A CSV file of a run.

    path: of the file
    columns: names, of which the first is the step
    key: of a checkpoint's state; there stands the step of the last row, None before there is one
    """

    path: Path
    columns: tuple[str, ...]
    key: str

    def flush(self) -> None:
        """Put the rows onto the disk, before a checkpoint relies on them."""
        if self.path.is_file():
            flush(self.path)

    def clear(self) -> None:
        """Drop all rows, whatever the file holds; before it is made, do nothing."""
        if self.path.is_file():
            Metrics(self.path, self.columns).clear()

    def check(self, step: float, state: Mapping[str, Any]) -> None:
        """Refuse a run to be resumed at `step` where rows before are damaged or lost."""
        known = self.key in state  # not in checkpoints of before
        logged = state.get(self.key)
        unit = self.columns[0].replace("_", " ")
        if fault := self._fault(logged, known):
            raise ConfigError(
                f"{self.path} is damaged: {fault}. Put it back, or move it away: then a new one "
                f"begins at {step:g} {unit}. The policy is not affected."
            )
        if logged is not None and not (self.path.is_file() and read(self.path)):
            print(f"{self.path} has no rows: they begin at {step:g} {unit}", file=sys.stderr)

    def _fault(self, logged: float | None, known: bool) -> str:
        """Return what is wrong; nothing where the file is whole or missing."""
        if not self.path.is_file():
            return ""
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
            cells = list(csv.reader(lines))
            rows = read(self.path)
        except (ConfigError, ValueError, csv.Error):
            return "it is no table of numbers"
        head = [renamed(name) for name in (cells[0] if cells else [])]
        if fault := self._head_fault(head):
            return fault
        cut = not lines[-1].endswith("\n")
        steps = [row.get(self.columns[0], math.nan) for row in rows[: -1 if cut else None]]
        reached = logged is None or max(steps, default=-math.inf) >= logged
        if cut and not (known and reached):
            return "a line is cut off"
        if any(len(each) != len(head) for each in (cells[:-1] if cut else cells)):
            return "a line is cut off"
        if not all(map(math.isfinite, steps)):
            return f"a row has no {self.columns[0]}"
        if logged is not None and steps and not reached:
            return f"its rows end at {max(steps):g}, and were written up to {logged:g}"
        return ""

    def _head_fault(self, head: list[str]) -> str:
        """Return what is wrong with the names of the columns."""
        if self.columns[0] not in head:
            return f"its first line is not the names of columns, of which {self.columns[0]} is one"
        if other := sorted(set(head) - set(self.columns)):
            return f"it has a column {other[0]}, which this recipe does not write"
        return ""
