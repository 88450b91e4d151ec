"""The datasheet of a chip: its fields, the limits of what fits on it, its file, and its options.

A datasheet is a file in TOML. Of each field of the chip and of its arithmetic, and of each limit,
it has the value and the source, which says how certain the value is: run, read, secondary, derived,
assumed, or by definition.

    summary = "4-bit weights, 16-bit membranes"
    evidence = "compared with nothing"           what the emulation was compared with
    arithmetic = "cuba-free-width"               one of ARITHMETICS

    [like]                                       leave out what is as in another datasheet
    chip = "int"
    source = "{source}; taken from int"          what is then said of the values taken from there

    [references]                                 stands for {RTL} in sources
    RTL = "RTL of July (read)"

    [fields]                                     of Chip and of the arithmetic
    membrane = { value = "16-saturate", source = "{RTL}: 16 bits" }

    [limits]                                     of Limits
    neurons = { value = 1024, source = "assumed" }

A register is its bits and what it does when it is full; "none" is None.
"""

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, cast, get_args, get_origin

import numpy as np

from spikedeploy.runtime.chips import ARITHMETICS, CHIPS
from spikedeploy.runtime.chips.arithmetic import Arithmetic
from spikedeploy.runtime.chips.registers import OVERFLOWS, Register
from spikedeploy.runtime.convention import CLOCKS, Clock
from spikedeploy.runtime.errors import ChipError
from spikedeploy.runtime.files import MOST_TOML, read_toml, suffix

__all__ = ["CHIPS", "Chip", "chip"]

# how a membrane leaves a chip: read by the host from its register, sent as a graded spike, or put
# out by a program; "none" leaves neurons that do not spike to the host
MembraneOutput = Literal["none", "probe", "graded", "software"]
Cost = Literal["words", "bits"]

# neurons without a threshold, whose membranes leave the chip
READOUTS = ("LI", "CubaLI", "I")


@dataclass(frozen=True)
class SynapticMemory:
    """The memory of a core that holds the synapses of its neurons.

    size: of a core [bit].
    cost: "words" packs up to 64 synapses of an axon into 64-bit words, as Loihi does; "bits" takes
        weight_bits a synapse and nothing else, which is the least that it can be.
    weight_bits: of a stored weight; 0 in a datasheet for those of the arithmetic.
    """

    size: int
    cost: Cost
    weight_bits: int = 0


@dataclass(frozen=True)
class LayerCore:
    """A core that computes one layer by itself.

    kernel: entries of its kernel memory.
    neurons: entries of its neuron memory.
    """

    kernel: int
    neurons: int


@dataclass(frozen=True)
class Convolutions:
    """Layers that a core which computes one can take.

    kernel: largest extent of a kernel.
    strides: possible.
    padding: most zeros on a side.
    pools: possible extents of the sum pool behind the neurons.
    channels: most features.
    source: largest extent of the network's input.
    extent: largest of what a layer puts out.
    """

    kernel: int
    strides: tuple[int, ...]
    padding: int
    pools: tuple[int, ...]
    channels: int
    source: int
    extent: int


