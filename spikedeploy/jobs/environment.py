"""Environment variables of worker processes, of whatever back-end."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

# Workers do not render, and one thread each is faster than many threads in all.
WORKER_ENVIRONMENT = {
    "MUJOCO_GL": "disable",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}


@contextmanager
def environment(changes: Mapping[str, str]) -> Iterator[None]:
    """Environment variables for processes that are started within the block."""
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
