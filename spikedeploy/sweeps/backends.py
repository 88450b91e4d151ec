"""The back-ends of a sweep by name."""

from spikedeploy.jobs.answer import JobBackend
from spikedeploy.jobs.processes import ProcessBackend
from spikedeploy.jobs.ray_cluster import RayBackend
from spikedeploy.jobs.serial import SerialBackend
from spikedeploy.parallel import cores
from spikedeploy.runtime.errors import ConfigError

BACKENDS = ("serial", "process", "ray")


def backend_called(name: str, workers: int | None, address: str | None = None) -> JobBackend:
    """The back-end of this name.

    workers  processes, one for each core by default; on a cluster as many as it has
    address  of a cluster of Ray
    """
    if address is not None and name != "ray":
        raise ConfigError(f"--address is of Ray, not of {name}: add --backend ray, or leave it out")
    if name == "serial":
        return SerialBackend()
    if name == "ray":
        return RayBackend(workers, address)
    return ProcessBackend(workers or cores())
