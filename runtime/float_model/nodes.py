"""Nodes in floating point: what each primitive of NIR computes.

A node is called with x (B, T, *shape), T timesteps at once, which may be one. Neurons and delays go
on from the state of the call before; the other kinds have none.
"""

import math
from collections.abc import Callable
from typing import TypeAlias

import nir
import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.runtime.float_model.neurons import Array, FloatNeurons
from spikedeploy.runtime.graph.neurons import NEURONS
from spikedeploy.runtime.graph.order import delay_timesteps
from spikedeploy.runtime.graph.shapes import DENSE
from spikedeploy.runtime.graph.windows import (
    CONVOLUTIONS,
    POOLS,
    ConvWindow,
    convolution_window,
    pool_window,
)

# output (B, T, *shape) for the input x (B, T, *shape)
Node: TypeAlias = Callable[[Array], Array]

# values that the windows of a convolution or pool may hold at once: bounds the memory of a call
CHUNK_VALUES = 1 << 22


def build_node(name: str, node: nir.NIRNode, convention: Convention, dtype: DTypeLike) -> Node:
    """The function that computes a node; ArtifactError for kinds that are not supported."""
    if isinstance(node, DENSE):
        return _dense(node, dtype) if node.weight.ndim == 2 else _stacked(node, dtype)
    if isinstance(node, CONVOLUTIONS):
        return convolution(name, node, dtype)
    if isinstance(node, POOLS):
        return _pool(name, node)
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
        f"node {name!r}: {type(node).__name__} is no primitive of NIR that is supported. Use one."
    )


class Delay:
    """y(t) = x(t - delay), and 0 before the first input has arrived.

    timesteps: (*N) delay of each element.
    """

    def __init__(self, name: str, timesteps: NDArray[np.int64]) -> None:
        self.name = name
        self.timesteps = timesteps
        # (B, up to the longest delay, *N), the inputs of the timesteps before, as far as known
        self.past: Array | None = None

    def reset(self) -> None:
        """Forget all inputs."""
        self.past = None

    def __call__(self, x: Array) -> Array:
        """Output (B, T, *N) of the next T timesteps."""
        rows = x if self.past is None else self._since(self.past, x)
        first = rows.shape[1] - x.shape[1]
        output = np.zeros_like(x)
        for steps in np.unique(self.timesteps):
            delayed = self.timesteps == steps
            arriving = rows[:, max(0, first - steps) : max(0, rows.shape[1] - steps)]
            output[:, x.shape[1] - arriving.shape[1] :, delayed] = arriving[..., delayed]
        self.past = rows[:, max(0, rows.shape[1] - self.timesteps.max()) :]
        return output

    def _since(self, past: Array, x: Array) -> Array:
        if len(past) != len(x):
            raise ObservationError(
                f"node {self.name!r} holds the inputs of {len(past)} networks, the raster is for "
                f"{len(x)}. Call reset() between batches of different size."
            )
        return np.concatenate([past, x], axis=1)


def _dense(node: nir.NIRNode, dtype: DTypeLike) -> Node:
    """Affine or Linear: all timesteps in one product."""
    # (M, N) in C order, which BLAS multiplies in half the time
    weight = np.ascontiguousarray(node.weight.T, dtype=dtype)
    bias = node.bias.astype(dtype) if isinstance(node, nir.Affine) else None

    def dense(x: Array) -> Array:
        rows = x.reshape(-1, x.shape[2])
        # leaving out inputs that are 0 in every timestep halves the time at batch 1
        (active,) = rows.any(axis=0).nonzero()
        sparse = 2 * len(active) < len(weight)
        # y = W x + b
        y: Array = (
            rows.take(active, axis=1) @ weight.take(active, axis=0) if sparse else rows @ weight
        )
        y = y.reshape(*x.shape[:2], -1)
        return y if bias is None else y + bias

    return dense


def _stacked(node: nir.NIRNode, dtype: DTypeLike) -> Node:
    """Affine or Linear with weights (..., N, M), a matrix for each row of the input (..., M)."""
    weight = node.weight.astype(dtype)
    bias = node.bias.astype(dtype) if isinstance(node, nir.Affine) else None

    def stacked(x: Array) -> Array:
        # y = W x + b
        y: Array = np.matmul(weight, x[..., None])[..., 0]
        return y if bias is None else y + bias

    return stacked


def convolution(name: str, node: nir.NIRNode, dtype: DTypeLike) -> Node:
    """Conv1d or Conv2d: output (B, T, N, *P) of x (B, T, C, *X).

    y[n, p] = sum over c, k of W[n, c, k] x[c, p stride + k dilation - padding] + b[n], where c
    are the C / groups channels of the group of n (torch.nn.functional.conv2d).
    """
    window, groups = convolution_window(name, node), int(node.groups)
    # (G, C/G K, N/G)
    weight = node.weight.reshape(groups, len(node.weight) // groups, -1).swapaxes(1, 2)
    weight = np.ascontiguousarray(weight, dtype=dtype)
    bias = node.bias.astype(dtype).reshape(-1, *(1 for _ in window.kernel))
    return _in_chunks(window, lambda windows: _product(windows, weight, window) + bias)


def _pool(name: str, node: nir.NIRNode) -> Node:
    """SumPool2d or AvgPool2d: output (B, T, C, *P) of x (B, T, C, *X).

    A mean divides by the whole kernel, zeros of the padding included, which is the default of
    torch.nn.AvgPool2d; NIR leaves it open.
    """
    window = pool_window(name, node)
    size = math.prod(window.kernel) if isinstance(node, nir.AvgPool2d) else 1
    return _in_chunks(window, lambda windows: windows.sum(axis=(-2, -1)) / size)


def _product(windows: Array, weight: Array, window: ConvWindow) -> Array:
    """Windows (R, C, *P, *K) times weights (G, C/G K, N/G), as (R, N, *P)."""
    groups, axes = len(weight), len(window.kernel)
    rows, channels, *positions = windows.shape[: 2 + axes]
    # (R, G, C/G, *P, *K), still a view
    split = windows.reshape(rows, groups, channels // groups, *windows.shape[2:])
    before, after = range(3, 3 + axes), range(3 + axes, 3 + 2 * axes)
    columns = split.transpose(0, 1, *before, 2, *after)
    columns = columns.reshape(rows, groups, math.prod(positions), -1)
    return np.asarray((columns @ weight).swapaxes(2, 3).reshape(rows, -1, *positions))


def _in_chunks(window: ConvWindow, compute: Node) -> Node:
    """The computation over chunks of rows whose windows hold at most CHUNK_VALUES values."""

    def chunked(x: Array) -> Array:
        # (R, C, *X)
        rows = x.reshape(-1, *x.shape[2:])
        values = x.shape[2] * math.prod(window.positions(x.shape[3:])) * math.prod(window.kernel)
        size = max(1, CHUNK_VALUES // values)
        parts = [compute(window.view(rows[i : i + size])) for i in range(0, len(rows), size)]
        y = np.concatenate(parts)
        return np.asarray(y.reshape(*x.shape[:2], *y.shape[1:]), dtype=x.dtype)

    return chunked
