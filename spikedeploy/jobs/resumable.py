"""Trainings and parts of experiments, each in a process of its own, which checkpoint when stopped.

They take hours, write run folders, wait for one another, have a log each, and are asked to stop;
`jobs.pool` is for jobs that take seconds, return a value, and can be killed and run again.

`python -m spikedeploy.jobs.resumable` is the program of such a process. Its stdin holds one line of
JSON, {"call": "module:function", "arguments": {...}}, and stays open. When it closes, because the
parent was interrupted or killed, the process interrupts itself as Ctrl-C would, and training ends
with a checkpoint.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from spikedeploy.jobs.pool import WORKER_ENVIRONMENT, sigterm_as_interrupt
from spikedeploy.user_errors import one_line

INTERRUPTED = 130  # a shell's exit status after Ctrl-C
_PAUSE = 0.5  # [s] between two polls of the processes


@dataclass(frozen=True)
class Job:
    """A function call in a process of its own.

    name       for people
    call       "module:function"; a function that returns False was interrupted
    arguments  of the function, JSON types
    log        file with the output of the process, of all attempts
    after      names of jobs that must have ended before, where they are to be done
    """

    name: str
    call: str
    log: Path
    arguments: Mapping[str, Any] = field(default_factory=dict)
    after: Sequence[str] = ()


@dataclass(frozen=True)
class JobEnd:
    """The end of a job.

    seconds  of run time
    status   0 done, INTERRUPTED, else failed
    begins   where in the log this attempt begins [bytes]
    """

    job: Job
    seconds: float
    status: int
    begins: int = 0

    @property
    def failed(self) -> bool:
        """True where it ended by itself, but not with success."""
        return self.status not in (0, INTERRUPTED)

    @property
    def last_line(self) -> str:
        """The last line of what it wrote into the log, which holds the error message."""
        written = self.job.log.read_bytes()[self.begins :].decode("utf-8", errors="replace")
        silent = "no output" + (f", killed by signal {-self.status}" if self.status < 0 else "")
        return next((line for line in reversed(written.split("\n")) if line.strip()), silent)

    @property
    def line(self) -> str:
        """`12:30:05 ✓ name (3.2 min)`; with the error where it failed."""
        took = f"{self.seconds / 60:.1f} min"
        sign = "✗" if self.failed else "…" if self.status else "✓"
        why = f": {self.last_line} ({self.job.log})" if self.failed else ""
        return f"{time.strftime('%H:%M:%S')} {sign} {self.job.name} ({took}){why}"


def run(
    jobs: Sequence[Job],
    count: int,
    ended: Callable[[JobEnd], None],
    update: Callable[[Sequence[Job]], None] = lambda running: None,
) -> bool:
    """Run the jobs in order, `count` at a time; return whether none was left out.

    A job that must wait for others lets those behind it go first.

    ended   is called after each job
    update  is called with the running jobs at every poll
    """
    waiting, running = list(jobs), list[_Process]()
    with sigterm_as_interrupt():
        try:
            while waiting or running:
                while len(running) < count and (job := _ready(waiting, running)):
                    waiting.remove(job)
                    running.append(_Process(job))
                for process in [each for each in running if each.status is not None]:
                    running.remove(process)
                    ended(process.end())
                update([process.job for process in running])
                time.sleep(_PAUSE)
        except KeyboardInterrupt:
            _stop(running, ended)
            return False
        except BaseException:
            _stop(running, ended)
            raise
    return True


def _ready(waiting: Sequence[Job], running: "Sequence[_Process]") -> Job | None:
    left = {job.name for job in (*waiting, *(process.job for process in running))}
    return next((job for job in waiting if not left & set(job.after)), None)


def _stop(running: "Sequence[_Process]", ended: Callable[[JobEnd], None]) -> None:
    """Ask every process to stop, and wait; a second Ctrl-C kills them."""
    try:
        for process in running:
            process.ask_to_stop()
        for process in running:
            ended(process.end())
    except KeyboardInterrupt:
        for process in running:
            process.kill()
        raise


class _Process:
    def __init__(self, job: Job) -> None:
        self.job, self._start = job, time.monotonic()
        job.log.parent.mkdir(parents=True, exist_ok=True)
        with job.log.open("ab") as log:
            self._begins = log.tell()
            self._popen = subprocess.Popen(
                [sys.executable, "-m", "spikedeploy.jobs.resumable"],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                env={**os.environ, **WORKER_ENVIRONMENT},
                start_new_session=True,  # a terminal's Ctrl-C reaches the parent only
            )
        self._write(json.dumps({"call": job.call, "arguments": dict(job.arguments)}) + "\n")

    def _write(self, text: str) -> None:
        if self._popen.stdin:
            with suppress(BrokenPipeError):  # it has died; its status tells
                self._popen.stdin.write(text.encode())
                self._popen.stdin.flush()

    @property
    def status(self) -> int | None:
        """The exit status; None while it runs."""
        return self._popen.poll()

    def ask_to_stop(self) -> None:
        """Ask it to stop, by closing its stdin."""
        if self._popen.stdin:
            with suppress(BrokenPipeError):
                self._popen.stdin.close()

    def kill(self) -> None:
        """Kill it."""
        self._popen.kill()
        self._popen.wait()

    def end(self) -> JobEnd:
        """Wait for its end."""
        status = self._popen.wait()
        self.ask_to_stop()
        return JobEnd(self.job, time.monotonic() - self._start, status, self._begins)


def main() -> int:
    """Run the job; exit status 0 done, INTERRUPTED, or 1 after a line on stderr."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # with `&` a shell ignores it
    job = json.loads(sys.stdin.readline())
    threading.Thread(target=_interrupt_when_stdin_closes, daemon=True).start()
    module, _, function = job["call"].partition(":")
    try:
        done = getattr(import_module(module), function)(**job["arguments"])
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        line = one_line(error)
        if line is None:
            raise
        print(f"error: {line}", file=sys.stderr)
        return 1
    return INTERRUPTED if done is False else 0


def _interrupt_when_stdin_closes() -> None:
    os.read(sys.stdin.fileno(), 1)  # returns only when the other end closes
    main_thread = threading.main_thread().ident
    if main_thread is not None:  # only a signal to the main thread interrupts a blocking call
        signal.pthread_kill(main_thread, signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
