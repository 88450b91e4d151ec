"""Progress of a running experiment: bars on a terminal, else a line from time to time."""

import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from spikedeploy.console import console
from spikedeploy.experiments.finishes import progress_of
from spikedeploy.experiments.workers import Job, JobEnd

EVERY = 300.0  # [s] between two lines where there is no terminal


class ExperimentProgress:
    """Progress bars of the experiment and of its running parts.

    folder  of the trials, whose metrics are read
    jobs    number of parts to do
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
        self._total = self._bars.add_task("experiment", total=jobs, note="parts")
        self._tasks: dict[str, TaskID] = {}
        self._last_line = time.monotonic()

    def __enter__(self) -> "ExperimentProgress":
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bars.stop()

    def update(self, running: Sequence[Job]) -> None:
        """Show the progress of the running parts."""
        for job in running:
            if job.name not in self._tasks:
                self._tasks[job.name] = self._bars.add_task(job.name, total=None, note="")
            found = progress_of(self._folder, job.name)
            if found:
                note = f"steps, {found.finishes:,} finishes"
                self._bars.update(self._tasks[job.name], completed=found.steps, note=note)
        if not self._console.is_terminal and time.monotonic() - self._last_line > EVERY:
            self._last_line = time.monotonic()
            self._say("running: " + "; ".join(self._line(job) for job in running))

    def end(self, end: JobEnd) -> None:
        """Report how a part ended."""
        if end.job.name in self._tasks:
            self._bars.remove_task(self._tasks.pop(end.job.name))
        if end.status == 0:
            self._bars.advance(self._total)
            self._say(f"✓ {self._line(end.job)} ({end.seconds / 60:.1f} min)")
        elif end.failed:
            self._say(f"✗ {end.job.name}: {end.last_line} ({end.job.log})")
        else:
            self._say(f"… {self._line(end.job)}, to be continued")

    def _line(self, job: Job) -> str:
        found = progress_of(self._folder, job.name)
        return (
            f"{job.name}: {found.steps:,} steps, {found.finishes:,} finishes" if found else job.name
        )

    def _say(self, line: str) -> None:
        self._console.print(line, markup=False)
