"""Options that several commands share, one by one and in groups.

A command takes a group as a parameter, a dataclass of options; `with_groups` makes the function
that typer understands, with a parameter for each field.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import typer

if TYPE_CHECKING:
    from spikedeploy.runtime.chips.quantisation import Quantisation
    from spikedeploy.runtime.faults import Faults

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

_READING, _CHIP, _WORLD = "How FILE is read", "The emulated chip", "The environment"
_reading = partial(typer.Option, rich_help_panel=_READING)
_unread = partial(_reading, show_default="from the file")
_chip = partial(typer.Option, rich_help_panel=_CHIP)
_world = partial(typer.Option, rich_help_panel=_WORLD)


def with_groups(
    command: Callable[..., Any], call: Callable[..., object] | None = None
) -> Callable[..., Any]:
    """The command with an option for each field of the groups that it takes.

    call  is called in place of the command
    """
    hints = get_type_hints(command, include_extras=True)
    groups = {
        name: hint for name, hint in hints.items() if isinstance(hint, type) and is_dataclass(hint)
    }
    parameters: list[inspect.Parameter] = []
    for name, own in inspect.signature(command).parameters.items():
        members = inspect.signature(groups[name]).parameters if name in groups else {name: own}
        parameters += [each.replace(kind=own.KEYWORD_ONLY) for each in members.values()]

    @wraps(command)
    def run(**given: Any) -> object:  # noqa: ANN401
        for name, group in groups.items():
            given[name] = group(**{each.name: given.pop(each.name) for each in fields(group)})
        return (call or command)(**given)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


LimitsOption = Annotated[
    Switch,
    _chip(
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
    _world(
        "--set",
        metavar="OPTION=VALUE",
        help="Option of the environment: --set track=small_S.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One setting, as in --set updates=8000."),
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
Markdown = Annotated[bool, typer.Option("--markdown", help="Print the tables as Markdown.")]
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
    Computes,
    _chip(help="What computes a chip; numba needs the extra fast."),
]
Dt = Annotated[
    float | None,
    _unread(help=r"Timestep \[s]."),
]
Reset = Annotated[
    AfterSpike | None,
    _unread(
        help="Membrane after a spike: v_reset, or less that distance, at once or in the next "
        "timestep; docs/own-network.md has the equations.",
    ),
]
From = Annotated[
    str | None,
    _reading(
        "--from",
        metavar="TOOL",
        help="Read the file as its author meant it, who exported it from snntorch, norse, "
        "spikingjelly, sinabs, rockpool or lava.",
    ),
]


@dataclass(frozen=True)
class Reading:
    """Options for what NIR leaves open; they take precedence over the file."""

    dt: Dt = None
    reset: Reset = None
    integrator: Annotated[
        Decays | None,
        _unread(
            help="Decays: 1 - dt/tau, or exp(-dt/tau).",
        ),
    ] = None
    delay: Annotated[
        int | None,
        _unread(
            min=0,
            max=1,
            help="Timesteps between layers.",
        ),
    ] = None
    spikes: Annotated[
        SpikeCount | None,
        _unread(
            help="One above the threshold, one when it is reached, or as many as fit.",
        ),
    ] = None
    floor: Annotated[
        LowestMembrane | None,
        _unread(
            help="Lowest membrane: none, 0, or -threshold.",
        ),
    ] = None
    state: Annotated[
        States | None,
        _unread(
            help="States at the next inference.",
        ),
    ] = None
    like: Annotated[
        str | None,
        _reading(
            metavar="TOOL",
            help="Read the file as the import of lava, nengo, norse, rockpool, sinabs, snntorch or "
            "spikingjelly does.",
        ),
    ] = None
    from_: From = None

    def arguments(self) -> dict[str, Any]:
        """Arguments of `artifact.load`."""
        return {"written_by" if n == "from_" else n: value for n, value in vars(self).items()}


@dataclass(frozen=True)
class OnChip:
    """Options for how a network is put on a chip."""

    limits: LimitsOption = "on"
    quantise: Annotated[
        Granularity,
        _chip(help="One scale for a layer, or for each neuron."),
    ] = "layer"
    rounding: Annotated[
        Fraction | None,
        _chip(
            help="Rounding of weights, thresholds and decays.",
            show_default="the chip's own",
        ),
    ] = None
    headroom: Annotated[
        HeadroomChoice,
        _chip(
            help="Fill the range of weights, or leave enough that nothing overflows.",
        ),
    ] = "none"
    thresholds: Annotated[
        int | None,
        _chip(
            min=1,
            help="Most distinct thresholds of a layer, with --quantise channel.",
        ),
    ] = None
    weight_shift: Annotated[
        int,
        _chip(min=0, help="Bits that a Xylo shifts weights to the left."),
    ] = 0

    def quantisation(self) -> "Quantisation":
        """The quantisation of the five options."""
        from spikedeploy.runtime.chips.quantisation import Quantisation

        return Quantisation(
            self.quantise,
            self.rounding,
            self.headroom,
            self.thresholds,
            weight_shift=self.weight_shift,
        )

    def arguments(self) -> dict[str, Any]:
        """Quantisation, and whether design rules are enforced."""
        return {"limits": self.limits == "on", "quantisation": self.quantisation()}


@dataclass(frozen=True)
class World:
    """Options for an environment, and for what is measured in it."""

    set_: EnvOptions = None
    success: Annotated[
        str | None,
        _world(
            metavar="KEY",
            help="Key of the step infos that says success, of an environment that is not ours.",
            show_default="its registered reward threshold",
        ),
    ] = None
    metric: Annotated[
        list[str] | None,
        _world(
            metavar="NAME:mean|last|max",
            help="A number of the step infos as a column, as in x_velocity:mean, may be repeated.",
        ),
    ] = None
    disturb: Annotated[
        list[str] | None,
        _world(
            metavar="NAME:LEVEL",
            help="Disturbance of the world at level 1 to 3, or NAME=NUMBER, may be repeated; "
            "docs/robustness.md lists them.",
        ),
    ] = None

    def options(self) -> dict[str, Any]:
        """Options of `make_env`."""
        from spikedeploy.make_env import parse_options

        return parse_options(self.set_ or (), self.disturb or (), self.success)


@dataclass(frozen=True)
class Damaged:
    """Options for faults of the chip."""

    fault: Annotated[
        list[str] | None,
        _chip(
            metavar="NAME:LEVEL",
            help="Fault of the chip at level 1 to 3, or NAME=NUMBER, may be repeated; "
            "docs/robustness.md lists them.",
        ),
    ] = None
    specimen: Annotated[
        int,
        _chip(
            min=0,
            help="Which faulty chip: decides which parts --fault hits.",
        ),
    ] = 0

    def faults(self) -> "Faults":
        """The faults, parsed."""
        from spikedeploy.runtime.faults import faults

        return faults(self.fault or (), self.specimen)