@dataclass(frozen=True)
class Limits:
    """Limits of what fits on a chip; None, or an empty value, where no limit is published.

    primitives: names of the NIR nodes that the chip has, maps without a state included.
    inputs: input channels of the chip.
    neurons: of the chip; besides the outputs where those are limited by themselves.
    outputs: neurons whose spikes leave the chip.
    fan_in: synapses of a neuron.
    fan_out: synapses that a spike can reach in the neurons of the chip, outputs not counted where
        those are limited by themselves.
    fan_out_mean: mean of these over the chip's neurons.
    input_targets: neurons that can have synapses from inputs.
    output_sources: neurons that can have synapses onto outputs.
    destinations: postsynaptic layers that a layer can have.
    cores: of a chip.
    neurons_per_core: of one core; larger layers are divided.
    memory: synaptic memory of a core.
    axons_in: different presynaptic sources of a core.
    axons_out: pairs of a neuron in a core and a core with postsynaptic neurons.
    decays: different pairs of decays in a core.
    thresholds: different thresholds in a core.
    layer_cores: where each layer takes a core of its own: what those hold.
    convolutions: what such a layer can be.
    axon_signs: whether a source excites all that it reaches, or inhibits all.
    weight_values: different weights of a neuron, besides 0; None where each synapse has its own.
    weight_max: largest mantissa of a weight; at most what the arithmetic's width holds.
    threshold_max: largest threshold, in the unit of weight_max; at most what its register holds.
    current_loss: least and most that a synaptic current may lose in one timestep, of 1.
    membrane_loss: likewise of a membrane.
    recurrence: whether neurons can project to themselves, over however many others.
    input_cores: whether inputs and the always-on axon of biases start in neurons of the chip.
    alone: whether a network must fit on one chip.
    sources: field to where its value comes from and how sure it is.
    """

    primitives: tuple[str, ...]
    sources: Mapping[str, str] = field(compare=False)
    inputs: int | None = None
    neurons: int | None = None
    outputs: int | None = None
    fan_in: int | None = None
    fan_out: int | None = None
    fan_out_mean: int | None = None
    input_targets: int | None = None
    output_sources: int | None = None
    destinations: int | None = None
    cores: int | None = None
    neurons_per_core: int | None = None
    memory: SynapticMemory | None = None
    axons_in: int | None = None
    axons_out: int | None = None
    decays: int | None = None
    thresholds: int | None = None
    layer_cores: tuple[LayerCore, ...] = ()
    convolutions: Convolutions | None = None
    axon_signs: bool = False
    weight_values: int | None = None
    weight_max: int | None = None
    threshold_max: int | None = None
    current_loss: tuple[float, float] | None = None
    membrane_loss: tuple[float, float] | None = None
    recurrence: bool | None = None
    input_cores: bool = False
    alone: bool = True


@dataclass(frozen=True)
class Chip:
    """Everything about a chip that decides what a network does on it.

    name: as in the table CHIPS, or of its file.
    summary: one line.
    arithmetic: what its numbers are and how they are added up.
    resets: what a spike may do to the membrane, as in Convention.
    delay: [timesteps] from a spike to its arrival in the next layer; 0 leaves it to the
        convention.
    delay_max: [timesteps] longest delay that a synapse can add up to.
    energy_tables: names of the tables in runtime.metrics.energy_tables that price its events.
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
        if self.delay < 0:
            raise ChipError(
                f"delay {self.delay}: no spike arrives before it was sent. Choose 0 or more "
                "timesteps."
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

    A name that ends in .toml is the file of a datasheet. Fields may also be replaced in the name,
    as on a command line: "int:weight_bits=4,membrane=12". Where a register is given as a number,
    that is its bits; "12-wrap" says what overflows do too.
    """
    place, options = _NAME.fullmatch(name.strip()).groups("")  # type: ignore[union-attr]  # any text
    if place in CHIPS:
        path, called = CHIPS[place], place
    elif suffix(place) == _FILE:
        path, called = Path(place), Path(place).stem
        if called in CHIPS:
            raise ChipError(f"{path}: {called!r} is the name of another chip. Rename the file.")
    else:
        raise ChipError(
            f"there is no chip {place!r}{_suggest(place, CHIPS)}. Known: {', '.join(CHIPS)}; or "
            "name a datasheet, which ends in .toml."
        )
    try:
        datasheet = _load(path, called, path.stat().st_mtime_ns)
    except OSError as error:
        raise ChipError(
            f"chip {place!r}: its datasheet cannot be read ({error.strerror}). Name another file."
        ) from error
    try:
        return _override(datasheet, {**_parse_options(datasheet, options), **overrides})
    except ChipError as error:
        raise ChipError(f"chip {called!r}: {error}") from None


def split_names(text: str) -> list[str]:
    """The chips in a text like "loihi1,int:weight_bits=4,membrane=12,odin", options included."""
    names: list[str] = []
    for part in filter(None, (part.strip() for part in text.split(","))):
        # an option without a chip before it belongs to the chip before the comma
        if names and "=" in part and ":" not in part:
            names[-1] += f",{part}"
        else:
            names.append(part)
    return names


_FILE = ".toml"
# a name, or a file, which may have a colon in its path; then options
_NAME = re.compile(r"(.*?\.(?i:toml)(?=:|$)|[^:]*):?(.*)", re.DOTALL)


