"""`spikedeploy visualize`: learning curves as a picture."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import Json


def visualize(
    runs: Annotated[
        list[Path],
        typer.Argument(exists=True, file_okay=False, help="Run folders.", metavar="RUN…"),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="PNG to write.")] = Path(
        "reports/curves.png"
    ),
    json: Json = False,
) -> None:
    """Draw the learning curves of training runs into one PNG."""
    from spikedeploy.console import print_json
    from spikedeploy.reports.curves import curve
    from spikedeploy.reports.plots import draw_curves

    curves = [curve(run / "metrics.csv", run.resolve().name) for run in runs]
    picture = draw_curves(curves, output)
    if json:
        print_json({"path": str(picture), "curves": [vars(each) for each in curves]})
    else:
        typer.echo(f"wrote {picture}")
