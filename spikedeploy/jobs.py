"""Jobs: calls of a function in processes of one thread each, whose results come as they end.

A job that fails, or whose process is killed, has its error as result. Ctrl-C asks running jobs to
stop by SIGTERM: trainings end at a checkpoint, other jobs at once.
"""

import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context, parent_process
from pathlib import Path
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
_MAX_FAILED_STARTS = 3  # of workers, one after the other
_KILLED = "a worker process was killed, probably for memory: run again with fewer at a time"
_NO_START = (
    "worker processes end before their first job, for the reason above, or for want of memory. A "
    "script needs `if __name__ == '__main__':` around what it does."
)

Function = Callable[[Any], Any]
Job = TypeVar("Job")
Value = TypeVar("Value")


@dataclass(frozen=True)
class JobResult:
    """The result of a job.

    index: of the job, in the order in which jobs are given
    value: that the function returned; None where it failed
    error: that it raised; None where it did not
    trace: traceback of that, as text
    seconds: run time
    """

    index: int
    value: Any = None
    error: Exception | None = None
    trace: str = ""
    seconds: float = 0.0

    def result(self) -> Any:  # noqa: ANN401 - of whatever function it was
        """Return what the function returned; raise what it raised."""
        if self.error is not None:
            raise self.error from (RuntimeError(self.trace) if self.trace else None)
        return self.value


class Serial(AbstractContextManager["Serial"]):
    """Runs jobs in this process, in their order."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing runs between jobs."""

    def run(self, function: Function, jobs: Iterable[Any]) -> Iterator[JobResult]:
        """Yield the result of each job as it ends.

        function: of a module, so that other processes find it
        """
        for index, job in enumerate(jobs):
            yield _run(function, index, job)

    def in_order(
        self, function: Callable[[Job], Value], jobs: Sequence[Job], done: Callable[[], object]
    ) -> list[Value]:
        """Return what the function returned, in the order of the jobs; call `done` after each."""
        values: dict[int, Value] = {}
        for result in self.run(function, jobs):
            values[result.index] = result.result()
            done()
        return [values[index] for index in range(len(jobs))]


class Pool(Serial):
    """Runs jobs in `count` processes, which are kept for later jobs until the context ends."""

    def __init__(self, count: int) -> None:
        self._count, self._failed_starts = count, 0
        self._idle: list[_Worker] = []
        self._busy: dict[Future[bytes], tuple[_Worker, int, Any]] = {}

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """End the processes; a second Ctrl-C kills them."""
        workers = [*self._idle, *(worker for worker, *_ in self._busy.values())]
        try:
            for worker in workers:
                worker.end(at_once=error is not None)
            for worker in workers:
                worker.join()
        except KeyboardInterrupt:
            for worker in workers:
                worker.signal(signal.SIGKILL)
            raise
        self._idle, self._busy = [], {}

    def run(self, function: Function, jobs: Iterable[Any]) -> Iterator[JobResult]:
        """Yield the result of each job as it ends; a job is taken when there is a place for it.

        After Ctrl-C the results of running jobs that can be stopped come, then KeyboardInterrupt.
        """
        fresh = iter(enumerate(jobs))
        again: list[tuple[int, Any]] = []
        try:
            while True:
                self._begin(function, fresh, again)
                if not self._busy:
                    return
                for future in wait(self._busy, return_when=FIRST_COMPLETED).done:
                    worker, index, job = self._busy.pop(future)
                    try:
                        result: JobResult = pickle.loads(future.result())
                    except BrokenProcessPool:
                        if not self._check_start(worker):
                            again.append((index, job))
                            continue
                        result = JobResult(index, error=SpikedeployError(_KILLED))
                    else:
                        self._idle.append(worker)
                    self._begin(function, fresh, again)  # before the result is used
                    yield result
        except KeyboardInterrupt:
            yield from self._stop()
            raise

    def _begin(
        self,
        function: Function,
        fresh: Iterator[tuple[int, Any]],
        again: list[tuple[int, Any]],
    ) -> None:
        """Give every free place a job."""
        while len(self._busy) < self._count:
            task = again.pop() if again else next(fresh, None)
            if task is None:
                return
            worker = self._idle.pop() if self._idle else _Worker()
            index, job = task
            self._busy[worker.submit(index, pickle.dumps((function, job)))] = (worker, *task)

    def _check_start(self, dead: "_Worker") -> bool:
        """Return whether a dead worker had started; SpikedeployError where none can."""
        self._failed_starts = 0 if dead.started else self._failed_starts + 1
        if self._failed_starts >= _MAX_FAILED_STARTS:
            raise SpikedeployError(_NO_START)
        return dead.started

    def _stop(self) -> Iterator[JobResult]:
        """Ask running jobs to stop, and yield results of those that end with one."""
        for worker, *_ in self._busy.values():
            worker.signal(signal.SIGTERM)
        for future in self._busy:
            with suppress(BrokenProcessPool, SystemExit):
                yield pickle.loads(future.result())


