"""`spikedeploy publish`: a run becomes a shipped policy with its card."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import Json, Workers


def publish(
    run: Annotated[
        str, typer.Argument(metavar="RUN", help="Run folder, its name under runs/, or 'last'.")
    ],
    name: Annotated[str, typer.Option(help="Name in the zoo, such as popsan.")],
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of the card's evaluation.")] = 100,
    note: Annotated[str, typer.Option(help="Note for the card.")] = "",
    control: Annotated[
        bool, typer.Option("--control", help="Comparisons show it as a control.")
    ] = False,
    workers: Workers = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder of the zoo.", show_default="the package's own"),
    ] = None,
    json: Json = False,
) -> None:
    """Export a run into the zoo: the file, its card, its learning curve and its evaluation."""
    from spikedeploy import zoo
    from spikedeploy.console import print_json
    from spikedeploy.shipping.publish_run import publish_run

    files = publish_run(run, name, episodes, output or zoo.FOLDER, workers, note, control)
    if json:
        print_json({"files": [str(file) for file in files]})
    else:
        typer.echo("wrote " + ", ".join(str(file) for file in files))
