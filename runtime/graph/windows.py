"""Windows of convolutions and pools: the positions of a kernel along each axis of its input.

Shape letters besides the usual: **R** rows (batch and time in one axis), **C** channels,
**X** spatial extents of the input, **P** positions of the kernel, **K** extents of the kernel.
"""

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import nir
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.metadata import whole_numbers

Shape: TypeAlias = tuple[int, ...]

CONVOLUTIONS = (nir.Conv1d, nir.Conv2d)
POOLS = (nir.SumPool2d, nir.AvgPool2d)

# values of one timestep: a node with more is taken for a mistake that would exhaust the memory
MAX_VALUES = 1 << 24


@dataclass(frozen=True)
class ConvWindow:
    """Geometry of a kernel; one number per axis, as torch.nn.functional.conv2d defines them.

    kernel: K, its elements.
    stride: distance of neighbouring positions.
    padding: zeros before and after the input.
    dilation: distance of neighbouring kernel elements.
    """

    kernel: Shape
    stride: Shape
    padding: tuple[tuple[int, int], ...]
    dilation: Shape

    @property
    def span(self) -> Shape:
        """Extents of the dilated kernel."""
        pairs = zip(self.kernel, self.dilation, strict=True)
        return tuple(dilation * (kernel - 1) + 1 for kernel, dilation in pairs)

    def padded(self, extents: Shape) -> Shape:
        """Extents X with the padding."""
        pairs = zip(extents, self.padding, strict=True)
        return tuple(extent + sum(padding) for extent, padding in pairs)

    def positions(self, extents: Shape) -> Shape:
        """P of each axis for extents X; 0 or less where the kernel does not fit."""
        axes = zip(self.padded(extents), self.span, self.stride, strict=True)
        return tuple((extent - span) // stride + 1 for extent, span, stride in axes)

    def view(self, x: NDArray[Any]) -> NDArray[Any]:
        """The input under the kernel, (R, C, *P, *K) of x (R, C, *X); a view unless x is padded."""
        if any(map(any, self.padding)):
            x = np.pad(x, ((0, 0), (0, 0), *self.padding))
        windows = sliding_window_view(x, self.span, axis=tuple(range(2, x.ndim)))
        whole = (slice(None), slice(None))
        steps = tuple(slice(None, None, step) for step in (*self.stride, *self.dilation))
        return np.asarray(windows[whole + steps])


def convolution_window(name: str, node: nir.NIRNode) -> ConvWindow:
    """The window of a Conv1d or Conv2d; ArtifactError where its fields are not one."""
    axes = 1 if isinstance(node, nir.Conv1d) else 2
    kernel = tuple(map(int, node.weight.shape[2:]))
    stride = whole_numbers(name, "stride", node.stride, axes, minimum=1)
    dilation = whole_numbers(name, "dilation", node.dilation, axes, minimum=1)
    if not isinstance(node.padding, str):
        around = whole_numbers(name, "padding", node.padding, axes, minimum=0)
        return ConvWindow(kernel, stride, tuple((n, n) for n in around), dilation)
    return ConvWindow(
        kernel, stride, _padding(name, node.padding, kernel, stride, dilation), dilation
    )


def pool_window(name: str, node: nir.NIRNode) -> ConvWindow:
    """The window of a SumPool2d or AvgPool2d; ArtifactError where its fields are not one."""
    kernel = whole_numbers(name, "kernel_size", node.kernel_size, 2, minimum=1)
    stride = whole_numbers(name, "stride", node.stride, 2, minimum=1)
    around = whole_numbers(name, "padding", node.padding, 2, minimum=0)
    return ConvWindow(kernel, stride, tuple((n, n) for n in around), (1, 1))


def checked_positions(name: str, window: ConvWindow, extents: Shape) -> Shape:
    """P of each axis; ArtifactError where the kernel does not fit, or values are too many."""
    positions = window.positions(extents)
    if min(positions) < 1:
        raise ArtifactError(
            f"node {name!r}: a kernel of extent {window.span} does not fit into "
            f"{window.padded(extents)}, padding included. Make the kernel smaller or pad more."
        )
    if max(math.prod(window.padded(extents)), math.prod(positions)) > MAX_VALUES:
        raise ArtifactError(
            f"node {name!r}: {window.padded(extents)} with padding is more than {MAX_VALUES} "
            "values. Correct the padding or the shape of the input."
        )
    return positions


def _padding(
    name: str, padding: str, kernel: Shape, stride: Shape, dilation: Shape
) -> tuple[tuple[int, int], ...]:
    """Zeros before and after each axis for "valid" or "same"; the odd one goes after."""
    if padding == "valid":
        return tuple((0, 0) for _ in kernel)
    if padding != "same":
        raise ArtifactError(
            f"node {name!r}: padding is {padding[:20]!r}; it must be 'same', 'valid' or whole "
            "numbers. Correct the node."
        )
    if max(stride) > 1:
        raise ArtifactError(
            f"node {name!r}: padding 'same' with stride {stride} differs between tools. Write the "
            "padding as whole numbers."
        )
    total = [d * (k - 1) for k, d in zip(kernel, dilation, strict=True)]
    return tuple((n // 2, n - n // 2) for n in total)
