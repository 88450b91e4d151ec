"""What `reset` and `step` of other people's environments return: numbers, or a sentence.

They may be Python's or NumPy's, arrays, lists or tensors. Nothing is guessed: what is no number is
refused with what was found.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import EnvError

FloatArray: TypeAlias = NDArray[np.float64]
_LARGEST = float(np.finfo(np.float32).max)  # policies compute in float32
_SHOWN = 60  # characters of a value in a sentence


def read_number(what: str, value: object) -> float:
    """One finite number, of an array or tensor of one element too."""
    found = _numbers(value)
    if found is None or found.size != 1 or not np.isfinite(found).all():
        raise EnvError(f"{what} is {show(value)}: give one finite number")
    return float(found.reshape(()))


def read_flag(what: str, value: object) -> bool:
    """True or false, of 0 and 1 and of an array or tensor of one element too."""
    found = find_flag(value)
    if found is None:
        raise EnvError(f"{what} is {show(value)}: give True or False")
    return found


def find_flag(value: object) -> bool | None:
    """True or false as `read_flag` reads it; None where it is neither."""
    found = _numbers(value)
    if found is None or found.size != 1 or found.reshape(()) not in (0.0, 1.0):
        return None
    return bool(found.reshape(()))


def is_unknown(value: object) -> bool:
    """Whether a value says that there is none yet: None, nan, or a masked one."""
    found = _scalar(value)
    is_nan = isinstance(found, float) and math.isnan(found)
    return found is None or found is np.ma.masked or is_nan


def read_vector(what: str, value: object, shape: tuple[int, ...]) -> FloatArray:
    """A copy (n,) of finite numbers, given in a shape that may differ by axes of length 1."""
    found = _numbers(value)
    if found is None:
        raise EnvError(f"{what} is {show(value)}: give numbers of shape {shape}")
    if _without_ones(found.shape) != _without_ones(shape):
        raise EnvError(
            f"{what} has the shape {found.shape}, and observation_space says {shape}: make them "
            "agree"
        )
    wrong = np.flatnonzero(~(np.abs(found) <= _LARGEST))  # nan too
    if wrong.size:
        values = ", ".join(f"{each:g}" for each in found.reshape(-1)[wrong[:3]])
        raise EnvError(
            f"{what} has {values} at {wrong[:3].tolist()}, which is no finite number of float32"
        )
    return found.reshape(-1)


def read_info(what: str, value: object, remedy: str) -> Mapping[str, Any]:
    """The dictionary; None is an empty one."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise EnvError(f"{what} is {show(value)}, no dictionary; {remedy}")
    return value


def is_masked(value: object) -> bool:
    """Whether any of it is masked, of which NumPy would give what is behind the mask."""
    if isinstance(value, list | tuple):
        return any(map(is_masked, value))
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.getmaskarray(value).any())


def numbers_in(info: Mapping[str, Any]) -> dict[str, bool | int | float]:
    """The numbers in an info by name, arrays of one element among them."""
    plain = {str(key): _scalar(value) for key, value in info.items()}
    return {key: value for key, value in plain.items() if isinstance(value, bool | int | float)}


def show(value: object) -> str:
    """A value and its type, short."""
    text = " ".join(repr(value).split())
    text = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
    return text if value is None else f"{text} ({type(value).__name__})"


def _scalar(value: Any) -> Any:  # noqa: ANN401
    """The Python scalar of a number, or of an array or tensor of one; else the value."""
    if is_masked(value):
        return np.ma.masked
    if isinstance(value, np.generic | np.ndarray) or hasattr(value, "detach"):
        return value.item() if getattr(value, "size", None) == 1 or _is_single(value) else value
    return value


def _is_single(value: Any) -> bool:  # noqa: ANN401
    return hasattr(value, "numel") and value.numel() == 1


def _numbers(value: Any) -> FloatArray | None:  # noqa: ANN401
    """A copy in float64; None where it is not made of real numbers, or some are masked."""
    if is_masked(value):
        return None
    if isinstance(value, numbers.Number) and not isinstance(value, np.generic):
        value = _real(value)
    if hasattr(value, "detach"):  # a tensor of torch
        value = value.detach().cpu()
    try:
        found = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):  # ragged lists
        return None
    return found.astype(np.float64) if found.dtype.kind in "biuf" else None


def _real(value: Any) -> float | None:  # noqa: ANN401
    """A number of Python's, such as Fraction or Decimal; None where it is complex."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return None
    except OverflowError:
        return float("inf")


def _without_ones(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(size for size in shape if size != 1)
