"""`spikedeploy run`: one policy in its environment, closed loop."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import (
    Energy,
    EnvOptions,
    Headroom,
    Json,
    LimitsOption,
    PolicyChip,
    Quantise,
    Rounding,
    Seed,
    Thresholds,
    WeightShift,
    quantisation,
)


def run(
    policy: Annotated[
        str, typer.Argument(metavar="FILE", help="A .onnx or .nir file, run folder, shipped name.")
    ],
    env: Annotated[
        str | None, typer.Option(help="Environment.", show_default="the one it was made for")
    ] = None,
    chip: PolicyChip = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes.")] = 1,
    seed: Seed = seeds.EVALUATION,
    sampled: Annotated[
        bool,
        typer.Option("--sampled", help="Draw actions by their probability, not the likeliest."),
    ] = False,
    set_: EnvOptions = None,
    video: Annotated[
        Path | None, typer.Option(dir_okay=False, help="MP4 of the first episode.")
    ] = None,
    limits: LimitsOption = "on",
    energy: Energy = None,
    quantise: Quantise = "layer",
    rounding: Rounding = None,
    headroom: Headroom = "none",
    thresholds: Thresholds = None,
    weight_shift: WeightShift = 0,
    json: Json = False,
) -> None:
    """Run one policy in its environment: returns, successes and costs."""
    from dataclasses import replace

    from spikedeploy.comparison.closed_loop import run_policy
    from spikedeploy.console import print_json
    from spikedeploy.make_env import parse_options
    from spikedeploy.reports import report
    from spikedeploy.reports.terminal import print_comparison
    from spikedeploy.runtime.metrics.energy import checked_table_names

    tables = checked_table_names(energy or ())
    numbers = range(seed, seed + episodes)
    rounded = quantisation(quantise, rounding, headroom, thresholds, weight_shift)
    comparison = run_policy(
        policy,
        env,
        chip,
        numbers,
        video,
        sampled,
        parse_options(set_ or ()),
        limits == "on",
        rounded,
    )
    document = report.document(replace(comparison, tables=tables))
    if json:
        print_json(document)
    else:
        print_comparison(document)
        if video:
            typer.echo(f"wrote {video}")
