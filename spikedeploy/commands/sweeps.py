"""`sweep`: a grid of evaluations, on one core, all of them, or a cluster."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from spikedeploy.commands.options import Force, Json, Workers

# as the table BACKENDS of spikedeploy.sweeps.backends has them; a test holds both together
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
    from spikedeploy.console import print_json, say
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.sweeps.backends import backend_called
    from spikedeploy.sweeps.grid import read_grid
    from spikedeploy.sweeps.page import NUMBERS, PAGE, SHOWN, print_sweep
    from spikedeploy.sweeps.store import is_sweep
    from spikedeploy.sweeps.sweep import look_at_sweep, run_sweep

    grid = read_grid(spec)
    folder = output or Path("runs/sweeps") / grid.name
    check_output_folder(
        "-o", folder, (PAGE, SHOWN, NUMBERS, "journal.csv"), (spec,), force, is_sweep
    )
    chosen = backend_called(backend, workers, address)
    outcome = run_sweep(grid, folder, chosen, retry) if run else look_at_sweep(grid, folder)
    state = outcome.state
    if json:
        print_json(state.as_json() | {"folder": str(folder), "ran": outcome.ran})
    else:
        print_sweep(state)
        for label, why in state.failures:
            typer.echo(f"failed: {label}: {why}", err=True)
        typer.echo(f"{state.summary}: {outcome.files[0]}")
    if outcome.interrupted:
        say("stopped; the same command goes on")
        raise typer.Exit(130)
    raise typer.Exit(1 if state.failed else 0)
