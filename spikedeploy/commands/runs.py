"""`runs`: the training runs in a folder, and what they earned."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from spikedeploy.commands.options import Json

# fields of RunScores; a test holds them together
SortKey = Literal["return", "success", "operations", "share", "age", "name"]


def runs(
    folder: Annotated[
        Path, typer.Option("--runs", help="Folder with the run folders; also those below it.")
    ] = Path("runs"),
    sort: Annotated[
        SortKey, typer.Option(help="Column to sort by; the best, newest or first are on top.")
    ] = "age",
    env: Annotated[
        str | None, typer.Option(help="Only of this environment.", show_default="all")
    ] = None,
    json: Json = False,
) -> None:
    """List training runs: validation return, success, operations, how far each came, age."""
    from spikedeploy.console import name_program, print_json
    from spikedeploy.reports.runs import find_runs, run_table

    rows, damaged = find_runs(folder, env, sort)
    if json:
        print_json([row.as_json() for row in rows])
    elif rows:
        run_table(rows, folder).print()
    else:
        typer.echo(name_program(f"no runs in {folder}: `spikedeploy train RECIPE` makes one"))
    for line in damaged:
        typer.echo(f"left out: {line}", err=True)
