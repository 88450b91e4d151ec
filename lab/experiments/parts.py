"""Missing parts of an experiment: run as jobs, reported, and the page written of what is there."""

import shlex
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from spikedeploy.console import console
from spikedeploy.jobs import resumable
from spikedeploy.jobs.resumable import Job, JobEnd, Outcome

_EVERY = 300.0  # [s] between two lines on what runs


@dataclass(frozen=True)
class Report:
    """What an experiment says while it runs, and what it leaves.

    left, of    number of parts to do, and of all; a job may do several
    done        of each part, whether nothing is missing
    write       the page and its files
    often       whether the page is written after each job
    progress    a running job, and how far it is; without it nothing is said between two ends
    """

    left: int
    of: int
    done: Callable[[], Sequence[bool]]
    write: Callable[[], list[Path]]
    often: bool = True
    progress: Callable[[Job], str] | None = None


class ExperimentPart(Protocol):
    """A part that is a job of its own."""

    @property
    def job(self) -> Job:
        """What does it."""

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""


Part = TypeVar("Part", bound=ExperimentPart)


def parts_to_do(parts: Sequence[Part], only: Sequence[str], train: bool) -> list[Part]:
    """The parts that are not done and whose names begin so; none where nothing is to be trained.

    Raises ConfigError where a beginning is of none.
    """
    names = resumable.chosen([part.job.name for part in parts], only)
    return [p for p in parts if p.job.name in names and not p.done] if train else []


def run_parts(
    parts: Sequence[ExperimentPart],
    to_do: Sequence[ExperimentPart],
    count: int | None,
    write: Callable[[], list[Path]],
    progress: Callable[[Job], str],
) -> Outcome:
    """Run those parts that are to do, one job each; write and progress as in Report."""
    report = Report(
        len(to_do), len(parts), lambda: [part.done for part in parts], write, progress=progress
    )
    return run_missing([part.job for part in to_do], count or 1, report)


def command_line() -> str:
    """The command that this process runs, as it can be typed again."""
    return f"{sys.argv[0]} {shlex.join(sys.argv[1:])}"


def run_missing(jobs: Sequence[Job], count: int, report: Report) -> Outcome:
    """Run the jobs of what is missing, `count` at a time; then write the page."""
    failed: dict[str, str] = {}
    _say(f"{report.left} of {report.of} parts to do")

    def ended(end: JobEnd) -> None:
        _say(end.line)
        if end.failed:
            failed[end.job.name] = end.last_line
        if report.often:
            report.write()

    whole = resumable.run(jobs, count, ended, _look(report))
    files = report.write()
    return Outcome(sum(report.done()), report.of, failed, not whole, files)


def _look(report: Report) -> Callable[[Sequence[Job]], None]:
    """What says from time to time which jobs run."""
    said = time.monotonic()

    def look(running: Sequence[Job]) -> None:
        nonlocal said
        if report.progress is not None and time.monotonic() - said > _EVERY:
            said = time.monotonic()
            _say("running: " + "; ".join(map(report.progress, running)))

    return look


def _say(line: str) -> None:
    console(stderr=True).print(line, markup=False, soft_wrap=True)
