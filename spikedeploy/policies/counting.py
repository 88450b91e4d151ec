"""Operations of a script that computes with NumPy, counted while it computes.

A ufunc counts as often as it has results, a reduction once less than it has numbers, an argmin as
its comparisons. What moves numbers (take, stack, where) and what is computed from constants alone
counts nothing. Numbers that leave their arrays, such as by `item`, are counted no longer.
"""

# ruff: noqa: ANN401 - signatures are those of NumPy
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ConfigError

# ufunc -> operation of one result; functions have their own names
_NAMES = {
    **dict.fromkeys(("add", "subtract", "negative"), "additions"),
    **dict.fromkeys(("multiply", "square"), "multiplications"),
    **dict.fromkeys(("divide", "remainder", "floor_divide"), "divisions"),
    **dict.fromkeys(
        ("minimum", "maximum", "less", "less_equal", "greater", "greater_equal"), "comparisons"
    ),
    "floor": "roundings",
    **{name: name for name in ("sin", "cos", "arctan2", "arccos", "hypot", "sqrt")},
}
_CLIP = "clip"  # two comparisons
_FREE = ("absolute", "sign", "logical_and", "logical_or", "logical_not")  # bits
_SEARCHES = (np.argmin, np.argmax)


class _CountedArray(np.ndarray[Any, np.dtype[Any]]):
    """An array that counts what is computed from it, together with all that come of it."""

    count: Counter[str] | None = None

    def __array_finalize__(self, source: Any) -> None:
        self.count = getattr(source, "count", None)

    def __array_ufunc__(
        self,
        ufunc: np.ufunc,
        method: str,
        *inputs: Any,
        **options: Any,
    ) -> Any:
        plain = [_plain(each) for each in inputs]
        if "out" in options:
            options["out"] = tuple(_plain(each) for each in options["out"])
        found = getattr(ufunc, method)(*plain, **options)
        if method == "__call__":
            done = np.size(found)
        else:  # at, with the numbers that are added last, or a reduction
            done = np.size(plain[-1]) if method == "at" else np.size(plain[0]) - np.size(found)
        count = _count_of(inputs)
        if ufunc.__name__ == _CLIP:
            count["comparisons"] += 2 * done
        elif ufunc is np.matmul:  # (n, k) by (k, m)
            count["multiplications"] += done * np.shape(plain[0])[-1]
            count["additions"] += done * (np.shape(plain[0])[-1] - 1)
        elif ufunc.__name__ not in _FREE:
            if ufunc.__name__ not in _NAMES:
                raise ConfigError(f"no operation is known for {ufunc.__name__} of a script")
            count[_NAMES[ufunc.__name__]] += done
        return None if found is None else _counted(found, count)

    def __array_function__(
        self,
        func: Any,
        types: Any,
        args: Any,
        kwargs: Any,
    ) -> Any:
        found, count = super().__array_function__(func, types, args, kwargs), _count_of(args)
        if func in _SEARCHES:
            count["comparisons"] += np.size(args[0]) - np.size(found)
        return _counted(found, count) if isinstance(found, np.ndarray) else found


def _plain(value: Any) -> Any:
    return value.view(np.ndarray) if isinstance(value, _CountedArray) else value


def _count_of(values: Sequence[Any]) -> Counter[str]:
    """The counter of the first counted array, which may be in a list of arrays."""
    return next(each.count for each in _arrays(values) if each.count is not None)


def _arrays(values: Sequence[Any]) -> Iterator[_CountedArray]:
    for each in values:
        if isinstance(each, list | tuple):
            yield from _arrays(each)
        elif isinstance(each, _CountedArray):
            yield each


def _counted(found: Any, count: Counter[str]) -> _CountedArray:
    array = cast("_CountedArray", np.asarray(found).view(_CountedArray))
    array.count = count
    return array


def count_operations(
    act: Callable[[NDArray[np.float64]], object], observations: NDArray[np.float64]
) -> Mapping[str, float]:
    """Mean operations, by name, of a script for an observation of an episode's (S, obs).

    Raises ConfigError for a ufunc without a known operation.
    """
    count: Counter[str] = Counter()
    for observation in observations:
        act(_counted(np.array(observation), count))
    return {name: number / len(observations) for name, number in count.items()}
