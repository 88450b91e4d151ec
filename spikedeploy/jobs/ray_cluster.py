"""Tasks of Ray, on this machine or on a cluster that is running.

Jobs go out in chunks of about two seconds, so that a task costs little beside its work, and come
back in the order of completion. Where a worker or a node dies, Ray runs its chunks again elsewhere;
a chunk that it gives up is taken apart here, and each of its jobs tried once more alone.
"""

import os
import secrets
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from spikedeploy.errors import ConfigError
from spikedeploy.jobs.pool import (
    WORKER_ENVIRONMENT,
    Function,
    JobBackend,
    JobResult,
    environment,
    lost,
    run_job,
)

_CHUNK = 2.0  # [s] of work in a task
_AHEAD = 2  # chunks for each core, one that runs and one that waits
_RETRIES = 2  # of a chunk, by Ray
_POLL = 1.0  # [s] between two looks at how many cores there are
_RAY = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "token"}
# Ray gives its nodes the address of the machine unless it takes itself for a single node; then
# nothing listens on other addresses than 127.0.0.1
_ALONE = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}


class RayBackend(JobBackend):
    """Runs jobs as tasks of Ray.

    workers  cores that are used; None for all
    address  of a cluster, "auto" for that of this machine; None starts Ray here
    """

    def __init__(self, workers: int | None = None, address: str | None = None) -> None:
        self._workers, self._address = workers, address
        self._ray: Any = None

    def __enter__(self) -> "RayBackend":
        own = self._address is None
        token = {"RAY_AUTH_TOKEN": _token()} if own and not _has_token() else {}
        with environment({**_RAY, **(_ALONE if own else {}), **token}):
            import ray

            options = {"num_cpus": self._workers, "include_dashboard": False} if own else {}
            self._ray = _started(ray, self._address, options)
        return self

    def __exit__(self, *raised: object) -> None:
        self._ray.shutdown()  # of a cluster only this driver's tasks

    def run(self, function: Function, jobs: Sequence[Any]) -> Iterator[JobResult]:
        """The results in the order of completion."""
        task = self._ray.remote(max_retries=_RETRIES)(_chunk)
        waiting, alone = deque(range(len(jobs))), deque[int]()
        running: dict[Any, tuple[list[int], bool]] = {}  # task -> its jobs; whether it is the last
        seconds: float | None = None  # of a job, a running mean
        while waiting or alone or running:
            room = self._room()
            while (waiting or alone) and len(running) < room * _AHEAD:
                last = bool(alone)
                count = 1 if last else _chunk_size(seconds, len(waiting), room)
                indices = [(alone or waiting).popleft() for _ in range(count)]
                sent = task.remote(function, [(index, jobs[index]) for index in indices])
                running[sent] = indices, last
            ended, _ = self._ray.wait(list(running), timeout=_POLL)
            for each in ended:
                indices, last = running.pop(each)
                for result in self._results(each, indices):
                    if result is not None:
                        seconds = 0.8 * (seconds or result.seconds) + 0.2 * result.seconds
                        yield result
                    elif last:
                        yield from map(lost, indices)
                    else:
                        alone.extend(indices)

    def _results(self, task: Any, indices: Sequence[int]) -> list[JobResult] | list[None]:  # noqa: ANN401
        """The results of a task that has ended; one None where its worker was killed."""
        try:
            found: list[JobResult] = self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:  # of what travels, not of a job
            return [JobResult(index, error=error) for index in indices]
        except self._ray.exceptions.RayError:
            return [None]
        return found

    def _room(self) -> int:
        found = int(self._ray.cluster_resources().get("CPU", 0)) or 1
        return min(found, self._workers or found)


def _chunk_size(seconds: float | None, left: int, cores: int) -> int:
    """Jobs of the next chunk: one before their time [s] is known, few at the end."""
    if seconds is None:
        return 1
    return max(1, min(int(_CHUNK / max(seconds, 1e-3)), -(-left // (2 * cores))))


def _started(ray: Any, address: str | None, options: Mapping[str, Any]) -> Any:  # noqa: ANN401
    try:
        ray.init(
            address or "local",
            log_to_driver=False,
            logging_level="ERROR",
            runtime_env={"env_vars": WORKER_ENVIRONMENT},
            **options,
        )
    except (ConnectionError, ValueError, ray.exceptions.RayError) as error:
        raise ConfigError(
            f"--address {address}: no cluster of Ray answers ({error}). Start one with "
            "`ray start --head`, all with the same RAY_AUTH_TOKEN."
        ) from error
    return ray


@cache
def _token() -> str:
    """A secret for Ray on this machine, which keeps the first one of a process."""
    return secrets.token_hex(32)


def _has_token() -> bool:
    return any(os.environ.get(name) for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"))


def _chunk(function: Function, jobs: Sequence[tuple[int, Any]]) -> list[JobResult]:
    return [run_job(function, index, job) for index, job in jobs]
