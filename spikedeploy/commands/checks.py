"""`check` and `doctor`: a network, and this machine."""

import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from spikedeploy.commands.options import (
    Delay,
    Dt,
    Floor,
    Force,
    From,
    Integrator,
    Json,
    Like,
    PageFolder,
    Reset,
    Spikes,
    State,
)


def check(
    file: Annotated[
        str,
        typer.Argument(metavar="FILE", help="A .nir file, a run, or the name of a shipped policy."),
    ],
    chip: Annotated[
        list[str] | None,
        typer.Option(
            help="Chip, or 'all'; several with commas between them, or the option again.",
            show_default="all",
        ),
    ] = None,
    dt: Dt = None,
    reset: Reset = None,
    integrator: Integrator = None,
    delay: Delay = None,
    spikes: Spikes = None,
    floor: Floor = None,
    state: State = None,
    like: Like = None,
    rules: Annotated[
        bool, typer.Option("--rules", help="Print every rule, kept or broken, and the layers.")
    ] = False,
    from_: From = None,
    against: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            metavar="RECORDED.npz",
            help="Compare the float twin with `input` and `output` spikes that your framework "
            "recorded, instead of checking chips.",
        ),
    ] = None,
    output: PageFolder = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Check whether a network fits on chips, rule by rule and node by node.

    Exit code 0: every chip that was named passes; of 'all', at least one that has limits. With
    --against: the float twin equals the recording.
    """
    from spikedeploy.console import print_json
    from spikedeploy.emulation.design_report import ALL, design_report, network_path
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.design import design_page, print_report
    from spikedeploy.reports.page import FILES, is_page_of, write_page
    from spikedeploy.shipping.exported_run import runnable

    file = runnable(file)
    convention = {
        "dt": dt,
        "reset": reset,
        "integrator": integrator,
        "delay": delay,
        "spikes": spikes,
        "floor": floor,
        "state": state,
        "like": like,
        "written_by": from_,
    }
    if against is not None:
        if output:
            raise typer.BadParameter("-o writes the rules of chips: leave --against out")
        _check_against(file, against, chip, convention, json)
    if output:
        check_output_folder("-o", output, FILES, (network_path(file),), force, is_page_of("check"))
    report = design_report(file, chip or [ALL], **convention)
    if output:
        write_page("check", design_page(report), report.as_json(), output)
    if json:
        print_json(report.as_json())
    else:
        print_report(report, rules)
        if output:
            typer.echo(f"wrote {output / 'report.html'}")
    raise typer.Exit(0 if report.passed else 1)


def _check_against(
    file: str,
    recorded: Path,
    chips: list[str] | None,
    convention: dict[str, Any],
    json: bool,
) -> NoReturn:
    """Print the comparison with a recording, and exit."""
    from spikedeploy.console import print_json
    from spikedeploy.emulation.drift import path_of
    from spikedeploy.emulation.recordings import against_recorded
    from spikedeploy.runtime.errors import ConfigError

    if chips:
        raise ConfigError(
            f"--against compares the float twin with a recording, and --chip {chips[0]} checks a "
            "chip. Give one of them; `drift` compares a chip with the float twin."
        )
    found = against_recorded(path_of(file), recorded, **convention)
    if json:
        print_json(found.as_json())
    else:
        for line in found.lines():
            typer.echo(line)
    raise typer.Exit(0 if found.equal else 1)


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
    from spikedeploy.console import print_json
    from spikedeploy.reports.table import Table

    found = findings()
    if json:
        print_json([vars(finding) for finding in found])
    else:
        marks = {True: "✓", False: "✗", None: " "}
        rows = [(marks[f.ok], f.name, f.detail) for f in found]
        Table(("", "what", "found"), rows, "Doctor").print()
    raise typer.Exit(1 if any(finding.ok is False for finding in found) else 0)


def findings() -> list[DoctorFinding]:
    """Everything that is examined, in order."""
    return [*_versions(), _tested(), _threads(), _tried("rendering", _draw), *_policies()]


def _versions() -> Iterator[DoctorFinding]:
    from spikedeploy.trainers.versions import installed, own

    yield DoctorFinding("spikedeploy", None, f"{own()} on Python {platform.python_version()}")
    for package in RUN:
        found = installed(package)
        yield DoctorFinding(package, found is not None, found or 'missing: pip install "."')
    for package in TRAIN:
        missing = 'not installed: pip install ".[train]" to train and export'
        yield DoctorFinding(package, None, installed(package) or missing)


def _tested() -> DoctorFinding:
    """Which versions differ from the tested set."""
    from spikedeploy.tested_set import differences, tested

    of, differ = len(tested()), differences()
    if not differ:
        return DoctorFinding("tested set", None, f"no version differs, of {of} packages")
    remedy = "if something fails: pip install -c constraints.txt, from a checkout"
    return DoctorFinding("tested set", None, f"{len(differ)} differ: {', '.join(differ)}; {remedy}")


def _threads() -> DoctorFinding:
    from spikedeploy.jobs.pool import cores

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
