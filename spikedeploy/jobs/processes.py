"""Spawned processes of one thread each; one that is killed is replaced, and its job run again.

A pool of concurrent.futures is broken as a whole when one of its processes dies. Here each process
has a pipe of its own, at whose other end this one notices the death of that one, and that one the
death of this.
"""

import os
import pickle
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from types import FrameType
from typing import Any

from spikedeploy.jobs.answer import ATTEMPTS, Function, JobAnswer, answered, lost
from spikedeploy.jobs.environment import WORKER_ENVIRONMENT, environment
from spikedeploy.runtime.errors import SpikedeployError

_PATIENCE = 5.0  # [s] for a process to end before it is killed
_STILLBORN = 3  # processes one after the other that may end before their first job


class ProcessBackend:
    """Runs jobs in `count` processes, which are kept for later jobs until the context ends."""

    def __init__(self, count: int) -> None:
        self._count, self._stillborn = count, 0
        self._workers: list[_Worker] = []

    def __enter__(self) -> "ProcessBackend":
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        for worker in self._workers:
            worker.leave(at_once=error is not None)  # jobs are pure, so nothing is lost
        for worker in self._workers:
            worker.end()
        self._workers = []

    def run(self, function: Function, jobs: Sequence[Any]) -> Iterator[JobAnswer]:
        """The answers in the order of completion."""
        waiting = deque((place, 1) for place in range(len(jobs)))
        while len(self._workers) < min(self._count, len(jobs)):
            self._workers.append(_Worker())
        ended: list[JobAnswer] = []
        while True:
            self._employ(waiting, function, jobs)
            yield from ended  # after that: processes work while answers are written
            if not waiting and not any(worker.busy for worker in self._workers):
                return
            ended = self._ended(waiting)

    def _employ(
        self, waiting: "deque[tuple[int, int]]", function: Function, jobs: Sequence[Any]
    ) -> None:
        """Give jobs that wait to processes that do."""
        for number, worker in enumerate(self._workers):
            if waiting and not worker.busy:
                place, attempt = waiting.popleft()
                if not worker.take(function, place, attempt, jobs[place]):
                    waiting.appendleft((place, attempt))  # it died idle
                    self._replace(number)

    def _ended(self, waiting: "deque[tuple[int, int]]") -> list[JobAnswer]:
        """Answers that have come; jobs whose process was killed wait again, at their first time."""
        found = []
        for number in self._heard():
            worker = self._workers[number]
            if worker.begins():
                continue
            place, attempt = worker.job
            answer = worker.answer()
            if answer is None:
                self._replace(number)
            if answer is None and attempt < ATTEMPTS:
                waiting.append((place, attempt + 1))
            else:
                found.append(answer or lost(place))
        return found

    def _heard(self) -> list[int]:
        """Numbers of the processes that have answered, or died."""
        ends = {worker.pipe: number for number, worker in enumerate(self._workers) if worker.busy}
        return [ends[end] for end in wait(list(ends)) if isinstance(end, Connection)]

    def _replace(self, number: int) -> None:
        """Start another process in place of a dead one; SpikedeployError where none can start."""
        dead = self._workers[number]
        dead.end()
        self._stillborn = 0 if dead.began else self._stillborn + 1
        if self._stillborn >= _STILLBORN:
            raise SpikedeployError(
                "worker processes end before their first job, for the reason above, or for want of "
                "memory. A script needs `if __name__ == '__main__':` around what it does."
            )
        self._workers[number] = _Worker()


class _Worker:
    """A process, and what it does.

    pipe   to it
    job    place and attempt of the last job
    busy   whether its answer is missing
    began  whether it has come so far as to wait for jobs
    """

    def __init__(self) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,))
        with environment(WORKER_ENVIRONMENT):
            self._process.start()
        theirs.close()  # so that its death closes the pipe
        self.job, self.busy, self.began = (0, 0), False, False

    def take(self, function: Function, place: int, attempt: int, job: object) -> bool:
        """Give it a job; whether it is alive to take it."""
        try:
            self.pipe.send((place, pickle.dumps((function, job))))
        except OSError:
            return False
        self.job, self.busy = (place, attempt), True
        return True

    def begins(self) -> bool:
        """Whether what it said is that it waits for jobs."""
        if self.began:
            return False
        with suppress(EOFError, OSError):
            self.pipe.recv_bytes()
            self.began = True
        return self.began

    def answer(self) -> JobAnswer | None:
        """Its answer; None where it has died."""
        self.busy = False
        try:
            found: JobAnswer = pickle.loads(self.pipe.recv_bytes())
        except (EOFError, OSError):
            return None
        return found

    def leave(self, at_once: bool) -> None:
        """Ask it to end, when its job is done or at once."""
        self.pipe.close()
        if at_once:
            self._process.terminate()

    def end(self) -> None:
        """Wait for its end, and kill it where that does not come."""
        self.pipe.close()
        self._process.join(_PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()


def _work(pipe: Connection) -> None:
    """Answer jobs until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # reaches all of a terminal; the parent handles it
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        pipe.send_bytes(b"ready")
        while True:
            place, packed = pipe.recv()
            pipe.send_bytes(_packed(answered(_called, place, packed)))


def _called(packed: bytes) -> Any:  # noqa: ANN401 - of whatever function it is
    """What the function returns; an error where this process does not have it."""
    function, job = pickle.loads(packed)
    return function(job)


def _packed(answer: JobAnswer) -> bytes:
    """The answer for the other end; with an error in words where that cannot be sent as it is."""
    try:
        packed = pickle.dumps(answer)
        pickle.loads(packed)
    except Exception as error:
        found = answer.error or error
        words = SpikedeployError(f"{type(found).__name__}: {found}")
        return pickle.dumps(replace(answer, value=None, error=words))
    return packed


def _leave(number: int, frame: FrameType | None) -> None:
    sys.exit(128 + number)  # which removes temporary files


def _leave_with_parent() -> None:
    """End this process when its parent has died, in the middle of a job too."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
