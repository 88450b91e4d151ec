"""Convolutions and pools in floating point: windows of the input, all in one product."""

import math
from collections.abc import Callable
from typing import Any

import nir
import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.graph.windows import ConvWindow, convolution_window, pool_window

Array = NDArray[np.floating[Any]]
Rows = Callable[[Array], Array]

# numbers that the windows of some rows may fill at once
ENOUGH = 1 << 22


def convolution(name: str, node: nir.NIRNode, dtype: DTypeLike) -> Rows:
    """Conv1d or Conv2d: output (B, T, N, *P) of x (B, T, C, *X).

    y[n, p] = sum over c, k of W[n, c, k] x[c, p stride + k dilation - padding] + b[n], where n
    hears only the C / groups channels of its own group (torch.nn.functional.conv2d).
    """
    window, groups = convolution_window(name, node), int(node.groups)
    # (G, C/G K, N/G)
    weight = node.weight.reshape(groups, len(node.weight) // groups, -1).swapaxes(1, 2)
    weight = np.ascontiguousarray(weight, dtype=dtype)
    bias = node.bias.astype(dtype).reshape(-1, *(1 for _ in window.kernel))
    return _by_rows(window, lambda seen: _product(seen, weight, window) + bias)


def pool(name: str, node: nir.NIRNode) -> Rows:
    """SumPool2d or AvgPool2d: output (B, T, C, *P) of x (B, T, C, *X).

    A mean divides by the whole kernel, zeros of the padding included, which is what
    torch.nn.AvgPool2d does unless told otherwise; NIR leaves it open.
    """
    window = pool_window(name, node)
    size = math.prod(window.kernel) if isinstance(node, nir.AvgPool2d) else 1
    return _by_rows(window, lambda seen: seen.sum(axis=(-2, -1)) / size)


def _product(seen: Array, weight: Array, window: ConvWindow) -> Array:
    """Windows (R, C, *P, *K) times weights (G, C/G K, N/G), as (R, N, *P)."""
    groups, axes = len(weight), len(window.kernel)
    rows, channels, *places = seen.shape[: 2 + axes]
    # (R, G, C/G, *P, *K), still a view
    split = seen.reshape(rows, groups, channels // groups, *seen.shape[2:])
    before, after = range(3, 3 + axes), range(3 + axes, 3 + 2 * axes)
    columns = split.transpose(0, 1, *before, 2, *after)
    columns = columns.reshape(rows, groups, math.prod(places), -1)
    return np.asarray((columns @ weight).swapaxes(2, 3).reshape(rows, -1, *places))


def _by_rows(window: ConvWindow, compute: Rows) -> Rows:
    """The computation over so many rows at once that their windows stay within ENOUGH."""

    def over_time(x: Array) -> Array:
        # (R, C, *X)
        rows = x.reshape(-1, *x.shape[2:])
        numbers = x.shape[2] * math.prod(window.positions(x.shape[3:])) * math.prod(window.kernel)
        some = max(1, ENOUGH // numbers)
        parts = [compute(window.view(rows[i : i + some])) for i in range(0, len(rows), some)]
        y = np.concatenate(parts)
        return np.asarray(y.reshape(*x.shape[:2], *y.shape[1:]), dtype=x.dtype)

    return over_time
