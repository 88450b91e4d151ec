"""Windows: where the kernel of a convolution or of a pool is laid, axis by axis.

Shape letters besides the usual: **R** rows (batch and time in one), **C** channels, **X** extents
of the space, **P** places of the window, **K** extents of the kernel.
"""

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import nir
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ArtifactError

Shape: TypeAlias = tuple[int, ...]

CONVOLUTIONS = (nir.Conv1d, nir.Conv2d)
POOLS = (nir.SumPool2d, nir.AvgPool2d)

# numbers of one timestep beyond which a node is a mistake, and would only exhaust the memory
LARGEST = 1 << 24


@dataclass(frozen=True)
class ConvWindow:
    """A kernel and how it moves, as (torch.nn.functional.conv2d) defines it.

    kernel: K of each axis.
    stride: from one place to the next.
    padding: zeros before and after each axis.
    dilation: from one element of the kernel to the next.
    """

    kernel: Shape
    stride: Shape
    padding: tuple[tuple[int, int], ...]
    dilation: Shape

    @property
    def reach(self) -> Shape:
        """Elements from the first to the last that the kernel touches."""
        pairs = zip(self.kernel, self.dilation, strict=True)
        return tuple(dilation * (kernel - 1) + 1 for kernel, dilation in pairs)

    def padded(self, extents: Shape) -> Shape:
        """The extents with their zeros."""
        pairs = zip(extents, self.padding, strict=True)
        return tuple(extent + sum(padding) for extent, padding in pairs)

    def places(self, extents: Shape) -> Shape:
        """P of each axis; 0 or less where the kernel does not fit."""
        axes = zip(self.padded(extents), self.reach, self.stride, strict=True)
        return tuple((extent - reach) // stride + 1 for extent, reach, stride in axes)

    def view(self, x: NDArray[Any]) -> NDArray[Any]:
        """What the kernel sees (R, C, *P, *K) of x (R, C, *X); nothing is copied but to pad."""
        if any(map(any, self.padding)):
            x = np.pad(x, ((0, 0), (0, 0), *self.padding))
        seen = sliding_window_view(x, self.reach, axis=tuple(range(2, x.ndim)))
        whole = (slice(None), slice(None))
        steps = tuple(slice(None, None, step) for step in (*self.stride, *self.dilation))
        return np.asarray(seen[whole + steps])


def convolution_window(name: str, node: nir.NIRNode) -> ConvWindow:
    """The window of a Conv1d or Conv2d; what cannot be one is refused by name."""
    axes = 1 if isinstance(node, nir.Conv1d) else 2
    kernel = tuple(map(int, node.weight.shape[2:]))
    stride = whole_numbers(name, "stride", node.stride, axes, least=1)
    dilation = whole_numbers(name, "dilation", node.dilation, axes, least=1)
    if not isinstance(node.padding, str):
        around = whole_numbers(name, "padding", node.padding, axes, least=0)
        return ConvWindow(kernel, stride, tuple((n, n) for n in around), dilation)
    return ConvWindow(
        kernel, stride, _padding(name, node.padding, kernel, stride, dilation), dilation
    )


def pool_window(name: str, node: nir.NIRNode) -> ConvWindow:
    """The window of a SumPool2d or AvgPool2d; what cannot be one is refused by name."""
    kernel = whole_numbers(name, "kernel_size", node.kernel_size, 2, least=1)
    stride = whole_numbers(name, "stride", node.stride, 2, least=1)
    around = whole_numbers(name, "padding", node.padding, 2, least=0)
    return ConvWindow(kernel, stride, tuple((n, n) for n in around), (1, 1))


def placed(name: str, window: ConvWindow, extents: Shape) -> Shape:
    """P of each axis, above 0 and of a size that can be computed."""
    places = window.places(extents)
    if min(places) < 1:
        raise ArtifactError(
            f"node {name!r}: a kernel that reaches over {window.reach} does not fit into "
            f"{window.padded(extents)}, padding included. Make the kernel smaller or pad more."
        )
    if max(math.prod(window.padded(extents)), math.prod(places)) > LARGEST:
        raise ArtifactError(
            f"node {name!r}: {window.padded(extents)} with padding is more than {LARGEST} numbers. "
            "Correct the padding or the shape of the input."
        )
    return places


def whole_numbers(name: str, field: str, value: object, axes: int, least: int) -> Shape:
    """One whole number for each axis, given for each or once for all."""
    found = np.asarray(value)
    if found.dtype.kind not in "iu" or found.shape not in {(), (1,), (axes,)} or not found.size:
        raise ArtifactError(
            f"node {name!r}: {field} is {_short(value)}; it must be whole numbers, one or {axes}. "
            "Correct the node."
        )
    if found.min() < least:
        raise ArtifactError(
            f"node {name!r}: {field} holds {found.min()}; it must be {least} or more. "
            "Correct the node."
        )
    return tuple(int(n) for n in np.broadcast_to(found, (axes,)))


def _padding(
    name: str, padding: str, kernel: Shape, stride: Shape, dilation: Shape
) -> tuple[tuple[int, int], ...]:
    """The zeros that a word stands for; an odd one goes behind, as in torch."""
    if padding == "valid":
        return tuple((0, 0) for _ in kernel)
    if padding != "same":
        raise ArtifactError(
            f"node {name!r}: padding is {padding[:20]!r}; it must be 'same', 'valid' or whole "
            "numbers. Correct the node."
        )
    if max(stride) > 1:
        raise ArtifactError(
            f"node {name!r}: padding 'same' with stride {stride} means different things to "
            "different tools. Write the padding as whole numbers."
        )
    spare = [d * (k - 1) for k, d in zip(kernel, dilation, strict=True)]
    return tuple((n // 2, n - n // 2) for n in spare)


def _short(value: object) -> str:
    return str(value.tolist() if isinstance(value, np.ndarray) else value)[:40]
