"""The progress bar of a run: how far, how long to go, how well."""

from collections.abc import Mapping

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

SHOWN = {  # column of the metrics: how it is shown
    "episode_return": "return {:.0f}",
    "eval_return": "validation {:.0f}",
    "steps_per_s": "{:.0f} steps/s",
}


class ProgressBar:
    """A rich progress bar; silent when quiet or when nobody watches.

    total: steps in all
    """

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
        """Move the bar."""
        self._progress.update(self._task, completed=step, total=total)

    def show(self, row: Mapping[str, float]) -> None:
        """Show the newest return and speed of a metrics row."""
        self._latest.update({key: row[key] for key in SHOWN if key in row})
        note = "  ".join(SHOWN[key].format(value) for key, value in self._latest.items())
        self._progress.update(self._task, note=note)
