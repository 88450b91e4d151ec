"""Arrays of C with the narrowest types, the memory that they take, and a chip's registers as C."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.registers import Register

_LINE = 96
_BYTES = {"int8_t": 1, "uint8_t": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4}
_WIDE = {"int64_t": 8, "uint64_t": 8, "double": 8}


def bytes_of(kind: str) -> int:
    """Size of a number of this C type [bytes]."""
    return {**_BYTES, **_WIDE}[kind]


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


def literal(value: int, kind: str) -> str:
    """A whole number as a constant of a C type."""
    if kind == "int64_t":
        # the constant without its sign has to fit, too
        return f"INT64_C({value})" if value > -(2**63) else "INT64_MIN"
    if kind == "uint64_t":
        return f"UINT64_C({value})"
    if kind.startswith("u"):
        return f"{value}u"
    return str(value) if value > -(2**31) else "INT32_MIN"


def number(value: float) -> str:
    """A float64 in C, exact."""
    if np.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return float(value).hex() if value not in (0, 1) else f"{value:.1f}"


@dataclass
class Declarations:
    """Constants and variables of a file, all of them static.

    int_bytes, id_bytes: sizes of the types that the header declares.
    lines: in their order.
    rom, ram: bytes of constants and of variables.
    names: of what is declared.
    """

    int_bytes: int = 4
    id_bytes: int = 2
    lines: list[str] = field(default_factory=list)
    names: set[str] = field(default_factory=set)
    rom: int = 0
    ram: int = 0

    def constant(self, name: str, values: NDArray[Any], kind: str | None = None) -> str:
        """Declare a constant array unless it is, and return its name."""
        if name in self.names:
            return name
        self.names.add(name)
        floats = values.dtype.kind == "f"
        kind = kind or ("double" if floats else narrowest_of(values))
        flat = values.ravel().tolist()
        items = [number(v) if floats else literal(v, kind) for v in flat]
        self.lines.append(f"static const {kind} {name}[{len(flat)}] = {{")
        self.lines += [*_wrap_lines(items), "};"]
        self.rom += bytes_of(kind) * len(flat)
        return name

    def variable(self, name: str, kind: str, *sizes: int) -> str:
        """Declare a variable, an array where it has sizes, and return its name."""
        self.lines.append(f"static {kind} {name}{''.join(f'[{size}]' for size in sizes)};")
        self.ram += self._bytes(kind) * int(np.prod(sizes, dtype=np.int64))
        return name

    def per_neuron(self, name: str, values: NDArray[Any], index: str, kind: str) -> str:
        """Return C for the value of a neuron: a number where all have the same."""
        if values.size and (values == values.flat[0]).all():
            return literal(int(values.flat[0]), kind)
        # unsigned tables would turn comparisons with signed numbers into others
        low = int(values.min()) if kind.startswith("u") else min(int(values.min()), -1)
        stored = narrowest(low, int(values.max()))
        return f"{self.constant(name, values, stored)}[{index}]"

    def _bytes(self, kind: str) -> int:
        """Size of a number of a type, those of the header included."""
        own = {"@prefix@_int_t": self.int_bytes, "@prefix@_id_t": self.id_bytes}
        return own.get(kind) or bytes_of(kind)

    @property
    def text(self) -> str:
        """The declarations as C."""
        return "\n".join(self.lines)


def _wrap_lines(items: Iterable[str]) -> list[str]:
    """Items between commas, in lines of bounded length."""
    lines, line = [], "   "
    for item in items:
        if len(line) + len(item) + 2 > _LINE:
            lines.append(line)
            line = "   "
        line += f" {item},"
    return [*lines, line]


def fit(name: str, register: Register, kind: str) -> str:
    """A C function that holds a number as the register does; "" where it changes nothing."""
    if register.overflow == "none" and register.between is None:
        return ""
    steps = [*_overflow(register, kind)]
    if register.between is not None:
        steps += _clamp(*register.between, kind)
    return _function(name, kind, steps)


def hold(name: str, register: Register, expression: str) -> str:
    """The expression as the register holds it."""
    plain = register.overflow == "none" and register.between is None
    return f"({expression})" if plain else f"{name}({expression})"


def _overflow(register: Register, kind: str) -> list[str]:
    half = 1 << (register.bits - 1)
    if register.overflow == "wrap":
        return _wrap_statements(half, kind)
    if register.overflow == "wrap-once":
        twice = literal(2 * half, kind) if 2 * half < 2**31 else f"INT64_C({2 * half})"
        return [
            f"if (x > {literal(half, kind)}) {{",
            f"    x -= {twice};",
            f"}} else if (x <= {literal(-half, kind)}) {{",
            f"    x += {twice};",
            "}",
        ]
    if register.overflow == "none":
        return []
    return _clamp(1 - half if register.overflow == "clip" else -half, half - 1, kind)


def _wrap_statements(half: int, kind: str) -> list[str]:
    """(x + half) mod 2 half - half, of unsigned integers."""
    unsigned = f"u{kind}"
    mask = literal(2 * half - 1, unsigned)
    return [
        f"const {unsigned} raised = (({unsigned})x + {literal(half, unsigned)}) & {mask};",
        f"x = ({kind})raised - {literal(half, kind)};",
    ]


def _clamp(low: int, high: int, kind: str) -> list[str]:
    return [
        f"if (x < {literal(low, kind)}) {{",
        f"    x = {literal(low, kind)};",
        f"}} else if (x > {literal(high, kind)}) {{",
        f"    x = {literal(high, kind)};",
        "}",
    ]


def _function(name: str, kind: str, steps: list[str]) -> str:
    body = "\n".join(f"    {step}" for step in steps)
    return f"static {kind} {name}({kind} x)\n{{\n{body}\n    return x;\n}}\n"


def decay(kind: str, bits: int, whole: bool, largest: int) -> str:
    """A C function: the magnitude of x times factor / 2**bits, rounded toward zero.

    whole: whether a factor can be 2**bits itself.
    largest: magnitude of x.
    32-bit numbers are cut in two at the decay's bits, so that no product needs 64:
    (h 2**b + l) f >> b  =  h f + (l f >> b).
    Cores with a long multiplication take the upper half of 2 x (f << 31 - b) instead, to which
    2**32 - 1 is added where x is negative: that rounds up.
    """
    unsigned = f"u{kind}"
    mask = literal((1 << bits) - 1, unsigned)
    if kind == "int32_t" and bits <= 16:
        kept = f"((size >> {bits}) * factor) + (((size & {mask}) * factor) >> {bits})"
    elif kind == "int32_t":
        kept = f"(uint32_t)(((uint64_t)size * factor) >> {bits})"
    else:
        kept = f"(size * factor) >> {bits}"
    body = (
        f"    const {unsigned} size = (x < 0) ? ({unsigned})(-x) : ({unsigned})x;\n"
        f"    const {kind} kept = ({kind})({kept});\n"
        "    return (x < 0) ? -kept : kept;\n"
    )
    if kind == "int32_t" and not whole and largest < 2**30:
        body = f"{_LONG.format(shift=31 - bits)}#else\n{body}#endif\n"
    return f"static {kind} decay({kind} x, {unsigned} factor)\n{{\n{body}}}\n"


# ARMv6-M and ARMv8-M Baseline have no long multiplication
_LONG = """\
#if !defined(__ARM_ARCH_6M__) && !defined(__ARM_ARCH_8M_BASE__)
    const int64_t product = (int64_t)(2 * x) * (int32_t)(factor << {shift});
    return (int32_t)((product + (int64_t)((x < 0) ? UINT32_MAX : 0u)) >> 32);
"""


def shifted_down(value: str, shift: str) -> str:
    """C for an arithmetic shift to the right, rounded down, of a number of either sign."""
    return f"(({value} < 0) ? (-1 - ((-1 - {value}) >> {shift})) : ({value} >> {shift}))"
