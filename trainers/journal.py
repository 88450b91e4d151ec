"""Journal of a run: rows of metrics, to CSV file, TensorBoard and progress bar."""

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikedeploy.trainers.metrics import Metrics, spike_rate
from spikedeploy.trainers.run_folder import RunFolder

if TYPE_CHECKING:
    from spikedeploy.trainers.progress import ProgressBar


class Journal:
    """What an algorithm reports to while it learns."""

    def __init__(
        self,
        run: RunFolder,
        columns: tuple[str, ...],
        bar: "ProgressBar",
        watch: Callable[[Path], None] | None = None,
        film: Callable[[Path, int, int], None] | None = None,
    ) -> None:
        """watch: is called with the run folder after each row.

        film: likewise, with the step and the steps of the whole training too
        """
        self._path, self._watch, self._film = run.path, watch, film
        self._progress = 0, 1
        self.metrics = Metrics(run.metrics, columns)
        self.board = _TensorBoardLog(run.path)
        self.bar = bar

    def at(self, step: int, total: int) -> None:
        """Report progress."""
        self._progress = step, total
        self.bar.at(step, total)

    def add(self, row: Mapping[str, float]) -> None:
        """Report one row of metrics; values without a column are dropped."""
        known = {name: row[name] for name in self.metrics.columns if name in row}
        self.metrics.add(known)
        seen = _seen(row)
        self.board.add(int(row[self.metrics.columns[0]]), {**known, **seen})
        self.bar.show({**row, **seen})
        if self._watch is not None:
            self._watch(self._path)
        if self._film is not None:
            self._film(self._path, *self._progress)

    def rewind(self, step: int) -> None:
        """Drop the rows after a step, on resuming from it."""
        self.metrics.rewind(step)
        self.board.rewind(step)

    def close(self) -> None:
        """Close the files."""
        self.board.close()


def _seen(row: Mapping[str, float]) -> dict[str, float]:
    """Success and spike rate of a validation, for TensorBoard and people; the CSV has neither."""
    seen = {}
    if success := [row[name] for name in ("eval_success", "eval_finish") if name in row]:
        seen["eval_success"] = success[0]
    if (rate := spike_rate(row)) is not None:
        seen["spike_rate"] = rate
    return seen


class _TensorBoardLog:
    """TensorBoard event file in the run folder; does nothing if TensorBoard is not installed."""

    def __init__(self, folder: Path) -> None:
        self._writer: Any = None
        self._folder = folder
        if find_spec("tensorboard") is not None:
            self._open()

    def _open(self, purge_step: int | None = None) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(self._folder), purge_step=purge_step)

    def rewind(self, step: int) -> None:
        """Let TensorBoard hide the points after a step."""
        if self._writer is not None:
            self._writer.close()
            self._open(step + 1)

    def add(self, step: int, row: Mapping[str, float]) -> None:
        """Add one point to the curve of each column."""
        if self._writer is not None:
            for name, value in row.items():
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close the file."""
        if self._writer is not None:
            self._writer.close()
