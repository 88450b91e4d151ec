"""Settings of an evaluation, which commands, reports, cards and sweeps share.

A group of options is a dataclass of this file or of a command: its fields are options of the
command line, its docstring their help (`spikedeploy.commands.options`), and pydantic reads it from
JSON.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from spikedeploy.runtime.choices import (
    BackendName,
    Floor,
    Granularity,
    Integrator,
    Reset,
    Rounding,
    SpikeCondition,
    State,
)
from spikedeploy.runtime.errors import ConfigError

if TYPE_CHECKING:
    from spikedeploy.runtime.chips.quantisation import Quantisation
    from spikedeploy.runtime.faults import Faults

Switch = Literal["on", "off"]
Count = Annotated[int, typer.Option(min=1)]
Natural = Annotated[int, typer.Option(min=0)]
_REDUCTIONS = ("mean", "last", "max")  # of comparison.episode_metrics
_OWN_OPTIONS = ("success", "disturb")  # of environments, which --set does not take


def changed(group: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return the fields of a group of options that are not as by default."""
    default = type(group)()
    found = {f.name: getattr(group, f.name) for f in fields(group)}
    return {name: value for name, value in found.items() if value != getattr(default, name)}


@dataclass(frozen=True)
class Reading:
    """What NIR leaves open; options take precedence over the file.

    How FILE is read:
        dt: timestep [s] (default: from the file)
        reset: membrane after a spike: v_reset, or less that distance, at once or in the next
            timestep; docs/other-tools.md has the equations (default: from the file)
        integrator: decays: 1 - dt/tau, or exp(-dt/tau) (default: from the file)
        delay: timesteps between layers (default: from the file)
        spikes: one above the threshold, one when it is reached, or as many as fit (default: from
            the file)
        floor: lowest membrane: none, 0, or -threshold (default: from the file)
        state: states at the next inference (default: from the file)
        like: read the file as the import of lava, nengo, norse, rockpool, sinabs, snntorch or
            spikingjelly does
        from_: read the file as its author meant it, who exported it from snntorch, norse,
            spikingjelly, sinabs, rockpool or lava
    """

    dt: float | None = None
    reset: Reset | None = None
    integrator: Integrator | None = None
    delay: Annotated[int, typer.Option(min=0, max=1)] | None = None
    spikes: SpikeCondition | None = None
    floor: Floor | None = None
    state: State | None = None
    like: Annotated[str, typer.Option(metavar="TOOL")] | None = None
    from_: Annotated[str, typer.Option(metavar="TOOL")] | None = None

    def arguments(self) -> dict[str, Any]:
        """Return arguments of `artifact.load`."""
        return {"written_by" if n == "from_" else n: value for n, value in vars(self).items()}


@dataclass(frozen=True)
class OnChip:
    """How a network is put on an emulated chip.

    The emulated chip:
        limits: refuse what breaks a design rule of the chip; 'off' emulates its arithmetic alone
        quantise: one scale for a layer, or for each neuron
        rounding: rounding of weights, thresholds and decays (default: the chip's own)
        weight_shift: bits that a Xylo shifts weights to the left
    """

    limits: Switch = "on"
    quantise: Granularity = "layer"
    rounding: Rounding | None = None
    weight_shift: Natural = 0

    def __post_init__(self) -> None:
        if self.limits not in get_args(Switch):  # such as True, which would be no "on"
            raise ConfigError(f"limits {self.limits!r} is unknown. Choose 'on' or 'off'.")

    @property
    def quantisation(self) -> "Quantisation":
        """How a float network becomes integers of the chip."""
        from spikedeploy.runtime.chips.quantisation import Quantisation

        return Quantisation(self.quantise, self.rounding, weight_shift=self.weight_shift)

    def arguments(self) -> dict[str, Any]:
        """Return arguments of a compiler: quantisation, and whether rules are enforced."""
        return {"limits": self.limits == "on", "quantisation": self.quantisation}

    def words(self) -> list[str]:
        """Return the options that are not as by default, as on the command line."""
        found = []
        for name, value in changed(self).items():
            for each in value if isinstance(value, tuple) else (value,):
                found += [
                    f"--{name.strip('_').replace('_', '-')}",
                    *[str(each)] * (each is not True),
                ]
        return found

    def as_json(self) -> dict[str, Any]:
        """Return the fields that are not as by default, as JSON has them."""
        return {n: list(v) if isinstance(v, tuple) else v for n, v in changed(self).items()}