# options


# not for a line of text: they are made of other things, or say what is known of the chip
_NO_TEXT = ("name", "arithmetic", "sources", "clocks", "limits")


def _override(datasheet: Chip, overrides: Mapping[str, Any]) -> Chip:
    """The datasheet with these fields of it, or of its arithmetic, replaced."""
    arithmetic = datasheet.arithmetic
    inner: dict[str, Any] = {}
    outer: dict[str, Any] = {}
    for key, value in overrides.items():
        wanted = _find_field(datasheet, key)
        inside = any(each is wanted for each in fields(arithmetic))
        present = getattr(arithmetic if inside else datasheet, key)
        (inner if inside else outer)[key] = _convert(wanted.type, key, value, present)
    if inner:
        arithmetic = _build(replace, arithmetic, **inner)
        if datasheet.limits:
            limits = _with_widths(datasheet.limits, arithmetic, datasheet.arithmetic)
            outer = {"limits": limits, **outer}
    return cast("Chip", _build(replace, datasheet, **{"arithmetic": arithmetic, **outer}))


def _with_widths(limits: Limits, arithmetic: Arithmetic, before: Arithmetic) -> Limits:
    """The limits with registers of other widths: those that filled the former fill the new ones.

    No weight or threshold is larger than its register, whatever the datasheet says.
    """

    def fitted(stated: int | None, then: int, now: int) -> int | None:
        return stated if stated is None else now if stated == then else min(stated, now)

    memory = limits.memory
    if memory and memory.weight_bits in (0, before.weight_bits):
        memory = replace(memory, weight_bits=arithmetic.weight_bits)
    highest = [_largest_threshold(each) for each in (before, arithmetic)]
    return replace(
        limits,
        weight_max=fitted(limits.weight_max, before.weight_max, arithmetic.weight_max),
        threshold_max=fitted(limits.threshold_max, *highest),
        memory=memory,
    )


def _largest_threshold(arithmetic: Arithmetic) -> int:
    """The largest threshold, in the unit of weights."""
    return arithmetic.threshold_range[1] >> int(getattr(arithmetic, "mantissa_shift", 0))


def _find_field(datasheet: Chip, key: str) -> "Field[Any]":
    every = (*fields(datasheet), *fields(datasheet.arithmetic))
    known = {f.name: f for f in every if f.init}
    if key not in known:
        raise ChipError(f"it has no option {key!r}{_suggest(key, known)}.")
    return known[key]


def _parse_options(datasheet: Chip, text: str) -> dict[str, Any]:
    """The options in a text like "weight_bits=4,membrane=12-wrap"."""
    options: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        key, given, value = (each.strip() for each in part.partition("="))
        if not (given and value):
            example = CLOCKS[0] if key == "clock" else 4
            raise ChipError(
                f"option {part!r} has no value. Write it as "
                f"{datasheet.name}:{key or 'weight_bits'}={example}, with commas between options."
            )
        if key in options:
            raise ChipError(f"option {key!r} is given twice. Leave one of them out.")
        if _find_field(datasheet, key).name in _NO_TEXT:
            raise ChipError(f"{key!r} cannot be given as text.")
        members = [int(each) if _WHOLE.fullmatch(each) else each for each in value.split("/")]
        options[key] = members if len(members) > 1 else members[0]
    return options


# files


_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
_LARGEST = 1 << 62
_TABLES: dict[str, type] = {
    "summary": str,
    "evidence": str,
    "arithmetic": str,
    "energy_tables": list,
    "like": dict,
    "references": dict,
    "fields": dict,
    "limits": dict,
}
_LIKE = ("chip", "source", "limits")


@lru_cache(maxsize=64)
def _load(path: Path, name: str, changed: int) -> Chip:
    """The chip of a datasheet's file, read again when the file has changed."""
    try:
        return _make_chip(name, _read_tables(path))
    except ChipError as error:
        raise ChipError(f"{path}: {error}") from None


