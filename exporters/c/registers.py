"""Registers and decays of a chip as C that is defined for every number.

Shifts of negative numbers and conversions that do not fit are left to the compiler by C99; here
only magnitudes are shifted, and wrapping is done on unsigned integers, whose overflow is defined.
"""

from spikedeploy.exporters.c.declarations import literal
from spikedeploy.runtime.chips.registers import Register


def fit(name: str, register: Register, kind: str) -> str:
    """A C function that holds a number as the register does; "" where it changes nothing."""
    if register.overflow == "none" and register.between is None:
        return ""
    steps = [*_overflow(register, kind)]
    if register.between is not None:
        steps += _clamped(*register.between, kind)
    return _function(name, kind, steps)


def held(name: str, register: Register, expression: str) -> str:
    """The expression as the register holds it."""
    plain = register.overflow == "none" and register.between is None
    return f"({expression})" if plain else f"{name}({expression})"


def _overflow(register: Register, kind: str) -> list[str]:
    half = 1 << (register.bits - 1)
    if register.overflow == "wrap":
        return _wrapped(half, kind)
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
    return _clamped(1 - half if register.overflow == "clip" else -half, half - 1, kind)


def _wrapped(half: int, kind: str) -> list[str]:
    """(x + half) mod 2 half - half, of unsigned integers."""
    unsigned = f"u{kind}"
    mask = literal(2 * half - 1, unsigned)
    return [
        f"const {unsigned} raised = (({unsigned})x + {literal(half, unsigned)}) & {mask};",
        f"x = ({kind})raised - {literal(half, kind)};",
    ]


def _clamped(low: int, high: int, kind: str) -> list[str]:
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
