"""A sweep: what is missing is run, every result kept at once, and pages written as it goes."""

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from spikedeploy.console import progress, say
from spikedeploy.jobs.answer import JobBackend
from spikedeploy.jobs.interruption import sigterm_as_interrupt
from spikedeploy.sweeps.evaluation import SweepJob, evaluate_job
from spikedeploy.sweeps.expansion import expand
from spikedeploy.sweeps.grid import SweepGrid
from spikedeploy.sweeps.page import SweepState, write_sweep
from spikedeploy.sweeps.specification import JobSpecification
from spikedeploy.sweeps.store import StoredJob, SweepFolder

_EVERY = 30.0  # [s] between two pages while jobs run,
_SHARE = 20  # and at least so many times what writing one takes


@dataclass(frozen=True)
class SweepOutcome:
    """What a sweep came to.

    state        all that is done so far
    ran          number of jobs that were run now
    interrupted  whether it was stopped from outside
    files        page and CSV
    """

    state: SweepState
    ran: int
    interrupted: bool
    files: list[Path]


def run_sweep(
    grid: SweepGrid, folder: Path, backend: JobBackend, retry: bool = False
) -> SweepOutcome:
    """Run what is missing of a sweep.

    folder   in which results are kept
    backend  that runs the jobs
    retry    whether those that failed are run again
    """
    plan, kept = expand(grid), SweepFolder(folder)
    with kept.alone():
        results = _Results(kept, grid, plan.jobs)
        missing = results.missing(retry)
        say(f"{len(missing)} of {len(plan.jobs)} jobs to do, in {folder}")
        jobs = [SweepJob(job, plan.policies.get(job.sha256)) for job in missing]
        try:
            interrupted = not _run(backend, jobs, results)
        finally:
            files = results.page()
    return SweepOutcome(results.state, results.ran, interrupted, files)


def look_at_sweep(grid: SweepGrid, folder: Path) -> SweepOutcome:
    """What is there of a sweep, also of one that is running, with its page and CSV."""
    results = _Results(SweepFolder(folder), grid, expand(grid).jobs)
    return SweepOutcome(results.state, 0, False, results.page())


def _run(backend: JobBackend, jobs: list[SweepJob], results: "_Results") -> bool:
    """Run the jobs and keep their results; whether none was left out."""
    if not jobs:
        return True
    try:
        with sigterm_as_interrupt(), backend, progress(results.name, len(jobs)) as done:
            for answer in backend.run(evaluate_job, jobs):
                job = jobs[answer.place].of
                results.take(job, results.folder.write(job, answer))
                done()
    except KeyboardInterrupt:
        return False
    return True


class _Results:
    """What is done of a sweep.

    folder  where it is kept
    name    of the sweep
    ran     number of jobs that ended since
    """

    def __init__(
        self, folder: SweepFolder, grid: SweepGrid, jobs: Iterable[JobSpecification]
    ) -> None:
        self.folder, self.name, self.ran = folder, grid.name, 0
        self._grid, self._jobs = grid, list(jobs)
        self._found = {job.key: folder.read(job) for job in self._jobs}
        for file in folder.damaged:
            say(f"{file} is damaged: its job has to be run again")
        self._written, self._took = time.monotonic(), 0.0

    def missing(self, retry: bool) -> list[JobSpecification]:
        """Jobs that were not run yet; with `retry` those that failed, too."""
        return [job for job in self._jobs if _to_do(self._found[job.key], retry)]

    def take(self, job: JobSpecification, found: StoredJob) -> None:
        """Take a result into the tables, which are written from time to time."""
        self._found[job.key], self.ran = found, self.ran + 1
        if time.monotonic() - self._written > max(_EVERY, _SHARE * self._took):
            self.page()

    @property
    def state(self) -> SweepState:
        """All that is done so far."""
        found = {key: each for key, each in self._found.items() if each is not None}
        rows = {key: each.row for key, each in found.items() if each.row is not None}
        failed = {key: each.failed for key, each in found.items() if each.row is None}
        return SweepState(self._grid, self._jobs, rows, failed)

    def page(self) -> list[Path]:
        """Write page and CSV of what is there."""
        began = time.monotonic()
        files = write_sweep(self.state, self.folder.path)
        self._written = time.monotonic()
        self._took = self._written - began
        return files


def _to_do(found: StoredJob | None, retry: bool) -> bool:
    return found is None or (retry and found.row is None)
