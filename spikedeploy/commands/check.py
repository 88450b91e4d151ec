"""`spikedeploy check`: a network against the design rules of chips."""

from typing import Annotated

import typer

from spikedeploy.commands.emulate import Integrator, Reset
from spikedeploy.commands.options import Json


def check(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A .nir file, or the name of a shipped policy.")
    ],
    chip: Annotated[
        list[str] | None,
        typer.Option(help="Chip; give it several times, or 'all'.", show_default="all"),
    ] = None,
    dt: Annotated[
        float | None, typer.Option(help="Timestep [s].", show_default="from the file")
    ] = None,
    reset: Annotated[Reset | None, typer.Option(show_default="from the file")] = None,
    integrator: Annotated[Integrator | None, typer.Option(show_default="from the file")] = None,
    delay: Annotated[
        int | None,
        typer.Option(min=0, max=1, help="Timesteps between layers.", show_default="from the file"),
    ] = None,
    like: Annotated[
        str | None,
        typer.Option(
            help="Read the file as lava, nengo, norse, rockpool, sinabs, snntorch or spikingjelly.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Say whether a network fits on chips, rule by rule and node by node.

    Exit code 0: every chip that was named passes; of 'all', at least one that has limits.
    """
    from spikedeploy.check import ALL
    from spikedeploy.check import check as judged
    from spikedeploy.check_tables import print_report
    from spikedeploy.terminal import print_json

    given = {
        "dt": dt,
        "reset": reset and reset.value,
        "integrator": integrator and integrator.value,
        "delay": delay,
        "like": like,
    }
    report = judged(file, chip or [ALL], **given)
    if json:
        print_json(report.as_json())
    else:
        print_report(report)
    raise typer.Exit(0 if report.passed else 1)
