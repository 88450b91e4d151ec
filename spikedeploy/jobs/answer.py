"""What a job came to, and what every back-end does with jobs."""

import os
import socket
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol

from spikedeploy.runtime.errors import SpikedeployError

ATTEMPTS = 2  # of a job whose worker is killed
Function = Callable[[Any], Any]


@dataclass(frozen=True)
class JobAnswer:
    """What a job came to.

    place    of the job in the sequence
    value    what the function returned; None where it failed
    error    what it raised; None where it did not
    trace    traceback of that, as text
    seconds  of run time
    worker   host:process
    """

    place: int
    value: Any = None
    error: Exception | None = None
    trace: str = ""
    seconds: float = 0.0
    worker: str = ""

    def result(self) -> Any:  # noqa: ANN401 - of whatever function it was
        """What the function returned; raises what it raised."""
        if self.error is not None:
            raise self.error from (RuntimeError(self.trace) if self.trace else None)
        return self.value


class JobBackend(Protocol):
    """A place where jobs are run; a context, which ends what still runs."""

    def __enter__(self) -> "JobBackend":
        """Start it."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it: at once where there is an error."""

    def run(self, function: Function, jobs: Sequence[Any]) -> Iterator[JobAnswer]:
        """The answers to all jobs, in the order of their completion.

        function  of a module, so that other processes find it
        """


def answered(function: Function, place: int, job: object) -> JobAnswer:
    """The answer to a job that is run here."""
    began, worker = time.perf_counter(), f"{socket.gethostname()}:{os.getpid()}"
    try:
        value = function(job)
    except Exception as error:
        seconds = time.perf_counter() - began
        return JobAnswer(place, None, error, traceback.format_exc(), seconds, worker)
    return JobAnswer(place, value, None, "", time.perf_counter() - began, worker)


def lost(place: int, seconds: float = 0.0) -> JobAnswer:
    """The answer to a job whose worker was killed at every attempt."""
    error = SpikedeployError(
        "a worker process was killed, probably for memory: run again with fewer --workers"
    )
    return JobAnswer(place, None, error, seconds=seconds)
