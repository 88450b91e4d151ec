"""`sweep`: a grid of evaluations, on one core, all of them, or a cluster."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from spikedeploy.commands.options import Force, Json, Workers

# as the table BACKENDS of spikedeploy.jobs has them; a test holds both together
BackendName = Literal["serial", "process", "ray"]


def sweep(
    spec: Annotated[
        Path,
        typer.Argument(
            metavar="SPEC.toml",
            exists=True,
            dir_okay=False,
            help="The grid: env, policy, chip, bits, disturb, fault, specimen, seed; "
            "docs/sweeps.md.",
        ),
    ],
    backend: Annotated[
        BackendName,
        typer.Option(help="This process, several of one thread each, or tasks of Ray."),
    ] = "process",
    workers: Workers = None,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="With --backend ray: a cluster that is running; 'auto' for that of this machine.",
            show_default="Ray is started here, and ended",
        ),
    ] = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="Run those again that failed, too.")
    ] = False,
    run: Annotated[
        bool, typer.Option(help="Run missing jobs; --no-run only shows what is there.")
    ] = True,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Folder of the results.", show_default="runs/sweeps/NAME"
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Evaluate a grid of policies, chips, disturbances and seeds; run again, it goes on."""
    from spikedeploy import jobs
    from spikedeploy.campaign.sweep import is_sweep, load_sweep, run_sweep
    from spikedeploy.campaign.sweep_grid import read_grid
    from spikedeploy.campaign.sweep_page import NUMBERS, PAGE, SHOWN, print_sweep
    from spikedeploy.console import print_json, say
    from spikedeploy.outputs import check_output_folder

    grid = read_grid(spec)
    folder = output or Path("runs/sweeps") / grid.name
    check_output_folder(
        "-o", folder, (PAGE, SHOWN, NUMBERS, "journal.csv"), (spec,), force, is_sweep
    )
    chosen = jobs.backend(backend, workers, address)
    found = run_sweep(grid, folder, chosen, retry) if run else load_sweep(grid, folder)
    if json:
        print_json(found.as_json() | {"folder": str(folder), "ran": found.ran})
    else:
        print_sweep(found)
        for label, why in found.failures:
            typer.echo(f"failed: {label}: {why}", err=True)
        typer.echo(f"{found.summary}: {found.files[0]}")
    if found.interrupted:
        say("stopped; the same command goes on")
        raise typer.Exit(130)
    raise typer.Exit(1 if found.failed else 0)
