"""`emulate` and `drift`: networks on recorded spikes, without an environment."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import (
    Delay,
    Dt,
    Energy,
    EnvOptions,
    Floor,
    Force,
    From,
    Headroom,
    Integrator,
    Json,
    Like,
    LimitsOption,
    PageFolder,
    Quantise,
    Reset,
    Rounding,
    Seed,
    Spikes,
    State,
    Thresholds,
    WeightShift,
    quantisation,
)


def emulate(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, metavar="FILE.nir")],
    chip: Annotated[str, typer.Option(help="Chip, or 'float'.")],
    input_: Annotated[
        Path,
        typer.Option(
            "--input",
            exists=True,
            dir_okay=False,
            help="Spikes (T, *shape), 0 or 1, .npy; several inputs by name, .npz; or NIRData, .h5. "
            "In float any numbers.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="Spikes of each node and `output`, or each Output, .npz, or NIRData, .h5.",
        ),
    ],
    backend: Annotated[
        str | None,
        typer.Option(
            help="What computes a chip: auto, numpy, numba or interpreter.", show_default="numpy"
        ),
    ] = None,
    limits: LimitsOption = "on",
    energy: Energy = None,
    dt: Dt = None,
    reset: Reset = None,
    integrator: Integrator = None,
    delay: Delay = None,
    spikes: Spikes = None,
    floor: Floor = None,
    state: State = None,
    like: Like = None,
    from_: From = None,
    quantise: Quantise = "layer",
    rounding: Rounding = None,
    headroom: Headroom = "none",
    thresholds: Thresholds = None,
    weight_shift: WeightShift = 0,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run any NIR network on recorded spikes, and count what the chip does."""
    from dataclasses import replace

    from spikedeploy.console import print_json
    from spikedeploy.emulation.open_loop import emulate_artifact
    from spikedeploy.emulation.rasters import read_inputs
    from spikedeploy.outputs import check_output, mark, marked
    from spikedeploy.reports.terminal import print_emulation
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.metrics.energy import checked_table_names

    own = mark("emulate")
    check_output("-o", output, (file, input_), force, lambda path: marked(path, own))
    tables = checked_table_names(energy or ())
    rounded = quantisation(quantise, rounding, headroom, thresholds, weight_shift)
    artifact = load(
        file,
        dt=dt,
        reset=reset,
        integrator=integrator,
        delay=delay,
        spikes=spikes,
        floor=floor,
        state=state,
        like=like,
        written_by=from_,
    )
    rasters = read_inputs(input_, artifact)
    result = emulate_artifact(artifact, chip, rasters, backend, limits == "on", rounded)
    result = replace(result, tables=tables)
    result.save(output)
    if json:
        print_json(result.as_json())
    else:
        print_emulation(result)
        typer.echo(f"wrote {output}")


def drift(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A .nir file, run, or shipped name.")],
    chip: Annotated[
        str | None,
        typer.Option(help="Chip.", show_default="what it was trained for, else loihi1"),
    ] = None,
    input_: Annotated[
        Path | None,
        typer.Option("--input", exists=True, dir_okay=False, help="Spikes (T, *shape), .npy."),
    ] = None,
    random: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="Draw spikes at this rate, --steps timesteps of them."),
    ] = None,
    env: Annotated[
        str | None,
        typer.Option(help="Environment to observe.", show_default="the one it was made for"),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to observe.")] = 1,
    steps: Annotated[int, typer.Option(min=1, help="Control steps used of them.")] = 200,
    seed: Seed = seeds.EVALUATION,
    set_: EnvOptions = None,
    quantise: Quantise = "layer",
    rounding: Rounding = None,
    headroom: Headroom = "none",
    thresholds: Thresholds = None,
    weight_shift: WeightShift = 0,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Leave headroom for half of the inputs.")
    ] = False,
    tune: Annotated[
        bool, typer.Option("--tune", help="Search clipping and thresholds on half of the inputs.")
    ] = False,
    tau: Annotated[
        float, typer.Option(min=0.01, help="Time constant of the spike distance, in timesteps.")
    ] = 5.0,
    limits: LimitsOption = "on",
    dt: Dt = None,
    reset: Reset = None,
    integrator: Integrator = None,
    delay: Delay = None,
    spikes: Spikes = None,
    floor: Floor = None,
    state: State = None,
    like: Like = None,
    from_: From = None,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the tables as Markdown.")
    ] = False,
    output: PageFolder = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare a chip with the float twin spike by spike, and attribute differences to roundings."""
    from spikedeploy.console import print_json
    from spikedeploy.emulation.drift import choose_inputs, drift_report, path_of
    from spikedeploy.make_env import parse_options
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.drift import drift_markdown, drift_page, print_drift
    from spikedeploy.reports.page import FILES, is_page_of, write_page
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.chips.chip import chip as datasheet
    from spikedeploy.shipping.export_c import chip_of
    from spikedeploy.shipping.exported_run import runnable, trained_in

    env = env or trained_in(file)
    path = path_of(runnable(file))
    if output:
        check_output_folder("-o", output, FILES, (path, input_), force, is_page_of("drift"))
    artifact = load(
        path,
        dt=dt,
        reset=reset,
        integrator=integrator,
        delay=delay,
        spikes=spikes,
        floor=floor,
        state=state,
        like=like,
        written_by=from_,
    )
    options = parse_options(set_ or ())
    numbers = range(seed, seed + episodes)
    inputs = choose_inputs(artifact, path, input_, random, env, numbers, steps, options)
    report = drift_report(
        file,
        artifact,
        datasheet(chip or chip_of(artifact)),
        inputs,
        quantisation(quantise, rounding, headroom, thresholds, weight_shift),
        calibrate,
        tune,
        tau,
        limits == "on",
    )
    if output:
        write_page("drift", drift_page(report), report.as_json(), output)
    if json:
        print_json(report.as_json())
    elif markdown:
        typer.echo(drift_markdown(report))
    else:
        print_drift(report)
        if output:
            typer.echo(f"wrote {output / 'report.html'}")