def _make_chip(name: str, tables: Mapping[str, Any]) -> Chip:
    """The chip that the tables of a file describe."""
    entries, limits = tables.get("fields", {}), tables.get("limits", {})
    if (arithmetic := tables.get("arithmetic", "")) not in ARITHMETICS:
        raise ChipError(
            f"arithmetic {arithmetic!r} is unknown{_suggest(arithmetic, ARITHMETICS)}. Choose one "
            f"of {', '.join(ARITHMETICS)}."
        )
    module, _, attribute = ARITHMETICS[arithmetic].partition(":")
    family = getattr(import_module(module), attribute)
    known = {each.name for each in (*fields(Chip), *fields(family))} - {"name", *_TABLES, "sources"}
    _check_names("field", entries, known | {"arithmetic"})
    _check_names("limit", limits, {each.name for each in fields(Limits)} - {"sources"})
    sources = _sources(entries, tables)
    rest = {
        "name": name,
        "summary": tables.get("summary", ""),
        "evidence": tables.get("evidence", "compared with nothing"),
        "arithmetic": (built := _build(family, **_convert_entries(family, entries))),
        "energy_tables": tuple(map(str, tables.get("energy_tables", ()))),
        "sources": sources,
        "limits": None,
    }
    if limits:
        found = _convert_entries(Limits, limits, sources=_sources(limits, tables))
        rest["limits"] = _with_widths(_build(Limits, **found), built, built)
    return cast("Chip", _build(Chip, **_convert_entries(Chip, entries, **rest)))


def _read_tables(path: Path) -> dict[str, Any]:
    """Tables of a file, over those of the datasheet that it is like."""
    if path.stat().st_size > MOST_TOML:
        raise ChipError(f"it has more than {MOST_TOML} bytes, which no datasheet needs.")
    try:
        tables = read_toml(path)
    except (ValueError, RecursionError) as error:
        raise ChipError(f"invalid TOML ({error}). Correct that line.") from None
    _check_tables(tables)
    like: dict[str, str] = tables.pop("like", {})
    if not like:
        return tables
    _check_names("entry of like", like, _LIKE)
    other = like.get("chip", "")
    if CHIPS.get(other) in (None, path):
        raise ChipError(f"like.chip is {other!r}{_suggest(other, CHIPS)}. Name one of the chips.")
    base = _read_tables(CHIPS[other])
    references = base.get("references", {}) | tables.get("references", {})
    of_fields = _inherit(base, tables, "fields", like.get("source", "{source}"))
    of_limits = _inherit(base, tables, "limits", like.get("limits", "{source}"))
    return {**base, **tables, "references": references, "fields": of_fields, "limits": of_limits}


def _inherit(
    base: Mapping[str, Any], tables: Mapping[str, Any], table: str, source: str
) -> dict[str, Any]:
    """Entries of a chip over those of the one that it is like, with what is said of these."""
    taken = {
        name: {**entry, "source": source.replace("{source}", entry["source"])}
        for name, entry in base.get(table, {}).items()
    }
    own = tables.get(table, {})
    return taken | {name: {**taken.get(name, {}), **entry} for name, entry in own.items()}


def _check_tables(tables: Mapping[str, Any]) -> None:
    """Refuse unknown tables, and entries of fields and limits without a source."""
    _check_names("table", tables, _TABLES)
    for name, table in tables.items():
        if not isinstance(table, _TABLES[name]):
            raise ChipError(f"{name} is {table!r:.40}; it must be a {_TABLES[name].__name__}.")
    for name, entry in (*tables.get("fields", {}).items(), *tables.get("limits", {}).items()):
        if not isinstance(entry, dict) or not isinstance(entry.get("source"), str):
            raise ChipError(
                f'{name} has no source. Write {name} = {{ value = 8, source = "where the value '
                'comes from, or assumed" }.'
            )
        _check_names(f"part of {name}", entry, ("value", "source"))
    texts = (*tables.get("references", {}).items(), *tables.get("like", {}).items())
    if wrong := [name for name, text in texts if not isinstance(text, str)]:
        raise ChipError(f"{wrong[0]} is no text.")


