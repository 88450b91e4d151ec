"""Jobs: calls of functions in this process, in several, or on a cluster.

pool         pure functions of seconds: serial, or in processes that are replaced where killed
ray_cluster  the same as tasks of Ray, on this machine or a cluster
resumable    trainings of hours: processes with a log each, which checkpoint when stopped
"""

from typing import TYPE_CHECKING

from spikedeploy.runtime.errors import ConfigError

if TYPE_CHECKING:
    from spikedeploy.jobs.pool import JobBackend

BACKENDS = ("serial", "process", "ray")


def backend(name: str, workers: int | None, address: str | None = None) -> "JobBackend":
    """The back-end of a name in BACKENDS.

    workers  processes, one for each core by default; on a cluster as many as it has
    address  of a cluster of Ray
    """
    from spikedeploy.jobs.pool import ProcessBackend, SerialBackend, cores

    if address is not None and name != "ray":
        raise ConfigError(f"--address is of Ray, not of {name}: add --backend ray, or leave it out")
    if name == "ray":
        from spikedeploy.jobs.ray_cluster import RayBackend

        return RayBackend(workers, address)
    return SerialBackend() if name == "serial" else ProcessBackend(workers or cores())
