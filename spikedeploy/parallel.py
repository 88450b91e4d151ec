"""Jobs, pure functions of a specification, whose results are wanted in order."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from spikedeploy.jobs.answer import JobBackend
from spikedeploy.jobs.environment import WORKER_ENVIRONMENT
from spikedeploy.jobs.processes import ProcessBackend
from spikedeploy.jobs.serial import SerialBackend

__all__ = ["WORKER_ENVIRONMENT", "cores", "local_backend", "workers"]

Job = TypeVar("Job")
Result = TypeVar("Result")


class _Jobs:
    """Runs jobs on a back-end, whose processes, if it has any, take a second each to start."""

    def __init__(self, backend: JobBackend) -> None:
        self._backend = backend

    def run(
        self, function: Callable[[Job], Result], jobs: Sequence[Job], done: Callable[[], object]
    ) -> list[Result]:
        """The results in the order of the jobs; `done` is called after each."""
        results: dict[int, Result] = {}
        for answer in self._backend.run(function, jobs):
            results[answer.place] = answer.result()
            done()
        return [results[place] for place in range(len(jobs))]


@contextmanager
def workers(count: int | None) -> Iterator[_Jobs]:
    """A runner with `count` processes, one for each core by default; with 1 in this process."""
    with local_backend(count) as backend:
        yield _Jobs(backend)


def local_backend(count: int | None) -> JobBackend:
    """`count` processes on this machine, one for each core by default; with 1 this process."""
    count = count or cores()
    return SerialBackend() if count == 1 else ProcessBackend(count)


def cores() -> int:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
