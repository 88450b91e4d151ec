"""The datasheet of a chip, and its options: fields that are replaced by other values."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import Field, dataclass, field, fields, replace
from importlib import import_module
from typing import Any, Literal, get_args, get_origin

from spikedeploy.runtime.chips import CHIPS
from spikedeploy.runtime.chips.arithmetic import Arithmetic
from spikedeploy.runtime.chips.limits import Limits
from spikedeploy.runtime.chips.registers import OVERFLOWS, Register
from spikedeploy.runtime.convention import CLOCKS, Clock
from spikedeploy.runtime.errors import ChipError

__all__ = ["CHIPS", "Chip", "chip"]

# of chips whose neurons all update in each timestep
ALL_AT_ONCE: tuple[Clock, ...] = ("pipelined", "free")

# how a membrane leaves a chip: read by the host from its register, sent as a graded spike, or put
# out by a program; "none" leaves neurons that do not spike to the host
MembraneOutput = Literal["none", "probe", "graded", "software"]


@dataclass(frozen=True)
class Chip:
    """Everything about a chip that decides what a network does on it.

    name: as in the table CHIPS.
    summary: one line.
    arithmetic: what its numbers are and how they are added up.
    resets: what a spike may do to the membrane, as in Convention.
    delay: [timesteps] from a spike to its arrival in the next layer; 0 leaves it to the
        convention.
    delay_max: [timesteps] longest delay that a synapse can add up to.
    energy_tables: names of the tables in runtime.metrics.energy that price its events.
    sources: field name to where its value comes from and how sure it is.
    evidence: what its emulation was compared with, and what came out.
    limits: what fits on it, with sources of their own; None where nothing limits it.
    membrane_output: how membranes of neurons that do not spike leave it; "none" where no way is
        published, and the host integrates their input then. "none" can be chosen on every chip.
    clocks: how it can advance the layers of a network, its own way first (runtime.convention.Clock,
        and "free": all neurons update in each of its timesteps, and a network that has no delays
        takes as many more of them as it is deep). Others are emulated too, and called assumptions.
    clock: the one to run networks by; None is the network's own where the chip has it, else free.
    """

    name: str
    summary: str
    arithmetic: Arithmetic
    resets: tuple[str, ...]
    delay: int
    delay_max: int
    energy_tables: tuple[str, ...]
    sources: Mapping[str, str] = field(compare=False)
    evidence: str = field(default="compared with nothing", compare=False)
    limits: Limits | None = None
    membrane_output: MembraneOutput = "none"
    clocks: tuple[Clock, ...] = CLOCKS
    clock: Clock | None = None

    def __post_init__(self) -> None:
        if self.membrane_output not in get_args(MembraneOutput):
            raise ChipError(
                f"chip {self.name!r}: membrane_output {self.membrane_output!r} is unknown. Choose "
                f"one of {', '.join(map(repr, get_args(MembraneOutput)))}."
            )
        if self.delay < 0:
            raise ChipError(
                f"chip {self.name!r}: delay {self.delay}: no spike arrives before it was sent. "
                "Choose 0 or more timesteps."
            )
        if self.clock not in (None, *CLOCKS):
            raise ChipError(
                f"chip {self.name!r}: clock {self.clock!r} is unknown. Choose one of "
                f"{', '.join(map(repr, CLOCKS))}."
            )

    @property
    def spikes_max(self) -> int:
        """Spikes of a neuron in a timestep."""
        return self.arithmetic.spikes_max

    @property
    def input_spikes_max(self) -> int:
        """Spikes of an input channel in a timestep."""
        return self.arithmetic.input_spikes_max


def chip(name: str, **overrides: Any) -> Chip:  # noqa: ANN401
    """The chip called `name`, with some fields of it or of its arithmetic replaced.

    They may also stand in the name, as on a command line: "int:weight_bits=4,membrane=12". Where a
    register is given as a number, that is its bits; "12-wrap" says what overflows do too.
    """
    name, _, options = name.partition(":")
    if name not in CHIPS:
        raise ChipError(
            f"there is no chip {name!r}{_like(name, CHIPS)}. Known: {', '.join(CHIPS)}."
        )
    module, attribute = CHIPS[name].split(":")
    datasheet: Chip = getattr(import_module(module), attribute)
    return _overridden(datasheet, {**_spelled(datasheet, options), **overrides})


# not for a line of text: they are made of other things, or say what is known of the chip
_WHOLE = ("name", "arithmetic", "sources", "clocks")


def _overridden(datasheet: "Chip", overrides: Mapping[str, Any]) -> "Chip":
    """The datasheet with these fields of it, or of its arithmetic, replaced."""
    arithmetic = datasheet.arithmetic
    own = {f.name for f in fields(datasheet)}
    inside = {f.name for f in fields(arithmetic)}
    for key in overrides:
        _field(datasheet, key)
    inner = {k: _filled(arithmetic, k, v) for k, v in overrides.items() if k in inside}
    outer = {k: v for k, v in overrides.items() if k in own and k not in inside}
    return replace(datasheet, **{"arithmetic": replace(arithmetic, **inner), **outer})


def _spelled(datasheet: "Chip", text: str) -> dict[str, Any]:
    """The options in a text like "weight_bits=4,membrane=12-wrap"."""
    options: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        key, given, value = part.partition("=")
        key, value = key.strip(), value.strip()
        if not (given and value):
            example = CLOCKS[0] if key == "clock" else 4
            raise ChipError(
                f"chip {datasheet.name!r}: option {part!r} has no value. Write it as "
                f"{datasheet.name}:{key or 'weight_bits'}={example}, with commas between options."
            )
        if key in options:
            raise ChipError(
                f"chip {datasheet.name!r}: option {key!r} is given twice. Leave one of them out."
            )
        options[key] = _read(datasheet, _field(datasheet, key), value)
    return options


def listed(text: str) -> list[str]:
    """The chips in a text like "loihi1,int:weight_bits=4,membrane=12,odin", options included."""
    names: list[str] = []
    for part in filter(None, (part.strip() for part in text.split(","))):
        # an option without a chip before it belongs to the chip before the comma
        if names and "=" in part and ":" not in part:
            names[-1] += f",{part}"
        else:
            names.append(part)
    return names


def _like(name: str, known: Iterable[str]) -> str:
    """A hint at what may have been meant."""
    close = difflib.get_close_matches(name, list(known), n=2)
    return f"; did you mean {' or '.join(map(repr, close))}" if close else ""


def _field(datasheet: "Chip", key: str) -> "Field[Any]":
    every = (*fields(datasheet), *fields(datasheet.arithmetic))
    known = {f.name: f for f in every if f.init}
    if key not in known:
        raise ChipError(f"chip {datasheet.name!r} has no option {key!r}{_like(key, known)}.")
    return known[key]


def _filled(arithmetic: Arithmetic, key: str, value: Any) -> Any:  # noqa: ANN401
    """The value of a field, where a number means the bits of the register that is there."""
    present = getattr(arithmetic, key)
    if isinstance(present, Register) and isinstance(value, int):
        return replace(present, bits=value)
    return value


def _read(datasheet: "Chip", field: "Field[Any]", text: str) -> Any:  # noqa: ANN401
    """The value of a field in a text, by the field's type."""
    kind: Any = field.type
    if field.name in _WHOLE:
        raise ChipError(f"chip {datasheet.name!r}: {field.name!r} cannot be given as text.")
    if kind is Register:
        return _register(datasheet, field.name, text)
    if field.name == "clock":
        return text
    if type(None) in get_args(kind):
        return None if text == "none" else _whole(datasheet, field.name, text)
    if get_origin(kind) is tuple:
        parts = text.split("/")
        numeric = get_args(kind)[0] is int
        return tuple(_whole(datasheet, field.name, p) for p in parts) if numeric else tuple(parts)
    return _whole(datasheet, field.name, text) if kind is int else text


def _register(datasheet: "Chip", key: str, text: str) -> Register:
    present: Register = getattr(datasheet.arithmetic, key)
    bits, _, overflow = text.partition("-")
    if overflow and overflow not in OVERFLOWS:
        raise ChipError(
            f"chip {datasheet.name!r}: {key} {text!r} overflows in an unknown way. Write its bits, "
            f"and after a '-' one of {', '.join(OVERFLOWS)}: {key}={present.bits}-saturate."
        )
    return Register(_whole(datasheet, key, bits), overflow or present.overflow, present.between)


def _whole(datasheet: "Chip", key: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ChipError(
            f"chip {datasheet.name!r}: {key} must be a whole number, found {text!r}."
        ) from None
