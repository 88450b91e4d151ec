"""Tasks of Ray, on this machine or on a cluster that is running.

Where a worker or a node dies, Ray runs its jobs again elsewhere; one that kills every worker fails.
"""

import os
import secrets
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from spikedeploy.jobs.pool import (
    WORKER_ENVIRONMENT,
    Function,
    JobBackend,
    JobResult,
    environment,
    lost,
    run_job,
)
from spikedeploy.runtime.errors import ConfigError

_AHEAD = 2  # jobs for each core, one that runs and one that waits
_RETRIES = 2  # of a job, by Ray
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
        task = self._ray.remote(max_retries=_RETRIES)(run_job)
        waiting = deque(enumerate(jobs))
        running: dict[Any, int] = {}  # task -> index of its job
        while waiting or running:
            while waiting and len(running) < _AHEAD * self._room():
                index, job = waiting.popleft()
                running[task.remote(function, index, job)] = index
            ended, _ = self._ray.wait(list(running), timeout=_POLL)
            for each in ended:
                yield self._result(each, running.pop(each))

    def _result(self, task: Any, index: int) -> JobResult:  # noqa: ANN401
        try:
            found: JobResult = self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:  # of what travels, not of a job
            return JobResult(index, error=error)
        except self._ray.exceptions.RayError:
            return lost(index)
        return found

    def _room(self) -> int:
        found = int(self._ray.cluster_resources().get("CPU", 0)) or 1
        return min(found, self._workers or found)


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
