"""Options that several commands share, worded once."""

from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from runtime.quantisation import Quantisation


class Granularity(str, Enum):
    """Which neurons share a scale."""

    layer = "layer"
    channel = "channel"


class Fraction(str, Enum):
    """What becomes of fractions."""

    nearest = "nearest"
    truncate = "truncate"


class Room(str, Enum):
    """What is left free of the registers."""

    none = "none"
    proven = "proven"


Json = Annotated[
    bool, typer.Option("--json", help="Print JSON for machines, and nothing else, on stdout.")
]
Seed = Annotated[
    int, typer.Option(help="The first seed; episode k plays seed + k. Evaluation starts at 10000.")
]
EnvOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="OPTION=VALUE", help="Option of the environment: --set track=small_S."
    ),
]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Processes that play episodes.", show_default="all cores")
]
Quantise = Annotated[
    Granularity, typer.Option("--quantise", help="A scale for each layer, or for each neuron.")
]
Rounding = Annotated[
    Fraction | None,
    typer.Option(
        "--rounding",
        help="Of weights, thresholds and decays, to integers.",
        show_default="the chip's own",
    ),
]
Headroom = Annotated[
    Room,
    typer.Option("--headroom", help="Fill the weights, or leave what no spikes can overflow."),
]
Thresholds = Annotated[
    int | None,
    typer.Option(
        "--thresholds", min=1, help="Most distinct thresholds of a layer, with --quantise channel."
    ),
]


def quantisation(
    quantise: Granularity, rounding: Fraction | None, headroom: Room, thresholds: int | None
) -> "Quantisation":
    """What the four options ask for."""
    from runtime.quantisation import Quantisation

    return Quantisation(
        quantise.value, rounding.value if rounding else None, headroom.value, thresholds
    )
