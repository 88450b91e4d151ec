"""Groups of options that several commands share, and the help of all options, from options.toml.

A command takes a group as a parameter, a dataclass of options; `with_groups` makes the function
that typer understands, with a parameter for each field.
"""

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

import typer

from spikedeploy.commands.completion import words_of
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_toml

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
Channels = Literal["off-on", "on-off"]
EventStep = Literal["time", "event"]
LowestMembrane = Literal["none", "zero", "threshold"]


# what a command prints and writes, which has a panel of its own where it is as much as _PANEL
_OUTPUT = ("output", "tuned", "video", "energy", "tables", "markdown", "force", "json")
_PANEL = 4
_TABLES = read_toml(Path(__file__).with_name("options.toml"))


_SYNONYMS = {"chips": "chip"}  # accepted in every command, as reports have them; not in the help


def one_word(name: str) -> str:
    """The name of an option for one of its synonyms; any other name as it is."""
    return _SYNONYMS.get(name, name)


def with_groups(
    command: Callable[..., Any], call: Callable[..., object] | None = None
) -> Callable[..., Any]:
    """The command as typer understands it: an option for each field of its groups, with their help.

    call  is called in place of the command
    """
    hints = get_type_hints(command)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters = _parameters(command)
    printed = [each.default for each in parameters if each.name in _OUTPUT]
    for option in printed if len(printed) >= _PANEL else ():
        option.rich_help_panel = "Output"

    @wraps(command)
    def run(**given: Any) -> object:  # noqa: ANN401
        for name, group in groups.items():
            given[name] = group(**{each.name: given.pop(each.name) for each in fields(group)})
        return (call or command)(**given)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run


def _parameters(of: Callable[..., Any]) -> list[inspect.Parameter]:
    hints, found, grouped = get_type_hints(of), list[inspect.Parameter](), []
    for name, own in inspect.signature(of).parameters.items():
        if is_dataclass(hints[name]):
            grouped += _parameters(hints[name])
        else:
            found.append(_option(of.__name__, own, hints[name]))
    return found + grouped


def _option(owner: str, own: inspect.Parameter, kind: Any) -> inspect.Parameter:  # noqa: ANN401
    table = _TABLES.get(owner, {})
    every = {key: value for key, value in table.items() if isinstance(value, str)}
    words: dict[str, Any] = {**every, **(table.get(own.name) or _TABLES["shared"][own.name])}
    default = ... if own.default is own.empty else own.default
    words["autocompletion"] = words_of(owner, own.name)
    if words.pop("argument", False):
        info = typer.Argument(default, **words)
    else:  # of a switch that is on, typer makes --no-… too
        flag = f"--{own.name.strip('_').replace('_', '-')}"
        info = typer.Option(
            default, *words.pop("flags", () if default is True else [flag]), **words
        )
    return own.replace(kind=own.KEYWORD_ONLY, annotation=kind, default=info)


@dataclass(frozen=True)
class Reading:
    """Options for what NIR leaves open; they take precedence over the file."""

    dt: float | None = None
    reset: AfterSpike | None = None
    integrator: Decays | None = None
    delay: int | None = None
    spikes: SpikeCount | None = None
    floor: LowestMembrane | None = None
    state: States | None = None
    like: str | None = None
    from_: str | None = None

    def arguments(self) -> dict[str, Any]:
        """Arguments of `artifact.load`."""
        return {"written_by" if n == "from_" else n: value for n, value in vars(self).items()}


@dataclass(frozen=True)
class OnChip:
    """Options for how a network is put on a chip."""

    limits: Switch = "on"
    quantise: Granularity = "layer"
    rounding: Fraction | None = None
    headroom: HeadroomChoice = "none"
    thresholds: int | None = None
    weight_shift: int = 0

    def words(self) -> list[str]:
        """The options of the quantisation that were given, as on the command line."""
        given = {n: value for n, value in vars(self).items() if value != getattr(OnChip, n)}
        given.pop("limits", None)
        return [f"--{name.replace('_', '-')} {value}" for name, value in given.items()]

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
class FromCamera:
    """Options for a recording of an event camera as input."""

    events: Path | None = None
    camera: str | None = None
    region: str | None = None
    downsample: int = 1
    channels: Channels = "off-on"
    time_step: str | None = None
    step: EventStep = "time"
    page: Path | None = None

    def size(self) -> tuple[int, int] | None:
        """(height, width) of the camera [pixels], where it was given."""
        if self.camera is None:
            return None
        height, width = _whole_numbers("--camera", self.camera, "x", "height x width, as in 48x64")
        if min(height, width) < 1:
            raise ConfigError(f"--camera {self.camera}: the least is 1x1 pixel.")
        return height, width

    def part(self) -> tuple[int, int, int, int] | None:
        """X, y, width and height of the region [pixels], where it was given."""
        if self.region is None:
            return None
        form = "x,y,width,height in pixels, as in 0,0,64,48"
        x, y, width, height = _whole_numbers("--region", self.region, ",", form)
        return x, y, width, height

    def seconds(self) -> float | None:
        """Duration of a timestep [s], where it was given."""
        from spikedeploy.realtime.paced_loop import duration

        return None if self.time_step is None else duration("--time-step", self.time_step)


def _whole_numbers(option: str, text: str, between: str, form: str) -> list[int]:
    """The numbers of a text, as many as its form shows."""
    parts = text.split(between)
    as_form = len(parts) == form.partition(" as in ")[2].count(between) + 1
    if not as_form or not all(re.fullmatch(r"\s*-?[0-9]{1,9}\s*", part) for part in parts):
        raise ConfigError(f"{option} {text[:40]!r} is no {form}.")
    return [int(part) for part in parts]


@dataclass(frozen=True)
class World:
    """Options for an environment, and for what is measured in it."""

    set_: list[str] | None = None
    success: str | None = None
    metric: list[str] | None = None
    disturb: list[str] | None = None

    def options(self) -> dict[str, Any]:
        """Options of `make_env`."""
        from spikedeploy.make_env import parse_options

        for text in self.set_ or ():
            if (name := text.partition("=")[0]) in ("success", "disturb"):
                raise ConfigError(
                    f"--set {text}: {name} is given with --{name}. An argument of this name of an "
                    "environment is set in a function of yours, named as module:function."
                )
        return parse_options(self.set_ or (), self.disturb or (), self.success)


@dataclass(frozen=True)
class Damaged:
    """Options for faults of the chip."""

    fault: list[str] | None = None
    specimen: int = 0

    def faults(self) -> "Faults":
        """The faults, parsed."""
        from spikedeploy.runtime.faults import faults

        return faults(self.fault or (), self.specimen)
