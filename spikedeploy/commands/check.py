"""`spikedeploy check`: a network against the design rules of chips."""

from typing import Annotated

import typer

from spikedeploy.commands.options import (
    Delay,
    Dt,
    Floor,
    Integrator,
    Json,
    Like,
    Reset,
    Spikes,
    State,
)


def check(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A .nir file, or the name of a shipped policy.")
    ],
    chip: Annotated[
        list[str] | None,
        typer.Option(help="Chip; give it several times, or 'all'.", show_default="all"),
    ] = None,
    dt: Dt = None,
    reset: Reset = None,
    integrator: Integrator = None,
    delay: Delay = None,
    spikes: Spikes = None,
    floor: Floor = None,
    state: State = None,
    like: Like = None,
    json: Json = False,
) -> None:
    """Check whether a network fits on chips, rule by rule and node by node.

    Exit code 0: every chip that was named passes; of 'all', at least one that has limits.
    """
    from spikedeploy.console import print_json
    from spikedeploy.emulation.design_report import ALL, design_report
    from spikedeploy.reports.check_tables import print_report

    report = design_report(
        file,
        chip or [ALL],
        dt=dt,
        reset=reset,
        integrator=integrator,
        delay=delay,
        spikes=spikes,
        floor=floor,
        state=state,
        like=like,
    )
    if json:
        print_json(report.as_json())
    else:
        print_report(report)
    raise typer.Exit(0 if report.passed else 1)
