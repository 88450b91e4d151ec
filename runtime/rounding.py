"""Rounding: how a float becomes a whole number of a chip."""

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from runtime.errors import ConfigError

Rounding = Literal["nearest", "truncate"]


def rounded(values: NDArray[Any], rounding: Rounding) -> NDArray[np.int64]:
    """The values as whole numbers: the nearest, half to even; or without their fractions."""
    if rounding not in get_args(Rounding):
        raise ConfigError(f"rounding {rounding!r} is unknown. Choose 'nearest' or 'truncate'.")
    # the product with a scale may fall a last bit short of the whole number that it means
    whole = np.rint(values) if rounding == "nearest" else np.trunc(values * (1 + 1e-12))
    return whole.astype(np.int64)