def _sources(entries: Mapping[str, Any], tables: Mapping[str, Any]) -> dict[str, str]:
    """Entry -> the source of its value, with its references written out."""
    references = tables.get("references", {})

    def written_out(match: "re.Match[str]") -> str:
        if match[1] not in references:
            raise ChipError(f"a source names {match[0]}, which is not among its references.")
        return _REFERENCE.sub(written_out, references[match[1]])

    try:
        return {name: _REFERENCE.sub(written_out, e["source"]) for name, e in entries.items()}
    except RecursionError:
        raise ChipError("its references name one another in a circle.") from None


_REFERENCE = re.compile(r"\{(\w+)\}")


def _convert_entries(kind: Any, entries: Mapping[str, Any], **given: Any) -> dict[str, Any]:  # noqa: ANN401
    """Values of entries, by the types of the fields of a dataclass, beside those given."""
    values = dict(given)
    for each in fields(kind):
        if each.name in given or not each.init:
            continue
        if "value" in (entry := entries.get(each.name, {})):
            values[each.name] = _convert(each.type, each.name, entry["value"])
        elif each.default is MISSING and each.default_factory is MISSING:
            raise ChipError(f"{each.name} has no value. Write it with its source.")
    return values


def _build(make: Any, *of: Any, **values: Any) -> Any:  # noqa: ANN401
    """Build an object of these values; ChipError where they are inconsistent."""
    try:
        return make(*of, **values)
    except (ArithmeticError, ValueError) as error:
        if isinstance(error, ChipError):
            raise
        raise ChipError(f"its values are inconsistent ({error}).") from None


def _convert(kind: Any, name: str, value: Any, present: Any = None) -> Any:  # noqa: ANN401
    """The value of a field in a file, a text or from Python, by the field's type.

    present: the value now, for a register of which only the bits are given.
    """
    members = get_args(kind)
    if type(None) in members:
        kind = next(each for each in members if each is not type(None))
        return None if value in (None, "none") else _convert(kind, name, value, present)
    if kind is Register:
        return _register(name, value, present)
    if get_origin(kind) is tuple:
        each = value if isinstance(value, list | tuple) else [value]
        return tuple(_convert(members[0], name, member) for member in each)
    if get_origin(kind) is Literal:
        if value not in members:
            choices = " or ".join(map(repr, members))
            if len(members) > 2:
                choices = f"one of {', '.join(map(repr, members))}"
            raise ChipError(f"{name} {value!r} is unknown. Choose {choices}.")
        return value
    if isinstance(value, dict) and is_dataclass(kind):
        _check_names(f"part of {name}", value, [each.name for each in fields(kind)])
        return _build(
            kind, **_convert_entries(kind, {part: {"value": v} for part, v in value.items()})
        )
    if kind is int and (isinstance(value, bool) or not isinstance(value, int | np.integer)):
        raise ChipError(f"{name} must be a whole number, found {value!r}.")
    if kind is int and abs(value) > _LARGEST:
        raise ChipError(f"{name} is {value}; no register is that wide.")
    if (kind is float and not isinstance(value, float | int)) or (
        kind in (bool, str) and not isinstance(value, kind)
    ):
        raise ChipError(f"{name} must be a {kind.__name__}, found {value!r:.40}.")
    return value


def _register(name: str, value: Any, present: Register | None) -> Register:  # noqa: ANN401
    """A register from one, from its bits, or from a text like "12-wrap"."""
    if isinstance(value, Register):
        return value
    bits, _, overflow = str(value).partition("-")
    if present is not None and not overflow:
        overflow = present.overflow
    if overflow not in OVERFLOWS:
        raise ChipError(
            f"{name} {value!r} overflows in an unknown way. Write its bits, and after a '-' one of "
            f"{', '.join(OVERFLOWS)}: {name}=24-saturate."
        )
    if not _WHOLE.fullmatch(bits):
        raise ChipError(f"{name} must be a whole number, found {bits!r}.")
    between = None if present is None else present.between
    return Register(int(bits), overflow, between)


def _check_names(what: str, found: Iterable[str], known: Iterable[str]) -> None:
    for name in found:
        if name not in known:
            raise ChipError(f"there is no {what} {name!r}{_suggest(name, known)}.")


def _suggest(name: str, known: Iterable[str]) -> str:
    """Suggest a similar name."""
    close = difflib.get_close_matches(name, list(known), n=2)
    return f"; did you mean {' or '.join(map(repr, close))}" if close else ""
