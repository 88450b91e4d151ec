"""`spikedeploy doctor`: what works on this machine, and what to do where something does not."""

import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import typer

from spikedeploy.commands.options import Json

RUN = ("numpy", "nir", "h5py", "gymnasium", "mujoco", "onnxruntime", "matplotlib", "av")
TRAIN = ("torch", "snntorch", "pydantic", "safetensors", "onnx")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class DoctorFinding:
    """One line of the report.

    name    what was examined
    ok      whether it works; None for information
    detail  what was found, and what to do about it
    """

    name: str
    ok: bool | None
    detail: str


def doctor(json: Json = False) -> None:
    """Check versions, threads, rendering and the shipped policies; exit 1 if one fails."""
    from spikedeploy.console import print_json, print_table

    found = findings()
    if json:
        print_json([vars(finding) for finding in found])
    else:
        marks = {True: "[green]✓[/]", False: "[red]✗[/]", None: " "}
        rows = [(marks[f.ok], f.name, f.detail) for f in found]
        print_table("Doctor", ("", "what", "found"), rows)
    raise typer.Exit(1 if any(finding.ok is False for finding in found) else 0)


def findings() -> list[DoctorFinding]:
    """Everything that is examined, in order."""
    return [*_versions(), _threads(), _tried("rendering", _draw), *_policies()]


def _versions() -> Iterator[DoctorFinding]:
    from spikedeploy.trainers.versions import installed, own

    yield DoctorFinding("spikedeploy", None, f"{own()} on Python {platform.python_version()}")
    for package in RUN:
        found = installed(package)
        yield DoctorFinding(package, found is not None, found or 'missing: pip install "."')
    for package in TRAIN:
        missing = 'not installed: pip install ".[train]" to train and export'
        yield DoctorFinding(package, None, installed(package) or missing)


def _threads() -> DoctorFinding:
    from spikedeploy.parallel import cores

    limits = {name: os.environ.get(name, "all") for name in THREADS}
    limit = ", ".join(f"{name}={value}" for name, value in limits.items())
    return DoctorFinding("threads", None, f"{cores()} cores; {limit}")


def _draw() -> str:
    """A rendered picture in words."""
    from spikedeploy import envs

    env = envs.make("hexapod", render_mode="rgb_array")
    env.reset(seed=0)
    height, width, _ = env.render().shape  # type: ignore[union-attr]
    env.close()
    return f"{width} × {height} pixels through MUJOCO_GL={os.environ.get('MUJOCO_GL', 'default')}"


def _policies() -> Iterator[DoctorFinding]:
    """Whether every shipped policy opens."""
    from spikedeploy import zoo

    for name in zoo.names():
        yield _tried(name, partial(_opened, name))


def _opened(name: str) -> str:
    from spikedeploy.policies.registry import find

    return f"opens, kind {find(name).kind}"


def _tried(name: str, attempt: Callable[[], str]) -> DoctorFinding:
    try:
        return DoctorFinding(name, True, attempt())
    except Exception as error:  # a doctor reports whatever is wrong
        return DoctorFinding(name, False, f"{type(error).__name__}: {error}")
