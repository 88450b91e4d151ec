"""What people see of a running experiment: bars on a terminal, and now and then a line in a log."""

import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from spikedeploy.console import console
from spikedeploy.experiments.finishes import how_far
from spikedeploy.experiments.workers import Ended, Job

EVERY = 300.0  # between two lines where there is no terminal [s]


class ProgressBoard:
    """How far the experiment and its running parts are.

    folder  of the trials, whose metrics tell how far they are
    jobs    that are to be done
    """

    def __init__(self, folder: str, jobs: int) -> None:
        self._folder = Path(folder)
        self._console = console(stderr=True)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            console=self._console,
            transient=True,
        )
        self._whole = self._bars.add_task("experiment", total=jobs, note="parts")
        self._tasks: dict[str, TaskID] = {}
        self._spoke = time.monotonic()

    def __enter__(self) -> "ProgressBoard":
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bars.stop()

    def look(self, running: Sequence[Job]) -> None:
        """Show how far the running parts are."""
        for job in running:
            if job.name not in self._tasks:
                self._tasks[job.name] = self._bars.add_task(job.name, total=None, note="")
            found = how_far(self._folder, job.name)
            if found:
                note = f"steps, {found.finishes:,} finishes"
                self._bars.update(self._tasks[job.name], completed=found.steps, note=note)
        if not self._console.is_terminal and time.monotonic() - self._spoke > EVERY:
            self._spoke = time.monotonic()
            self._say("running: " + "; ".join(self._line(job) for job in running))

    def ended(self, end: Ended) -> None:
        """Say how a part ended."""
        if end.job.name in self._tasks:
            self._bars.remove_task(self._tasks.pop(end.job.name))
        if end.status == 0:
            self._bars.advance(self._whole)
            self._say(f"✓ {self._line(end.job)} ({end.seconds / 60:.1f} min)")
        elif end.failed:
            self._say(f"✗ {end.job.name}: {end.last_words} ({end.job.log})")
        else:
            self._say(f"… {self._line(end.job)}, to be continued")

    def _line(self, job: Job) -> str:
        found = how_far(self._folder, job.name)
        return (
            f"{job.name}: {found.steps:,} steps, {found.finishes:,} finishes" if found else job.name
        )

    def _say(self, line: str) -> None:
        self._console.print(line, markup=False)