def local_pool(count: int | None) -> Serial:
    """Return `count` processes, one for each core by default; with 1 this process."""
    count = count or cores()
    return Serial() if count == 1 else Pool(count)


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Worker:
    """A process; an executor of one, which breaks as a whole when one of its processes dies."""

    def __init__(self) -> None:
        self._executor = ProcessPoolExecutor(1, get_context("spawn"), _initialise)
        with _environment(WORKER_ENVIRONMENT):  # submitting starts the process
            self._pid = self._executor.submit(os.getpid)

    @property
    def started(self) -> bool:
        """True where it has come so far as to wait for jobs."""
        return self._pid.done() and not self._pid.exception()

    def submit(self, index: int, packed: bytes) -> "Future[bytes]":
        """Send a job; a worker that has died gives a broken future."""
        try:
            return self._executor.submit(_run_packed, index, packed)
        except BrokenProcessPool as error:
            failed: Future[bytes] = Future()
            failed.set_exception(error)
            return failed

    def signal(self, number: int) -> None:
        """Send a signal to the process, where there is one."""
        if self.started:
            with suppress(ProcessLookupError):
                os.kill(self._pid.result(), number)

    def end(self, at_once: bool) -> None:
        """Begin to end it, after its job, or by asking that to stop."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        if at_once:
            self.signal(signal.SIGTERM)

    def join(self) -> None:
        """Wait for its end."""
        self._executor.shutdown(wait=True)


# in a worker


def _initialise() -> None:
    if hasattr(os, "setsid"):
        os.setsid()  # a terminal's Ctrl-C reaches the parent alone, which asks to stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_stop_without_parent, daemon=True).start()


def _leave(number: int, frame: FrameType | None) -> None:
    _exit_without_parent()
    sys.exit(128 + number)  # which removes temporary files


def _stop_without_parent() -> None:
    """Ask the job to stop when the parent has died."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def _exit_without_parent() -> None:
    parent = parent_process()
    if parent is not None and not parent.is_alive():
        os._exit(1)


def _run(function: Function, index: int, job: object) -> JobResult:
    began = time.perf_counter()
    try:
        result = JobResult(index, function(job))
    except Exception as error:
        result = JobResult(index, None, error, traceback.format_exc())
    return replace(result, seconds=time.perf_counter() - began)


def _run_packed(index: int, packed: bytes) -> bytes:
    """Run a pickled job; an error that cannot be sent is replaced by its words."""
    result = _run(_call, index, packed)
    _exit_without_parent()
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
def output_to(log: Path) -> Iterator[None]:
    """Append what this process writes within the block to a file, and tracebacks of errors."""
    log.parent.mkdir(parents=True, exist_ok=True)
    kept = {stream: os.dup(stream) for stream in (1, 2)}
    with log.open("ab") as file:
        for stream in kept:
            os.dup2(file.fileno(), stream)
    try:
        yield
    except Exception:
        traceback.print_exc()
        raise
    finally:
        sys.stdout.flush()
        for stream, before in kept.items():
            os.dup2(before, stream)
            os.close(before)


# around a pool


@contextmanager
def _environment(changes: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for processes that are started within the block."""
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