@dataclass(frozen=True)
class Setup(OnChip):
    """Settings of an evaluation: the environment, the chip and its faults, what is measured.

    energy: energy table to price by, may be repeated; `energy` lists them (default: the chip's own)
    sampled: draw actions by their probability, not the likeliest

    The environment:
        set_: option of the environment: --set track=small_S
        success: key of the step infos that says success, of an environment that is not ours
            (default: its registered reward threshold, else success or is_success)
        metric: a number of the step infos as a column, as in x_velocity:mean, may be repeated
        disturb: disturbance of the world at level 1 to 3, or NAME=NUMBER, may be repeated;
            docs/robustness.md lists them

    The emulated chip:
        fault: fault of the chip at level 1 to 3, or NAME=NUMBER, may be repeated;
            docs/robustness.md lists them
        specimen: which faulty chip: decides which parts --fault hits
        backend: what computes a chip; numba needs the extra fast
    """

    energy: Annotated[tuple[str, ...], typer.Option(metavar="TABLE")] = ()
    sampled: bool = False
    set_: Annotated[tuple[str, ...], typer.Option(metavar="OPTION=VALUE")] = ()
    success: Annotated[str, typer.Option(metavar="KEY")] | None = None
    metric: Annotated[tuple[str, ...], typer.Option(metavar="NAME:mean|last|max")] = ()
    disturb: Annotated[tuple[str, ...], typer.Option(metavar="NAME:LEVEL")] = ()
    fault: Annotated[tuple[str, ...], typer.Option(metavar="NAME:LEVEL")] = ()
    specimen: Natural = 0
    backend: BackendName = "numpy"

    @classmethod
    def read(cls, data: object, source: object) -> "Setup":
        """Return the setup of JSON that `as_json` gave; ConfigError of `source` if it is none."""
        from spikedeploy.runtime.schema import validate

        if isinstance(data, dict) and (unknown := data.keys() - {f.name for f in fields(cls)}):
            raise ConfigError(f"{source}: setup has unknown settings {', '.join(sorted(unknown))}")
        return validate(cls, data, source)

    @classmethod
    def with_options(cls, options: Mapping[str, Any], **more: Any) -> "Setup":  # noqa: ANN401
        """Return the setup of an environment with options as `envs.make` takes them."""
        rest = {name: value for name, value in options.items() if name not in _OWN_OPTIONS}
        return cls(
            set_=tuple(option_texts(rest)),
            success=options.get("success"),
            disturb=tuple(options.get("disturb", ())),
            **more,
        )

    def options(self) -> dict[str, Any]:
        """Return options of the environment, as `envs.make` takes them."""
        for text in self.set_:
            if (name := text.partition("=")[0]) in _OWN_OPTIONS:
                raise ConfigError(
                    f"--set {text}: {name} is given with --{name}. An argument of this name of an "
                    "environment is set in a function of yours, named as module:function."
                )
        found = parse_options(self.set_)
        if self.success is not None:
            found["success"] = self.success
        return {**found, "disturb": list(self.disturb)} if self.disturb else found

    @cached_property
    def faults(self) -> "Faults":
        """Faults of the chip."""
        from spikedeploy.runtime.faults import NONE, faults

        return faults(self.fault, self.specimen) if self.fault else NONE

    def check(self) -> "Setup":
        """Return it; ConfigError for unknown options, energy tables, metrics and faults."""
        if self.energy:
            from spikedeploy.runtime.metrics.energy import checked_table_names

            checked_table_names(self.energy)
        check_metrics(self.metric)
        _ = self.options(), self.faults, self.quantisation
        return self


DEFAULT = Setup()


def check_metrics(texts: Iterable[str]) -> None:
    """Refuse texts that are not `name:mean|last|max`."""
    for text in texts:
        name, colon, reduction = text.rpartition(":")
        if not colon or not name or reduction not in _REDUCTIONS:
            raise ConfigError(
                f"--metric takes name:{'|'.join(_REDUCTIONS)}, the name of a number in the step "
                f"infos, as in x_velocity:mean; got {text!r}"
            )


def parse_options(texts: Iterable[str]) -> dict[str, Any]:
    """Return options of texts such as `track=small_S`; values are JSON, or else plain text.

    `lidar.noise=5` sets one of a group of options.
    """
    options: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        *groups, last = name.split(".")
        if not equals or not last or not all(groups):
            raise ConfigError(f"--set takes option=value, as in --set track=small_S; got {text!r}")
        place = options
        for group in groups:
            place = place.setdefault(group, {})
            if not isinstance(place, dict):
                raise ConfigError(f"--set {text}: {group!r} was given as a whole already")
        try:
            place[last] = json.loads(value)
        except ValueError:
            place[last] = value
    return options


def option_texts(options: Mapping[str, Any]) -> list[str]:
    """Return the texts of which `parse_options` makes these options: nested, or with dots."""
    found = []
    for name, value in options.items():
        if isinstance(value, Mapping) and value:
            found += [f"{name}.{text}" for text in option_texts(value)]
        else:
            found.append(f"{name}={json.dumps(value, default=_plain)}")
    return found


def _plain(value: Any) -> object:  # noqa: ANN401
    """Return a number, an array of NumPy or a path as JSON has them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise ConfigError(
        f"a setting is a {type(value).__name__}, {value!r}; it is text, a number, a list or a dict"
    )
