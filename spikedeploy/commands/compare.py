"""`spikedeploy compare`: policies on the same seeds, with intervals and costs."""

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
    Quantise,
    Rounding,
    Seed,
    Thresholds,
    WeightShift,
    Workers,
    quantisation,
)


def compare(
    env: Annotated[str, typer.Argument(metavar="ENV", help="Environment; `envs` lists them.")],
    files: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FILE]…",
            help="Policies: .onnx, .nir, run folders, shipped names. The float ANN, the "
            "built-in players and the controls are added.",
            show_default="all that are shipped",
        ),
    ] = None,
    chips: Annotated[str, typer.Option(help="Chips for the spiking policies.")] = "loihi1",
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each row.")] = 20,
    seed: Seed = seeds.EVALUATION,
    set_: EnvOptions = None,
    energy: Energy = None,
    workers: Workers = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for report.json, report.html and plots."),
    ] = None,
    limits: LimitsOption = "on",
    quantise: Quantise = "layer",
    rounding: Rounding = None,
    headroom: Headroom = "none",
    thresholds: Thresholds = None,
    weight_shift: WeightShift = 0,
    json: Json = False,
) -> None:
    """Compare policies on the same seeds: returns, agreement, spikes, operations, energy."""
    from dataclasses import replace

    from spikedeploy.comparison.lineup import line_up
    from spikedeploy.comparison.rounds import compare_policies
    from spikedeploy.console import print_json
    from spikedeploy.make_env import parse_options
    from spikedeploy.reports import report
    from spikedeploy.reports.terminal import print_comparison
    from spikedeploy.runtime.chips.chip import listed
    from spikedeploy.runtime.metrics.energy import checked_table_names

    tables = checked_table_names(energy or ())
    rounded = quantisation(quantise, rounding, headroom, thresholds, weight_shift)
    entries = line_up(env, files or (), listed(chips), limits == "on", rounded)
    comparison = compare_policies(
        env, entries, range(seed, seed + episodes), workers, parse_options(set_ or ())
    )
    document = report.document(replace(comparison, tables=tables))
    if output:
        report.write(document, output)
    if json:
        print_json(document)
    else:
        print_comparison(document)
        if output:
            typer.echo(f"wrote {output / 'report.html'}")
