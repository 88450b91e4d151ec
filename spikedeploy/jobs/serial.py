"""One job after the other, in this process."""

from collections.abc import Iterator, Sequence
from typing import Any

from spikedeploy.jobs.answer import Function, JobAnswer, answered


class SerialBackend:
    """Runs jobs here, in their order."""

    def __enter__(self) -> "SerialBackend":
        return self

    def __exit__(self, *raised: object) -> None:
        pass

    def run(self, function: Function, jobs: Sequence[Any]) -> Iterator[JobAnswer]:
        """The answers in the order of the jobs."""
        for place, job in enumerate(jobs):
            yield answered(function, place, job)
