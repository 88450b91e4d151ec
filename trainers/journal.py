"""The journal of a run: what an algorithm reports, to the CSV file, the board and the bar."""

from collections.abc import Mapping

from spikedeploy.trainers.board import TensorBoardLog
from spikedeploy.trainers.metrics import Metrics
from spikedeploy.trainers.progress import ProgressBar
from spikedeploy.trainers.run_folder import RunFolder


class Journal:
    """Where an algorithm reports while it learns."""

    def __init__(self, run: RunFolder, columns: tuple[str, ...], bar: ProgressBar) -> None:
        self.metrics = Metrics(run.metrics, columns)
        self.board = TensorBoardLog(run.path)
        self.bar = bar

    def at(self, step: int, total: int) -> None:
        """Say how far the run is."""
        self.bar.at(step, total)

    def add(self, row: Mapping[str, float]) -> None:
        """Report one row of metrics; its first column is the step."""
        self.metrics.add(row)
        self.board.add(int(row[self.metrics.columns[0]]), row)
        self.bar.show(row)

    def rewind(self, step: int) -> None:
        """Forget the rows after a step, on resuming from it."""
        self.metrics.rewind(step)

    def close(self) -> None:
        """Write what is left."""
        self.board.close()
