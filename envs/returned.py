"""Values that `reset` and `step` of foreign environments return, read as numbers or refused.

They may be Python's or NumPy's, arrays, lists or tensors. Nothing is guessed: anything but a number
is refused, and the error shows it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import EnvError

FloatArray: TypeAlias = NDArray[np.float64]
_LARGEST = float(np.finfo(np.float32).max)  # policies compute in float32
_SHOWN = 60  # characters of a value in a sentence


def read_number(what: str, value: object) -> float:
    """Return one finite number, of an array or tensor of one element too."""
    found = _single(value)
    if found is None or not np.isfinite(found):
        raise EnvError(f"{what} is {show(value)}: give one finite number")
    return found


def read_flag(what: str, value: object) -> bool:
    """Return True or False, of 0 and 1 and of an array or tensor of one element too."""
    found = find_flag(value)
    if found is None:
        raise EnvError(f"{what} is {show(value)}: give True or False")
    return found


def find_flag(value: object) -> bool | None:
    """Return True or False as `read_flag` reads it; None where it is neither."""
    found = _single(value)
    return bool(found) if found in (0.0, 1.0) else None


def is_unknown(value: object) -> bool:
    """Return True for a value that stands for none: None, NaN, or a masked one."""
    found = _single(value)
    return value is None or is_masked(value) or (found is not None and found != found)


def read_vector(what: str, value: object, shape: tuple[int, ...]) -> FloatArray:
    """Return a copy (n,) of finite numbers in a shape that may differ by axes of length 1."""
    found = _numbers(value)
    if found is None:
        raise EnvError(f"{what} is {show(value)}: give numbers of shape {shape}")
    given, wanted = ([size for size in each if size != 1] for each in (found.shape, shape))
    if given != wanted:
        raise EnvError(
            f"{what} has the shape {found.shape}, and observation_space says {shape}: make them "
            "agree"
        )
    flat = found.reshape(-1)
    wrong = np.flatnonzero(~(np.abs(flat) <= _LARGEST))  # nan too
    if wrong.size:
        values = ", ".join(f"{each:g}" for each in flat[wrong[:3]])
        raise EnvError(
            f"{what} has {values} at {wrong[:3].tolist()}, which is no finite number of float32"
        )
    return flat


def is_masked(value: object) -> bool:
    """Return True if any value is masked: NumPy would return the number behind the mask."""
    if isinstance(value, list | tuple):
        return any(map(is_masked, value))
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.getmaskarray(value).any())


def numbers_in(info: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers in an info by name, arrays of one element among them."""
    plain = {str(key): _scalar(value) for key, value in info.items()}
    return {key: value for key, value in plain.items() if isinstance(value, bool | int | float)}


def show(value: object) -> str:
    """Return a value and its type, short."""
    text = " ".join(repr(value).split())
    text = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"
    return text if value is None else f"{text} ({type(value).__name__})"


def _scalar(value: Any) -> Any:  # noqa: ANN401
    """Return the Python scalar of an array or tensor of one element; else the value."""
    if isinstance(value, np.generic | np.ndarray) or hasattr(value, "detach"):
        found = _numbers(value)
        return value.item() if found is not None and found.size == 1 else None
    return value


def _single(value: object) -> float | None:
    found = _numbers(value)
    return None if found is None or found.size != 1 else float(found.reshape(()))


def _numbers(value: Any) -> FloatArray | None:  # noqa: ANN401
    """Return a copy in float64; None where it is not made of real numbers, or some are masked."""
    if is_masked(value):
        return None
    if hasattr(value, "detach"):  # a tensor of torch
        value = value.detach().cpu()
    try:
        found = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):  # ragged lists
        return None
    return found.astype(np.float64) if found.dtype.kind in "biuf" else None
