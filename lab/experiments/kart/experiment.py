"""The kart experiment: runs the missing parts, shows their progress, writes its page."""

import time
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from types import TracebackType

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from lab.experiments.finishes import progress_of
from lab.experiments.kart.design import ExperimentDesign, Part
from lab.experiments.kart.heldout import TrackEvaluation
from lab.experiments.kart.page import write
from lab.experiments.kart.records import lost
from lab.experiments.trial import Trial
from spikedeploy.console import console
from spikedeploy.jobs import resumable
from spikedeploy.jobs.resumable import Job, JobEnd, Outcome
from spikedeploy.outputs import check_folder
from spikedeploy.parallel import cores
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError

_EVERY = 300.0  # [s] between two lines where there is no terminal
_PAGE_EVERY = 120.0  # [s] between two pages, which read all results


class _ExperimentProgress:
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

    def __enter__(self) -> "_ExperimentProgress":
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
        if not self._console.is_terminal and time.monotonic() - self._last_line > _EVERY:
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


def experiment(
    design: ExperimentDesign,
    only: Sequence[str],
    count: int | None,
    results: Path,
    train: bool = True,
) -> Outcome:
    """Run the missing parts of the experiment.

    only     beginnings of the names of parts, in which * stands for anything; empty for all
    count    processes in parallel; None for one on each core
    results  folder of kart.md and kart/
    train    False only writes the page
    """
    check_folder("--runs", Path(design.folder))
    check_folder("--output", results)
    chip(design.chip)  # raises on an unknown name
    _refuse_loss(design, results)
    for trial in design.trials():
        _check(trial)
    jobs = [_job(part, design) for part in _chosen(design, only) if not part.done] if train else []
    failed: dict[str, str] = {}
    written = [time.monotonic()]
    with _ExperimentProgress(design.folder, len(jobs)) as progress:

        def ended(end: JobEnd) -> None:
            progress.end(end)
            if end.failed:
                failed[end.job.name] = end.last_line
            if time.monotonic() - written[-1] > _PAGE_EVERY:
                write(design, results)
                written.append(time.monotonic())

        whole = resumable.run(jobs, count or cores(), ended, progress.update)
    files = write(design, results)
    done = [part.done for part in design.parts]
    return Outcome(sum(done), len(done), failed, not whole, files)


def _refuse_loss(design: ExperimentDesign, results: Path) -> None:
    """Refuse to write over tables with rows that the new ones would not have."""
    if count := lost(design, results / "kart"):
        raise ConfigError(
            f"the tables of {results / 'kart.md'} have {count} rows that new ones would not, of "
            f"trainings that are not in {design.folder} or were not asked for. Name another folder "
            f"with -o; or `python -m lab kart-trainings unpack --runs {design.folder}` puts "
            "this project's trainings there."
        )


def _check(trial: Trial) -> None:
    """Refuse unknown settings before the first training starts."""
    try:
        trial.config  # noqa: B018 - reading it is what may fail
    except ConfigError as error:
        raise ConfigError(f"{trial.name}: {error}") from error


def _chosen(design: ExperimentDesign, only: Sequence[str]) -> list[Part]:
    """The parts whose names begin so; `*-classic-snn` are those of three worlds."""
    for beginning in only:
        if not any(fnmatchcase(part.name, f"{beginning}*") for part in design.parts):
            known = dict.fromkeys(
                part.name.rpartition("-s")[0] or part.name for part in design.trials()
            )
            raise ConfigError(
                f"no part of the experiment begins with {beginning!r}; known: {', '.join(known)}"
            )
    return [
        part
        for part in design.parts
        if not only or any(fnmatchcase(part.name, f"{beginning}*") for beginning in only)
    ]


def _job(part: Part, design: ExperimentDesign) -> Job:
    log = Path(design.folder) / "logs" / f"{part.name}.log"
    after = [part.of.name] if isinstance(part, TrackEvaluation) else []
    return Job(part.name, f"{type(part).__module__}:perform", log, part.arguments(), after)
