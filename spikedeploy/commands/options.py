"""Options that several commands share, worded once."""

from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from spikedeploy.runtime.chips.quantisation import Quantisation


class LimitsSwitch(str, Enum):
    """Whether a chip refuses what breaks its design rules."""

    on = "on"
    off = "off"


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


LimitsOption = Annotated[
    LimitsSwitch,
    typer.Option(
        "--limits",
        help="Refuse what breaks a design rule of the chip; 'off' emulates its arithmetic alone.",
    ),
]
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
Energy = Annotated[
    list[str] | None,
    typer.Option(
        "--energy",
        metavar="TABLE",
        help="Energy table to price by, as often as you like; `energy` lists them.",
        show_default="the chip's own",
    ),
]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Processes that play episodes.", show_default="all cores")
]
PolicyChip = Annotated[
    str | None,
    typer.Option(
        "--chip",
        help="Chip of a spiking policy; 'float' for its float twin.",
        show_default="loihi1",
    ),
]

# what NIR leaves open: these go before what a file says


class ResetChoice(str, Enum):
    """What a spike does to the membrane."""

    zero = "zero"
    subtract = "subtract"


class IntegratorChoice(str, Enum):
    """How decays follow from time constants."""

    euler = "euler"
    exponential = "exponential"


class StateChoice(str, Enum):
    """Whether states go on from one inference to the next."""

    reset = "reset"
    kept = "kept"


class SpikesChoice(str, Enum):
    """How many spikes a neuron sends in a timestep, and when."""

    above = "above"
    reached = "reached"
    many = "many"


class FloorChoice(str, Enum):
    """Below which no membrane stays."""

    none = "none"
    zero = "zero"
    threshold = "threshold"


FROM_FILE = "from the file"
Dt = Annotated[float | None, typer.Option(help="Timestep [s].", show_default=FROM_FILE)]
Reset = Annotated[
    ResetChoice | None,
    typer.Option(
        help="Membrane after a spike: v_reset, or less that distance.", show_default=FROM_FILE
    ),
]
Integrator = Annotated[
    IntegratorChoice | None,
    typer.Option(help="Decays: 1 - dt/tau, or exp(-dt/tau).", show_default=FROM_FILE),
]
Delay = Annotated[
    int | None,
    typer.Option(min=0, max=1, help="Timesteps between layers.", show_default=FROM_FILE),
]
State = Annotated[
    StateChoice | None,
    typer.Option(help="States at the next inference.", show_default=FROM_FILE),
]
Spikes = Annotated[
    SpikesChoice | None,
    typer.Option(
        help="One above the threshold, one when it is reached, or as many as fit.",
        show_default=FROM_FILE,
    ),
]
Floor = Annotated[
    FloorChoice | None,
    typer.Option(help="Lowest membrane: none, 0, or -threshold.", show_default=FROM_FILE),
]
Like = Annotated[
    str | None,
    typer.Option(
        help="Read the file as lava, nengo, norse, rockpool, sinabs, snntorch or spikingjelly.",
    ),
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
WeightShift = Annotated[
    int, typer.Option("--weight-shift", min=0, help="Bits that a Xylo shifts weights to the left.")
]


def quantisation(
    quantise: Granularity,
    rounding: Fraction | None,
    headroom: Room,
    thresholds: int | None,
    weight_shift: int,
) -> "Quantisation":
    """What the five options ask for."""
    from spikedeploy.runtime.chips.quantisation import Quantisation

    return Quantisation(
        quantise.value,
        rounding.value if rounding else None,
        headroom.value,
        thresholds,
        weight_shift=weight_shift,
    )


def reading(**options: Any) -> dict[str, Any]:  # noqa: ANN401
    """Options of how to read a file, by the names that runtime.artifact.load has for them."""
    return {name: v.value if isinstance(v, Enum) else v for name, v in options.items()}
