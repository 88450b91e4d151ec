"""The delay node: y(t) = x(t - tau), for every element its own tau."""

from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

from runtime.convention import Convention
from runtime.discrete import ROUNDING
from runtime.errors import ConventionError, ObservationError

Array = NDArray[np.floating[Any]]


class Delay:
    """What arrived some timesteps ago; nothing had arrived before the first timestep.

    timesteps: of each element.
    """

    def __init__(self, name: str, timesteps: NDArray[np.int64]) -> None:
        self.name = name
        self.timesteps = timesteps
        # rows of the timesteps before (B, up to the longest delay, *N), as far as there were any
        self.past: Array | None = None

    def reset(self) -> None:
        """Nothing is on its way."""
        self.past = None

    def __call__(self, x: Array) -> Array:
        """What left over the next T timesteps (B, T, *N) comes out."""
        rows = x if self.past is None else self._since(self.past, x)
        first = rows.shape[1] - x.shape[1]
        output = np.zeros_like(x)
        for steps in np.unique(self.timesteps):
            late = self.timesteps == steps
            there = rows[:, max(0, first - steps) : max(0, rows.shape[1] - steps)]
            output[:, x.shape[1] - there.shape[1] :, late] = there[..., late]
        self.past = rows[:, max(0, rows.shape[1] - self.timesteps.max()) :]
        return output

    def _since(self, past: Array, x: Array) -> Array:
        if len(past) != len(x):
            raise ObservationError(
                f"node {self.name!r} holds the past of {len(past)} networks, the raster is for "
                f"{len(x)}. Call reset() between batches of different size."
            )
        return np.concatenate([past, x], axis=1)


def delay_timesteps(name: str, node: nir.Delay, convention: Convention) -> NDArray[np.int64]:
    """The delay of each element in timesteps, which must be whole."""
    with np.errstate(over="ignore", under="ignore"):
        # later than any raster is long: the number only has to fit
        found = np.minimum(node.delay.astype(np.float64) / convention.dt, 2.0**62)
    whole = np.rint(found)
    tolerance = ROUNDING.get(node.delay.dtype.type, ROUNDING[np.float64])
    odd = np.abs(found - whole) > tolerance * np.maximum(whole, 1)
    if odd.any():
        raise ConventionError(
            f"node {name!r}: a delay of {node.delay[odd][0]:g} s is {found[odd][0]:g} timesteps of "
            f"{convention.dt:g} s, which is not whole. Choose a dt that divides it, or round it."
        )
    return np.asarray(whole, np.int64)
