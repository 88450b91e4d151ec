"""Pure functions of a job each, run here or in processes: every job has one result.

A job that fails has its error as result, and one whose worker is killed is run once more. Results
come in the order of completion; `in_order` sorts them. `jobs.ray_cluster` has the same interface.
"""

import os
import pickle
import signal
import socket
import sys
import threading
import time
import traceback
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context, parent_process
from types import FrameType, TracebackType
from typing import Any, TypeVar

from spikedeploy.runtime.errors import SpikedeployError

# Workers do not render, and one thread each is faster than many threads in all.
WORKER_ENVIRONMENT = {
    "MUJOCO_GL": "disable",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}
_ATTEMPTS = 2  # of a job whose worker is killed
_MAX_FAILED_STARTS = 3  # of workers, one after the other
_PATIENCE = 5.0  # [s] for a worker to end before it is killed

Function = Callable[[Any], Any]
Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True)
class JobResult:
    """The result of a job.

    index    of the job in the sequence
    value    that the function returned; None where it failed
    error    that it raised; None where it did not
    trace    traceback of that, as text
    seconds  of run time
    worker   host:process
    """

    index: int
    value: Any = None
    error: Exception | None = None
    trace: str = ""
    seconds: float = 0.0
    worker: str = ""

    def result(self) -> Any:  # noqa: ANN401 - of whatever function it was
        """Return what the function returned; raise what it raised."""
        if self.error is not None:
            raise self.error from (RuntimeError(self.trace) if self.trace else None)
        return self.value


def run_job(function: Function, index: int, job: object) -> JobResult:
    """Run a job in this process."""
    began, worker = time.perf_counter(), f"{socket.gethostname()}:{os.getpid()}"
    try:
        result = JobResult(index, function(job), worker=worker)
    except Exception as error:
        result = JobResult(index, None, error, traceback.format_exc(), worker=worker)
    return replace(result, seconds=time.perf_counter() - began)


def lost(index: int) -> JobResult:
    """The result of a job whose worker was killed at every attempt."""
    return JobResult(
        index,
        error=SpikedeployError(
            "a worker process was killed, probably for memory: run again with fewer --workers"
        ),
    )


