"""Integer arithmetic as chips do it: registers, decays and rounding, on arrays of int64."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime import choices
from spikedeploy.runtime.errors import ChipError, ConfigError

# bits of a register whose sums int64 still holds
_WIDEST = 62

Integers = NDArray[np.int64]
Overflow = Literal["none", "wrap", "wrap-once", "clip", "saturate"]
OVERFLOWS: tuple[Overflow, ...] = get_args(Overflow)
# of tables of datasheets
_WORDS: dict[Overflow, str] = {
    "none": "never full",
    "wrap": "wraps",
    "wrap-once": "wraps once",
    "clip": "clips",
    "saturate": "saturates",
}


def decay(x: Integers, factor: Integers, bits: int) -> Integers:
    """The part of x left after a timestep: factor / 2**bits of it, rounded toward zero."""
    # y = sign(x) * ((|x| * factor) >> bits)
    return cast("Integers", np.sign(x) * (np.abs(x) * factor >> bits))


def shift_decay(x: Integers, shift: Integers) -> Integers:
    """Loss of x in a timestep: x >> shift, rounded down, and 1 toward zero where that is 0."""
    lost = x >> shift
    return np.where(lost == 0, np.sign(x), lost)


@dataclass(frozen=True)
class Register:
    """A signed register of the chip and what happens to a number that does not fit.

    bits: width with the sign.
    overflow: "none" is not modelled; "wrap" is two's complement; "wrap-once" is lava's current
        (lava PyLifModelBitAcc): the width is added or subtracted once, and the two edges are
        read as +2**(bits - 1); "clip" saturates at the largest magnitude on both sides;
        "saturate" at the edges of two's complement, where the lower is one further out.
    between: a narrower range, to which numbers are clipped after that (nengo-loihi's vmin, vmax).
    """

    bits: int
    overflow: Overflow
    between: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if not 2 <= self.bits <= _WIDEST:
            raise ChipError(
                f"a register of {self.bits} bits; choose 2 to {_WIDEST}, sign included."
            )
        if self.overflow not in OVERFLOWS:
            raise ChipError(
                f"overflow {self.overflow!r} is unknown. Choose one of {', '.join(OVERFLOWS)}."
            )

    @cached_property
    def limit(self) -> int:
        """Largest magnitude that fits whatever the overflow: 2**(bits - 1) - 1, if not less."""
        edge = (1 << (self.bits - 1)) - 1
        return min(edge, *map(abs, self.between)) if self.between else edge

    def fit(self, x: Integers) -> Integers:
        """The numbers x as the register holds them."""
        held = _OVERFLOWS[self.overflow](x, self.bits)
        return held if self.between is None else np.asarray(np.clip(held, *self.between))

    def fit_counted(self, x: Integers) -> tuple[Integers, Integers]:
        """The numbers x as the register holds them, and 1 for each that did not fit."""
        held = self.fit(x)
        return held, (held != x).astype(np.int64)

    def describe(self) -> str:
        """Describe its width and its behaviour on overflow."""
        return f"{self.bits} bits, {_WORDS[self.overflow]}"


def _unchanged(x: Integers, bits: int) -> Integers:
    return x


def _wrap(x: Integers, bits: int) -> Integers:
    half = 1 << (bits - 1)
    return (x + half) % (2 * half) - half


def _wrap_once(x: Integers, bits: int) -> Integers:
    half = 1 << (bits - 1)
    return np.asarray(x - 2 * half * (x > half) + 2 * half * (x <= -half))


def _clip(x: Integers, bits: int) -> Integers:
    limit = (1 << (bits - 1)) - 1
    return np.asarray(np.clip(x, -limit, limit))


def _saturate(x: Integers, bits: int) -> Integers:
    half = 1 << (bits - 1)
    return np.asarray(np.clip(x, -half, half - 1))


_OVERFLOWS: dict[Overflow, Callable[[Integers, int], Integers]] = {
    "none": _unchanged,
    "wrap": _wrap,
    "wrap-once": _wrap_once,
    "clip": _clip,
    "saturate": _saturate,
}


Rounding = choices.Rounding


def round_values(values: NDArray[Any], rounding: Rounding) -> NDArray[np.int64]:
    """Round to whole numbers: the nearest, half to even; or without their fractions."""
    if rounding not in get_args(Rounding):
        raise ConfigError(f"rounding {rounding!r} is unknown. Choose 'nearest' or 'truncate'.")
    # the product with a scale may fall a last bit short of the whole number that it means
    whole = np.rint(values) if rounding == "nearest" else np.trunc(values * (1 + 1e-12))
    return whole.astype(np.int64)


def magnitude(values: NDArray[Any]) -> float:
    """The largest magnitude; 0 where there are no values."""
    return float(np.abs(values).max(initial=0))
