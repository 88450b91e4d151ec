"""`spikedeploy emulate`: rasters into a network, open loop."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import (
    Delay,
    Dt,
    Energy,
    Floor,
    Headroom,
    Integrator,
    Json,
    Like,
    LimitsOption,
    Quantise,
    Reset,
    Rounding,
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
            help="Spikes (T, *shape), 0 or 1, .npy; several inputs by name, .npz. In float any "
            "numbers.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Spikes of each node and `output`, or each Output, .npz."
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
    quantise: Quantise = "layer",
    rounding: Rounding = None,
    headroom: Headroom = "none",
    thresholds: Thresholds = None,
    weight_shift: WeightShift = 0,
    json: Json = False,
) -> None:
    """Run any NIR network on recorded spikes, and count what the chip does."""
    from dataclasses import replace

    from spikedeploy.console import print_json
    from spikedeploy.emulation.open_loop import emulate_file
    from spikedeploy.emulation.rasters import read_rasters
    from spikedeploy.reports.terminal import print_emulation
    from spikedeploy.runtime.metrics.energy import checked_table_names

    tables = checked_table_names(energy or ())
    rounded = quantisation(quantise, rounding, headroom, thresholds, weight_shift)
    result = emulate_file(
        file,
        chip,
        read_rasters(input_),
        backend,
        limits == "on",
        rounded,
        dt=dt,
        reset=reset,
        integrator=integrator,
        delay=delay,
        spikes=spikes,
        floor=floor,
        state=state,
        like=like,
    )
    result = replace(result, tables=tables)
    result.save(output)
    if json:
        print_json(result.as_json())
    else:
        print_emulation(result)
        typer.echo(f"wrote {output}")
