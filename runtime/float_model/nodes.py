"""What each kind of NIR node does to its input, in floating point.

Every node is called with T timesteps in a row, which may be one. Neurons go on from the state that
the call before left; the other kinds have none.

The delay node: y(t) = x(t - tau), for every element its own tau.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import nir
import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.runtime.float_model.spatial import convolution, pool
from spikedeploy.runtime.graph.neurons import NEURONS, discretise
from spikedeploy.runtime.graph.order import delay_timesteps
from spikedeploy.runtime.graph.windows import CONVOLUTIONS, POOLS

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


Values: TypeAlias = NDArray[np.floating[Any]]

# output (B, T, *shape) for the input x (B, T, *shape)
Node: TypeAlias = Callable[[Values], Values]


class FloatNeurons:
    """A layer of neurons; its output are spikes where it has thresholds, else membranes."""

    def __init__(
        self, name: str, node: nir.NIRNode, convention: Convention, dtype: DTypeLike
    ) -> None:
        layer = discretise(name, node, convention)
        self.name = name
        self.subtract = convention.reset == "subtract"
        self.spikes = convention.spikes
        self.a = None if layer.current_decay is None else layer.current_decay.astype(dtype)
        self.b = layer.membrane_decay.astype(dtype)
        self.gain = layer.gain.astype(dtype)
        self.leak = layer.leak.astype(dtype)
        self.threshold = None if layer.threshold is None else layer.threshold.astype(dtype)
        self.v_reset = layer.v_reset.astype(dtype)
        self.floor = _floor(layer.threshold, convention)
        self.current: Values | None = None
        self.membrane: Values | None = None

    def reset(self) -> None:
        """Currents and membranes are 0 again."""
        self.current = self.membrane = None

    def __call__(self, x: Values) -> Values:
        """Spikes or membranes (B, T, *N)."""
        output = np.empty_like(x)
        current, membrane = self._state(x[:, 0])
        # gain and leak are constants of discrete.py
        drive = x * self.gain
        for t in range(x.shape[1]):
            # I = a I + gain x
            current = drive[:, t] if self.a is None else self.a * current + drive[:, t]
            # V = b V + I + leak
            membrane = self.b * membrane + current + self.leak
            output[:, t], membrane = self._fire(membrane)
        self.current, self.membrane = current, membrane
        return output

    def _fire(self, membrane: Values) -> tuple[NDArray[Any], Values]:
        """Output of this timestep, and the membrane after the reset."""
        if self.threshold is None:
            return membrane, membrane
        spikes = self._spikes(membrane, self.threshold)
        if self.subtract:
            membrane = membrane - spikes * (self.threshold - self.v_reset)
        else:
            membrane = np.where(spikes, self.v_reset, membrane)
        return spikes, membrane if self.floor is None else np.maximum(membrane, self.floor)

    def _spikes(self, membrane: Values, threshold: Values) -> NDArray[Any]:
        """How many each neuron sends in this timestep."""
        if self.spikes == "above":
            return np.asarray(membrane > threshold)
        reached = membrane >= threshold
        if self.spikes == "reached":
            return np.asarray(reached)
        # n = floor((V - v_reset) / (threshold - v_reset))
        times = np.floor((membrane - self.v_reset) / (threshold - self.v_reset))
        return np.asarray(times * reached)

    def _state(self, like: Values) -> tuple[Values, Values]:
        if self.current is None or self.membrane is None:
            return np.zeros_like(like), np.zeros_like(like)
        if self.membrane.shape != like.shape:
            raise ObservationError(
                f"node {self.name!r} holds the state of {len(self.membrane)} networks, the raster "
                f"is for {len(like)}. Call reset() between batches of different size."
            )
        return self.current, self.membrane


def _floor(threshold: NDArray[np.float64] | None, convention: Convention) -> Values | None:
    """Lowest membrane (N,), or None where there is none."""
    if threshold is None or convention.floor == "none":
        return None
    return np.zeros_like(threshold) if convention.floor == "zero" else -threshold


def build(name: str, node: nir.NIRNode, convention: Convention, dtype: DTypeLike) -> Node:
    """The node, ready to be computed; kinds that NIR does not have are refused by name."""
    if isinstance(node, (nir.Affine, nir.Linear)):
        return _dense(node, dtype) if node.weight.ndim == 2 else _stacked(node, dtype)
    if isinstance(node, CONVOLUTIONS):
        return convolution(name, node, dtype)
    if isinstance(node, POOLS):
        return pool(name, node)
    if isinstance(node, nir.Delay):
        return Delay(name, delay_timesteps(name, node, convention))
    if isinstance(node, NEURONS):
        return FloatNeurons(name, node, convention, dtype)
    if isinstance(node, (nir.Input, nir.Output)):
        return lambda x: x
    if isinstance(node, nir.Scale):
        scale = node.scale.astype(dtype)
        return lambda x: x * scale
    if isinstance(node, nir.Threshold):
        threshold = node.threshold.astype(dtype)
        return lambda x: (x > threshold).astype(dtype)
    if isinstance(node, nir.Flatten):
        shape = tuple(int(n) for n in node.output_type["output"])
        return lambda x: x.reshape(*x.shape[:2], *shape)
    raise ArtifactError(
        f"node {name!r}: {type(node).__name__} is no primitive of NIR. Write it with those."
    )


def _dense(node: nir.NIRNode, dtype: DTypeLike) -> Node:
    """Affine or Linear: all timesteps in one multiplication."""
    # (M, N) in C order: BLAS multiplies it in half the time
    weight = np.ascontiguousarray(node.weight.T, dtype=dtype)
    bias = node.bias.astype(dtype) if isinstance(node, nir.Affine) else None

    def dense(x: Values) -> Values:
        rows = x.reshape(-1, x.shape[2])
        # inputs that are silent all the time add nothing: half the time at batch 1
        (active,) = rows.any(axis=0).nonzero()
        few = 2 * len(active) < len(weight)
        # y = W x + b
        y: Values = (
            rows.take(active, axis=1) @ weight.take(active, axis=0) if few else rows @ weight
        )
        y = y.reshape(*x.shape[:2], -1)
        return y if bias is None else y + bias

    return dense


def _stacked(node: nir.NIRNode, dtype: DTypeLike) -> Node:
    """Affine or Linear with a matrix of its own (..., N, M) for every row of the input (..., M)."""
    weight = node.weight.astype(dtype)
    bias = node.bias.astype(dtype) if isinstance(node, nir.Affine) else None

    def stacked(x: Values) -> Values:
        # y = W x + b
        y: Values = np.matmul(weight, x[..., None])[..., 0]
        return y if bias is None else y + bias

    return stacked