class JobBackend(AbstractContextManager["JobBackend"]):
    """A place where jobs are run; its context ends what still runs, at once on an error."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        return None

    @abstractmethod
    def run(self, function: Function, jobs: Sequence[Any]) -> Iterator[JobResult]:
        """Yield the results of all jobs, in the order of their completion.

        function  of a module, so that other processes find it
        """

    def in_order(
        self, function: Callable[[Job], Result], jobs: Sequence[Job], done: Callable[[], object]
    ) -> list[Result]:
        """Return what the function returned, in the order of the jobs; call `done` after each."""
        values: dict[int, Result] = {}
        for result in self.run(function, jobs):
            values[result.index] = result.result()
            done()
        return [values[index] for index in range(len(jobs))]


def local_backend(count: int | None) -> JobBackend:
    """`count` processes on this machine, one for each core by default; with 1 this process."""
    count = count or cores()
    return SerialBackend() if count == 1 else ProcessBackend(count)


def cores() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class SerialBackend(JobBackend):
    """Runs jobs in this process, in their order."""

    def run(self, function: Function, jobs: Sequence[Any]) -> Iterator[JobResult]:
        """Yield the results in the order of the jobs."""
        for index, job in enumerate(jobs):
            yield run_job(function, index, job)


class ProcessBackend(JobBackend):
    """Runs jobs in `count` processes, which are kept for later jobs until the context ends."""

    def __init__(self, count: int) -> None:
        self._count, self._failed_starts = count, 0
        self._idle: list[_Worker] = []
        self._busy: dict[Future[bytes], tuple[_Worker, int, int]] = {}

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """End the processes; jobs that still run are lost where there is an error."""
        workers = [*self._idle, *(worker for worker, _, _ in self._busy.values())]
        for worker in workers:
            worker.end(at_once=error is not None)
        for worker in workers:
            worker.join()
        self._idle, self._busy = [], {}

    def run(self, function: Function, jobs: Sequence[Any]) -> Iterator[JobResult]:
        """Yield the results in the order of completion."""
        waiting = deque((index, 1) for index in range(len(jobs)))
        self._idle += [_Worker() for _ in range(min(self._count, len(jobs)) - len(self._idle))]
        ended: list[JobResult] = []
        while waiting or self._busy or ended:
            while waiting and self._idle:
                worker, (index, attempt) = self._idle.pop(), waiting.popleft()
                future = worker.submit(index, pickle.dumps((function, jobs[index])))
                self._busy[future] = worker, index, attempt
            yield from ended  # after that: processes work while results are written
            ended = []
            for future in wait(self._busy, return_when=FIRST_COMPLETED).done:
                worker, index, attempt = self._busy.pop(future)
                try:
                    ended.append(pickle.loads(future.result()))
                    self._idle.append(worker)
                except BrokenProcessPool:
                    started = self._replace(worker)
                    if attempt < _ATTEMPTS or not started:
                        waiting.append((index, attempt + started))
                    else:
                        ended.append(lost(index))

    def _replace(self, dead: "_Worker") -> bool:
        """Start another worker; return whether the dead one had started.

        Raises SpikedeployError where none can start.
        """
        self._failed_starts = 0 if dead.started else self._failed_starts + 1
        if self._failed_starts >= _MAX_FAILED_STARTS:
            raise SpikedeployError(
                "worker processes end before their first job, for the reason above, or for want of "
                "memory. A script needs `if __name__ == '__main__':` around what it does."
            )
        self._idle.append(_Worker())
        return dead.started


class _Worker:
    """A process; a pool of one, as a pool is broken as a whole when one of its processes dies."""

    def __init__(self) -> None:
        self._pool = ProcessPoolExecutor(1, get_context("spawn"), _initialise)
        with environment(WORKER_ENVIRONMENT):  # submitting starts the process
            self._pid = self._pool.submit(os.getpid)

    @property
    def started(self) -> bool:
        """True where it has come so far as to wait for jobs."""
        return self._pid.done() and not self._pid.exception()

    def submit(self, index: int, packed: bytes) -> "Future[bytes]":
        """Send a job; a worker that has died gives a broken future."""
        try:
            return self._pool.submit(_run_packed, index, packed)
        except BrokenProcessPool as error:
            failed: Future[bytes] = Future()
            failed.set_exception(error)
            return failed

    def end(self, at_once: bool) -> None:
        """Begin to end it, when its job is done or at once: jobs are pure, so nothing is lost."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        if at_once:
            self._signal(signal.SIGTERM)

    def join(self) -> None:
        """Wait for its end, and kill it where that does not come."""
        timer = threading.Timer(_PATIENCE, self._signal, (signal.SIGKILL,))
        timer.start()
        self._pool.shutdown(wait=True)
        timer.cancel()

    def _signal(self, number: int) -> None:
        if self.started:
            with suppress(ProcessLookupError):
                os.kill(self._pid.result(), number)


def _initialise() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # reaches all of a terminal; the parent handles it
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def _leave(number: int, frame: FrameType | None) -> None:
    sys.exit(128 + number)  # which removes temporary files


def _leave_with_parent() -> None:
    """End this process when its parent has died, in the middle of a job too."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_packed(index: int, packed: bytes) -> bytes:
    """Run a pickled job; an error that cannot be sent is replaced by its words."""
    result = run_job(_call, index, packed)
    try:
        sent = pickle.dumps(result)
        pickle.loads(sent)
    except Exception as error:
        found = result.error or error
        words = SpikedeployError(f"{type(found).__name__}: {found}")
        return pickle.dumps(replace(result, value=None, error=words))
    return sent


def _call(packed: bytes) -> Any:  # noqa: ANN401 - of whatever function it is
    """Unpickle and call: an error where this process does not have the function."""
    function, job = pickle.loads(packed)
    return function(job)


@contextmanager
def environment(changes: Mapping[str, str]) -> Iterator[None]:
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


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """SIGTERM raises KeyboardInterrupt within the block: commands keep what is done."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
