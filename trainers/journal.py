"""Journal of a run: rows of metrics, to CSV file, TensorBoard and progress bar."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from spikedeploy.trainers.metrics import Metrics
from spikedeploy.trainers.run_folder import RunFolder

_SHOWN = {  # metrics beside the progress bar, and their formats
    "episode_return": "return {:.0f}",
    "eval_return": "validation {:.0f}",
    "steps_per_s": "{:.0f} steps/s",
}


class Journal:
    """What an algorithm reports to while it learns."""

    def __init__(self, run: RunFolder, columns: tuple[str, ...], bar: "ProgressBar") -> None:
        self.metrics = Metrics(run.metrics, columns)
        self.board = _TensorBoardLog(run.path)
        self.bar = bar

    def at(self, step: int, total: int) -> None:
        """Report progress."""
        self.bar.at(step, total)

    def add(self, row: Mapping[str, float]) -> None:
        """Report one row of metrics; values without a column are dropped."""
        known = {name: row[name] for name in self.metrics.columns if name in row}
        self.metrics.add(known)
        self.board.add(int(row[self.metrics.columns[0]]), known)
        self.bar.show(known)

    def rewind(self, step: int) -> None:
        """Drop the rows after a step, on resuming from it."""
        self.metrics.rewind(step)

    def close(self) -> None:
        """Close the files."""
        self.board.close()


class _TensorBoardLog:
    """TensorBoard event file in the run folder; does nothing if TensorBoard is not installed."""

    def __init__(self, folder: Path) -> None:
        self._writer: Any = None
        if find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(folder))

    def add(self, step: int, row: Mapping[str, float]) -> None:
        """Add one point to the curve of each column."""
        if self._writer is not None:
            for name, value in row.items():
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close the file."""
        if self._writer is not None:
            self._writer.close()


class ProgressBar:
    """Progress bar of a run with the latest returns and speed; hidden if quiet."""

    def __init__(self, title: str, quiet: bool = False) -> None:
        self._latest: dict[str, float] = {}
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            disable=quiet,
        )
        self._task = self._progress.add_task(title, total=None, note="")

    def __enter__(self) -> "ProgressBar":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def at(self, step: int, total: int) -> None:
        """Set the bar to a step."""
        self._progress.update(self._task, completed=step, total=total)

    def show(self, row: Mapping[str, float]) -> None:
        """Show the returns and speed of a row of metrics."""
        self._latest.update({key: row[key] for key in _SHOWN if key in row})
        note = "  ".join(_SHOWN[key].format(value) for key, value in self._latest.items())
        self._progress.update(self._task, note=note)
