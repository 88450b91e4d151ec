"""Jobs in processes of their own, some at a time, that end politely when the experiment does."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from spikedeploy.experiments.worker import INTERRUPTED
from spikedeploy.parallel import WORKER_ENVIRONMENT

PAUSE = 0.5  # between two looks at the processes [s]


@dataclass(frozen=True)
class Job:
    """A call that a process of its own makes.

    name       for people
    call       "module:function"; a function that returns False was interrupted
    arguments  of the function, as JSON knows them
    log        file with everything that the process prints, of all its attempts
    """

    name: str
    call: str
    log: Path
    arguments: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Ended:
    """How a job ended.

    seconds  that it ran
    status   0 done, worker.INTERRUPTED, else failed
    """

    job: Job
    seconds: float
    status: int

    @property
    def failed(self) -> bool:
        """Whether it ended by itself without being done."""
        return self.status not in (0, INTERRUPTED)

    @property
    def last_words(self) -> str:
        """The last line of the log, which tells of a failure."""
        lines = self.job.log.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), "it said nothing")


def run(
    jobs: Sequence[Job],
    count: int,
    ended: Callable[[Ended], None],
    look: Callable[[Sequence[Job]], None] = lambda running: None,
) -> bool:
    """Run the jobs, `count` at a time, in their order; whether all of them were tried.

    ended  is called after each
    look   is called with those that run, again and again
    """
    waiting, running = list(reversed(jobs)), list[_Process]()
    with _terminated_as_interrupted():
        try:
            while waiting or running:
                while waiting and len(running) < count:
                    running.append(_Process(waiting.pop()))
                for process in [each for each in running if each.status is not None]:
                    running.remove(process)
                    ended(process.end())
                look([process.job for process in running])
                time.sleep(PAUSE)
        except KeyboardInterrupt:
            _stop(running, ended)
            return False
        except BaseException:
            _stop(running, ended)
            raise
    return True


def _stop(running: "Sequence[_Process]", ended: Callable[[Ended], None]) -> None:
    """Let every process come to a safe end; a second Ctrl-C ends them at once."""
    try:
        for process in running:
            process.ask()
        for process in running:
            ended(process.end())
    except KeyboardInterrupt:
        for process in running:
            process.kill()
        raise


class _Process:
    """A job that runs."""

    def __init__(self, job: Job) -> None:
        self.job, self._start = job, time.monotonic()
        job.log.parent.mkdir(parents=True, exist_ok=True)
        with job.log.open("ab") as log:
            self._popen = subprocess.Popen(
                [sys.executable, "-m", "spikedeploy.experiments.worker"],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                env={**os.environ, **WORKER_ENVIRONMENT},
                start_new_session=True,  # a terminal's Ctrl-C reaches the experiment alone
            )
        self._say(json.dumps({"call": job.call, "arguments": dict(job.arguments)}) + "\n")

    def _say(self, text: str) -> None:
        if self._popen.stdin:
            with suppress(BrokenPipeError):  # it died already, and its status will tell
                self._popen.stdin.write(text.encode())
                self._popen.stdin.flush()

    @property
    def status(self) -> int | None:
        """The exit status; None while it runs."""
        return self._popen.poll()

    def ask(self) -> None:
        """Ask it to end soon."""
        if self._popen.stdin:
            with suppress(BrokenPipeError):
                self._popen.stdin.close()

    def kill(self) -> None:
        """End it now."""
        self._popen.kill()
        self._popen.wait()

    def end(self) -> Ended:
        """Wait for its end."""
        status = self._popen.wait()
        self.ask()
        return Ended(self.job, time.monotonic() - self._start, status)


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """SIGTERM ends the experiment as Ctrl-C does."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
