"""Options that several commands share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from spikedeploy.runtime.chips.quantisation import Quantisation


# The choices of the runtime, which takes numpy to load; tests/spikedeploy/commands/test_options.py
# holds them to the originals.
Switch = Literal["on", "off"]
Granularity = Literal["layer", "channel"]
Fraction = Literal["nearest", "truncate"]
TablesChoice = Literal["one", "all"]
HeadroomChoice = Literal["none", "proven"]
AfterSpike = Literal[
    "zero", "subtract", "zero-delayed", "subtract-delayed", "subtract-ahead", "none"
]
Decays = Literal["euler", "exponential"]
States = Literal["reset", "kept"]
TeacherUnits = Literal["own", "scaled"]
Computes = Literal["numpy", "numba", "auto", "interpreter"]
Encoders = Literal["population", "rate", "delta"]
SpikeCount = Literal["above", "reached", "many"]
LowestMembrane = Literal["none", "zero", "threshold"]

LimitsOption = Annotated[
    Switch,
    typer.Option(
        "--limits",
        help="Refuse what breaks a design rule of the chip; 'off' emulates its arithmetic alone.",
    ),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print JSON for machines, and nothing else, on stdout.")
]
Force = Annotated[
    bool, typer.Option("--force", help="Replace files that this command did not write.")
]
PageFolder = Annotated[
    Path | None,
    typer.Option("-o", "--output", help="Folder for report.html and report.json."),
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
Success = Annotated[
    str | None,
    typer.Option(
        metavar="KEY",
        help="Key of the step infos that says success, of an environment that is not ours.",
        show_default="its registered reward threshold",
    ),
]
Metrics = Annotated[
    list[str] | None,
    typer.Option(
        "--metric",
        metavar="NAME:mean|last|max",
        help="A number of the step infos as a column, as in x_velocity:mean, may be repeated.",
    ),
]
Disturb = Annotated[
    list[str] | None,
    typer.Option(
        "--disturb",
        metavar="NAME:LEVEL",
        help="Disturbance of the world at level 1 to 3, or NAME=NUMBER, may be repeated; "
        "docs/robustness.md lists them.",
    ),
]
FaultsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="NAME:LEVEL",
        help="Fault of the chip at level 1 to 3, or NAME=NUMBER, may be repeated; "
        "docs/robustness.md lists them.",
    ),
]
Specimen = Annotated[
    int, typer.Option(min=0, help="Which faulty chip: decides which parts --fault hits.")
]
Energy = Annotated[
    list[str] | None,
    typer.Option(
        "--energy",
        metavar="TABLE",
        help="Energy table to price by, may be repeated; `energy` lists them.",
        show_default="the chip's own",
    ),
]
Tables = Annotated[
    TablesChoice,
    typer.Option(
        "--tables", help="Print one table of 80 columns, or all: agreement, sizes, energies."
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
        show_default="what it was trained for, else loihi1",
    ),
]
Backend = Annotated[
    Computes, typer.Option(help="What computes a chip; numba needs the extra fast.")
]

Rate = Annotated[
    float | None,
    typer.Option(
        help=r"Control steps per second \[Hz] by the clock; missed deadlines are counted.",
        show_default="as fast as it can",
    ),
]
Deadline = Annotated[
    str | None,
    typer.Option(
        metavar="TIME", help="With --rate: 20ms; of a control step.", show_default="the period"
    ),
]
Lasting = Annotated[
    str | None,
    typer.Option(
        "--duration",
        metavar="TIME",
        help="With --rate: 60s; episodes are played until it has passed, the last to its end.",
    ),
]

Watch = Annotated[
    bool,
    typer.Option(
        "--watch", help="Show robot, spikes, energy, deadlines in a browser of this machine."
    ),
]
WatchPort = Annotated[
    int | None,
    typer.Option(min=1, max=65535, help="With --watch: TCP port.", show_default="one that is free"),
]

# what NIR leaves open: these take precedence over the file
FROM_FILE = "from the file"
Dt = Annotated[float | None, typer.Option(help=r"Timestep \[s].", show_default=FROM_FILE)]
Reset = Annotated[
    AfterSpike | None,
    typer.Option(
        help="Membrane after a spike: v_reset, or less that distance, at once or in the next "
        "timestep; docs/own-network.md has the equations.",
        show_default=FROM_FILE,
    ),
]
Integrator = Annotated[
    Decays | None,
    typer.Option(help="Decays: 1 - dt/tau, or exp(-dt/tau).", show_default=FROM_FILE),
]
Delay = Annotated[
    int | None,
    typer.Option(min=0, max=1, help="Timesteps between layers.", show_default=FROM_FILE),
]
State = Annotated[
    States | None,
    typer.Option(help="States at the next inference.", show_default=FROM_FILE),
]
Spikes = Annotated[
    SpikeCount | None,
    typer.Option(
        help="One above the threshold, one when it is reached, or as many as fit.",
        show_default=FROM_FILE,
    ),
]
Floor = Annotated[
    LowestMembrane | None,
    typer.Option(help="Lowest membrane: none, 0, or -threshold.", show_default=FROM_FILE),
]
Like = Annotated[
    str | None,
    typer.Option(
        metavar="TOOL",
        help="Read the file as the import of lava, nengo, norse, rockpool, sinabs, snntorch or "
        "spikingjelly does.",
    ),
]
From = Annotated[
    str | None,
    typer.Option(
        "--from",
        metavar="TOOL",
        help="Read the file as its author meant it, who exported it from snntorch, norse, "
        "spikingjelly, sinabs, rockpool or lava.",
    ),
]
For = Annotated[
    str | None,
    typer.Option(
        "--for",
        metavar="TOOL",
        help="In the scaling that the import of norse, rockpool, snntorch or spikingjelly accepts; "
        "nir only.",
    ),
]
NirCompat = Annotated[
    str | None,
    typer.Option("--nir-compat", metavar="RELEASE", help="Release of nir that opens the file."),
]
Quantise = Annotated[
    Granularity, typer.Option("--quantise", help="One scale for a layer, or for each neuron.")
]
Rounding = Annotated[
    Fraction | None,
    typer.Option(
        "--rounding",
        help="Rounding of weights, thresholds and decays.",
        show_default="the chip's own",
    ),
]
Headroom = Annotated[
    HeadroomChoice,
    typer.Option(
        "--headroom",
        help="Fill the range of weights, or leave enough that nothing overflows.",
    ),
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
    headroom: HeadroomChoice,
    thresholds: int | None,
    weight_shift: int,
) -> "Quantisation":
    """The quantisation that the five options ask for."""
    from spikedeploy.runtime.chips.quantisation import Quantisation

    return Quantisation(quantise, rounding, headroom, thresholds, weight_shift=weight_shift)
