"""Jobs, pure functions of a specification, run in this process or in several of one thread each."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import TypeVar

from spikedeploy.runtime.errors import SpikedeployError

Job = TypeVar("Job")
Result = TypeVar("Result")

# Workers do not render, and one thread each is faster than many threads in all.
WORKER_ENVIRONMENT = {
    "MUJOCO_GL": "disable",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}


class _Jobs:
    """Runs jobs, in a pool if there is one, whose processes take a second each to start."""

    def __init__(self, pool: ProcessPoolExecutor | None) -> None:
        self._pool = pool

    def run(
        self, function: Callable[[Job], Result], jobs: Sequence[Job], done: Callable[[], object]
    ) -> list[Result]:
        """The results in the order of the jobs; `done` is called after each."""
        results = []
        try:
            for result in self._map(function, jobs):
                results.append(result)
                done()
        except BrokenProcessPool as error:
            raise SpikedeployError(
                "a worker process was killed, probably for memory: run again with fewer --workers"
            ) from error
        return results

    def _map(self, function: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
        return map(function, jobs) if self._pool is None else self._pool.map(function, jobs)


@contextmanager
def workers(count: int | None) -> Iterator[_Jobs]:
    """A runner with `count` processes, one for each core by default; with 1 in this process."""
    count = count or cores()
    if count == 1:
        yield _Jobs(None)
        return
    context = get_context("spawn")
    others = set(active_children())
    with (
        _environment(WORKER_ENVIRONMENT),
        ProcessPoolExecutor(count, context, initializer=_ignore_interrupts) as pool,
    ):
        try:
            yield _Jobs(pool)
        except BaseException:
            for worker in set(active_children()) - others:
                worker.terminate()  # Ctrl-C ends at once; jobs are pure, so nothing is lost
            pool.shutdown(cancel_futures=True)
            raise


def _ignore_interrupts() -> None:
    """Ignore Ctrl-C, which reaches every process of the terminal: the parent handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def cores() -> int:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _environment(changes: dict[str, str]) -> Iterator[None]:
    """Environment variables for processes that are started within the block."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
