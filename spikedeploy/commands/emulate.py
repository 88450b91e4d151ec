"""`spikedeploy emulate`: spikes into a network, open loop."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import (
    Granularity,
    Headroom,
    Json,
    Quantise,
    Room,
    Rounding,
    Thresholds,
    quantisation,
)


class Reset(str, Enum):
    """What a spike does to the membrane."""

    zero = "zero"
    subtract = "subtract"


class Integrator(str, Enum):
    """How decays follow from time constants."""

    euler = "euler"
    exponential = "exponential"


def emulate(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, metavar="FILE.nir")],
    chip: Annotated[str, typer.Option(help="Chip, or 'float'.")],
    input_: Annotated[
        Path,
        typer.Option("--input", exists=True, dir_okay=False, help="Spikes (T, N), 0 or 1, .npy."),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Spikes of each node and `output`, .npz."),
    ],
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
    quantise: Quantise = Granularity.layer,
    rounding: Rounding = None,
    headroom: Headroom = Room.none,
    thresholds: Thresholds = None,
    json: Json = False,
) -> None:
    """Play recorded spikes into any NIR network, and count what the chip does."""
    from spikedeploy.emulate import emulate as play
    from spikedeploy.emulate import read_raster
    from spikedeploy.terminal import print_emulation, print_json

    given = {
        "dt": dt,
        "reset": reset and reset.value,
        "integrator": integrator and integrator.value,
        "delay": delay,
        "like": like,
    }
    rounded = quantisation(quantise, rounding, headroom, thresholds)
    result = play(file, chip, read_raster(input_), rounded, **given)
    result.save(output)
    if json:
        print_json(result.as_json())
    else:
        print_emulation(result)
        typer.echo(f"wrote {output}")
