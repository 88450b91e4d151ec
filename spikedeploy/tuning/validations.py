"""Reports the validations of a training to its trial, and ends it where it is hopeless."""

from pathlib import Path
from typing import TYPE_CHECKING

from spikedeploy.trainers import metrics
from spikedeploy.trainers.progress import Interrupt

if TYPE_CHECKING:
    import optuna


class Validations(Interrupt):
    """The request to stop of a training: of Ctrl-C, or of the pruner.

    pruned: whether it was the pruner's.
    """

    def __init__(self, trial: "optuna.Trial", folder: Path, prunes: bool) -> None:
        super().__init__()
        self._trial, self._folder, self._prunes = trial, folder, prunes
        self._size, self._reported = -1, -1.0
        self.pruned = False

    def __call__(self) -> bool:
        """Whether the training is to stop; asked after each iteration."""
        if self._prunes and not self.pruned:
            self.pruned = self._look()
        return self.pruned or super().__call__()

    def _look(self) -> bool:
        """Report what is new in the run's metrics; whether the pruner gives the trial up."""
        file = next(iter(self._folder.glob("*/metrics.csv")), None)
        if file is None or (size := file.stat().st_size) == self._size:
            return False
        self._size = size
        for row in metrics.read(file):
            step = next(iter(row.values()))
            if "eval_return" in row and step > self._reported:
                self._reported = step
                self._trial.report(row["eval_return"], int(step))
        return self._reported >= 0 and self._trial.should_prune()
