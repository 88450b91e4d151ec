"""Text of C: numbers and arrays of the narrowest types, and the templates that hold them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.rendering import environment
from spikedeploy.exporters.rendering import render as fill

_LINE = 96
# equal numbers in a row from which a table has one of them: a division takes longer than a byte
_RUN = 16
_BYTES = {f"{sign}int{bits}_t": bits // 8 for sign in ("", "u") for bits in (8, 16, 32, 64)}
_BYTES |= {"double": 8}


def bytes_of(kind: str) -> int:
    """Size of a number of this C type [bytes]."""
    return _BYTES[kind]


def narrowest(low: int, high: int) -> str:
    """The smallest integer type of C that holds both, unsigned where it can be."""
    signed = "u" if low >= 0 else ""
    for bits in (8, 16, 32, 64):
        least, most = (0, 2**bits - 1) if signed else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        if least <= low and high <= most:
            return f"{signed}int{bits}_t"
    raise OverflowError(f"no integer of C holds {low} to {high}")


def narrowest_of(values: NDArray[Any]) -> str:
    """The smallest integer type of C that holds all values."""
    return narrowest(int(values.min(initial=0)), int(values.max(initial=0)))


def literal(value: float, kind: str) -> str:
    """A number as a constant of a C type, exact."""
    if kind == "double":
        if np.isinf(value):
            return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
        return float(value).hex() if value not in (0, 1) else f"{value:.1f}"
    value = int(value)
    if kind == "int64_t":
        # the constant without its sign has to fit, too
        return f"INT64_C({value})" if value > -(2**63) else "INT64_MIN"
    if kind == "uint64_t":
        return f"UINT64_C({value})"
    if kind.startswith("u"):
        return f"{value}u"
    return str(value) if value > -(2**31) else "INT32_MIN"


@dataclass
class Declarations:
    """Constants and variables of a file, which its template declares where it uses them.

    types: bytes of the types that the header declares, by name.
    storage: words before a constant.
    lines: in their order.
    rom, ram: bytes of constants and of variables.
    names: of constants.
    """

    types: Mapping[str, int] = field(default_factory=dict)
    storage: str = "static const"
    lines: list[str] = field(default_factory=list)
    rom: int = 0
    ram: int = 0
    names: set[str] = field(default_factory=set)

    def constant(self, name: str, values: NDArray[Any], kind: str | None = None) -> str:
        """Declare a constant array unless it is, and return its name."""
        if name not in self.names:
            self.names.add(name)
            kind = kind or ("double" if values.dtype.kind == "f" else narrowest_of(values))
            self.lines.append(array(name, values, kind, self.storage))
            self.rom += bytes_of(kind) * values.size
        return name

    def variable(self, name: str, kind: str, *sizes: int) -> str:
        """Declare a variable, an array where it has sizes, and return its name."""
        self.lines.append(f"static {kind} {name}{''.join(f'[{size}]' for size in sizes)};")
        size = self.types[kind] if kind in self.types else bytes_of(kind)
        self.ram += size * int(np.prod(sizes, dtype=np.int64))
        return name

    def each(self, name: str, values: NDArray[Any], index: str, kind: str = "double") -> str:
        """Return C for the value at an index: a number where all have the same, else a table.

        The table of numbers that channels share has one for each channel.
        """
        if (values == values.flat[0]).all():
            return literal(values.flat[0], kind)
        changes = np.flatnonzero(np.diff(values)) + 1
        if (run := int(np.gcd.reduce(changes, initial=values.size))) >= _RUN:
            values, index = values[::run], f"{index} / {run}u"
        if kind == "double":
            return f"{self.constant(name, values.astype(np.float64))}[{index}]"
        # unsigned tables would turn comparisons with signed numbers into others
        low = int(values.min()) if kind.startswith("u") else min(int(values.min()), -1)
        return f"{self.constant(name, values, narrowest(low, int(values.max())))}[{index}]"

    @property
    def text(self) -> str:
        """The declarations as C."""
        return "\n".join(self.lines)


def array(name: str, values: NDArray[Any], kind: str, storage: str = "static const") -> str:
    """A constant array of C."""
    lines, line = [f"{storage} {kind} {name}[{values.size}] = {{"], "   "
    for value in values.ravel().tolist():
        item = f" {literal(value, kind)},"
        if len(line) + len(item) > _LINE:
            lines.append(line)
            line = "   "
        line += item
    return "\n".join([*lines, line, "};"])


def as_lists(weight: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any]]:
    """A matrix without its zeros: first entry of each row, and one more; columns; values."""
    rows, columns = np.nonzero(weight)
    first = np.searchsorted(rows, np.arange(len(weight) + 1))
    return first, columns, weight[rows, columns]


def render(template: str, **values: object) -> str:
    """The text of a template of `templates/`."""
    made = environment(str(__package__))
    made.filters |= {"c": literal, "plain": plain}
    functions = (narrowest, narrowest_of, as_lists, array)
    made.globals |= {function.__name__: function for function in functions}
    return fill(str(__package__), template, **values)


def plain(name: str) -> str:
    """A name of a graph, such as net/fc1, as it can stand in a comment, which it cannot end."""
    return re.sub(r"[^A-Za-z0-9_./-]", "?", name)[:60]
