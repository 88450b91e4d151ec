"""Requests such as `dead-neurons:2` or `lost-spikes=0.03`, read.

The grammar is that of envs.disturbances; neither package may import the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import FAULTS
from spikedeploy.runtime.faults.fault import Fault

LEVELS = (1, 2, 3)


def fault(name: str) -> Fault:
    """The fault of this name, imported now."""
    module, _, attribute = FAULTS[name].partition(":")
    found: Fault = getattr(import_module(module), attribute)
    return found


@dataclass(frozen=True)
class FaultRequest:
    """A fault as it was asked for.

    name: key of FAULTS.
    number: of its unit.
    text: as the command line takes it.
    """

    name: str
    number: float
    text: str


@dataclass(frozen=True)
class Faults:
    """All faults of a chip.

    each: in the order in which they were asked for.
    specimen: which chip of its kind it is: it decides which parts are hit.
    """

    each: tuple[FaultRequest, ...] = ()
    specimen: int = 0

    def __bool__(self) -> bool:
        return bool(self.each)


NONE = Faults()


def faults(texts: Sequence[str], specimen: int = 0) -> Faults:
    """The requests `name:level` and `name=number`, read; those of level 0 are left out."""
    found = [_read(text) for text in texts]
    names = [each.name for each in found]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ConfigError(f"--fault {twice[0]} is given twice: give each once")
    return Faults(tuple(each for each in found if each.number), specimen)


def _read(text: str) -> FaultRequest:
    mark = ":" if ":" in text else "="
    name, found, given = text.partition(mark)
    if not found:
        raise ConfigError(
            f"--fault takes name:level or name=number, as in dead-neurons:2; got {text!r}"
        )
    if name not in FAULTS:
        raise ConfigError(f"--fault {text}: no fault {name!r}; known: {', '.join(FAULTS)}")
    kind = fault(name)
    if mark == ":":
        if given not in ("0", *map(str, LEVELS)):
            raise ConfigError(
                f"--fault {text}: {given!r} is no level from 0 to {LEVELS[-1]}; a number is "
                f"written {name}={given}"
            )
        return FaultRequest(name, (0.0, *kind.levels)[int(given)], text)
    return FaultRequest(name, _number(text, given, kind), text)


def _number(text: str, given: str, of: Fault) -> float:
    lowest, highest = of.bounds
    try:
        number = float(given)
    except ValueError:
        number = float("nan")
    if not lowest <= number <= highest:
        raise ConfigError(
            f"--fault {text}: {given!r} is not a number from {lowest:g} to {highest:g} [{of.unit}]"
        )
    return number
