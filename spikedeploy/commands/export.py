"""`spikedeploy export`: a run folder in, a portable file out, compared with the policy."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import Json, States


def export(
    run: Annotated[
        str, typer.Argument(metavar="RUN", help="Run folder, its name under runs/, or 'last'.")
    ],
    to: Annotated[str, typer.Option(help="Format: nir for spiking policies, onnx for float ones.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="File to write.", show_default="in the run folder"),
    ] = None,
    observations: Annotated[
        int, typer.Option(min=1, help="Recorded observations on which file and policy must agree.")
    ] = 1000,
    state: Annotated[
        States,
        typer.Option(help="Membranes at an inference: reset as trained, or kept; nir only."),
    ] = "reset",
    json: Json = False,
) -> None:
    """Write a trained policy as .nir or .onnx, and check the file against it."""
    from spikedeploy.console import print_json
    from spikedeploy.reports.terminal import print_checks
    from spikedeploy.shipping.export_run import export_run

    written = export_run(run, to, output, observations, state=state)
    if json:
        checks = [vars(check) for check in written.checks]
        print_json({"path": str(written.path), "passed": written.passed, "checks": checks})
    else:
        print_checks(written.checks)
        typer.echo(f"wrote {written.path}")
    raise typer.Exit(0 if written.passed else 1)
