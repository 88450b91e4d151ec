"""The doctor: what works on this machine, and what to do where something does not."""

import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from spikedeploy import zoo
from spikedeploy.jobs import cores
from spikedeploy.versions import RUN, TRAIN, installed, own

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class DoctorFinding:
    """One line of the doctor's.

    name    what was looked at
    ok      whether it works; None for information
    detail  what was found, and what to do
    """

    name: str
    ok: bool | None
    detail: str


def examine() -> list[DoctorFinding]:
    """Everything that is looked at, in order."""
    return [*_versions(), _threads(), _rendering(), *_policies()]


def _versions() -> Iterator[DoctorFinding]:
    yield DoctorFinding("spikedeploy", None, f"{own()} on Python {platform.python_version()}")
    for package in RUN:
        found = installed(package)
        yield DoctorFinding(package, found is not None, found or 'missing: pip install "."')
    for package in TRAIN:
        missing = 'not installed: pip install ".[train]" to train and export'
        yield DoctorFinding(package, None, installed(package) or missing)


def _threads() -> DoctorFinding:
    limits = {name: os.environ.get(name, "all") for name in THREADS}
    limit = ", ".join(f"{name}={value}" for name, value in limits.items())
    return DoctorFinding("threads", None, f"{cores()} cores; {limit}")


def _rendering() -> DoctorFinding:
    """Whether an environment can draw a picture."""
    return _tried("rendering", _draw)


def _draw() -> str:
    from spikedeploy import envs

    env = envs.make("hexapod", render_mode="rgb_array")
    env.reset(seed=0)
    height, width, _ = env.render().shape  # type: ignore[union-attr]
    env.close()
    return f"{width} × {height} pixels through MUJOCO_GL={os.environ.get('MUJOCO_GL', 'default')}"


def _policies() -> Iterator[DoctorFinding]:
    """Whether every shipped policy opens."""
    for name in zoo.names():
        yield _tried(name, partial(_opened, name))


def _opened(name: str) -> str:
    from spikedeploy.policies.policies import find

    return f"opens, kind {find(name).kind}"


def _tried(name: str, attempt: Callable[[], str]) -> DoctorFinding:
    try:
        return DoctorFinding(name, True, attempt())
    except Exception as error:  # a doctor reports whatever is wrong
        return DoctorFinding(name, False, f"{type(error).__name__}: {error}")
