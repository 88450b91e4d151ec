"""Chains of maps without spikes between them, as the synapses that they come to.

A chain that has synapses of its own is at most a pool without overlap, then at most one map (a
convolution, another pool, or an affine map), and scales, delays and changes of shape around them.
An affine map comes to a matrix, or behind a pool to a kernel as large as its input; all others come
to a kernel and its window. A weight is what a unit impulse of its source brings to its target, in
the order in which the chain multiplies.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.window import Window
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE, POOLS, Shape, window_of

Floats: TypeAlias = NDArray[np.float64]
Maps: TypeAlias = tuple[int, int, int]
Chain: TypeAlias = Sequence[tuple[str, nir.NIRNode]]


def weights_of(chain: Chain, source: Shape) -> tuple[Floats, Window | None] | None:
    """The weights of a chain, with their window if they are a kernel; None if it has none such.

    chain: names and nodes from the source to the target, which are none of it.
    source: shape of what it takes.
    """
    head, rest = _read_head(chain, source)
    if head is None:
        return None
    (name, node), *tail = rest or [("", None)]
    if not all(isinstance(each, nir.Scale) for _, each in tail):
        return None
    scales = [np.ravel(each.scale).astype(np.float64) for _, each in tail]
    if isinstance(node, DENSE):
        return _affine(node, head, scales)
    return _kernel(name, node, head, scales)


class _Head(NamedTuple):
    """What a chain does before its map.

    source, maps: shapes in front of the pool and behind it.
    pool: by which coordinates are divided.
    scale: of each element of the maps, in C order.
    """

    source: Maps
    maps: Maps
    pool: tuple[int, int]
    scale: Floats

    def of_channels(self) -> Floats | None:
        """Scales (C,) of the channels; None where they differ in one."""
        return _alike(self.scale, self.maps[0])


def _alike(values: Floats, channels: int) -> Floats | None:
    each = values.reshape(channels, -1)
    return np.asarray(each[:, 0]) if (each == each[:, :1]).all() else None


def _read_head(chain: Chain, source: Shape) -> tuple[_Head | None, Chain]:
    """Scales and pools without overlap at the beginning of a chain, and the rest of it."""
    maps = [each for each in chain if not isinstance(each[1], (nir.Flatten, nir.Delay))]
    first = _maps(source)
    head = _Head(first, first, (1, 1), np.ones(math.prod(source)))
    for place, (name, node) in enumerate(maps):
        takes = head.maps if isinstance(node, (nir.Scale, *DENSE)) else _shape(node, "input")
        if head.pool == (1, 1):  # shapes may change until the pool
            head = head._replace(source=takes, maps=takes)
        elif takes != head.maps:
            return None, ()
        if isinstance(node, nir.Scale):
            head = head._replace(scale=head.scale * np.ravel(node.scale).astype(np.float64))
        elif isinstance(node, POOLS) and _is_division(name, node):
            if (each := head.of_channels()) is None:
                return None, ()
            y, x = window_of(name, node).kernel
            each = each / (y * x) if isinstance(node, nir.AvgPool2d) else each
            puts = _shape(node, "output")
            pool = head.pool[0] * y, head.pool[1] * x
            head = head._replace(maps=puts, pool=pool, scale=each.repeat(math.prod(puts[1:])))
        else:
            return head, maps[place:]
    return head, ()


def _affine(
    node: nir.NIRNode, head: _Head, scales: Sequence[Floats]
) -> tuple[Floats, Window | None] | None:
    if node.weight.ndim != 2:
        return None
    weight = node.weight.astype(np.float64) * head.scale
    for scale in scales:
        weight = weight * scale[:, None]
    # + 0.0: as a sum has it, no zero is negative
    weight = weight + 0.0
    if head.pool == (1, 1):
        return np.ascontiguousarray(weight.T), None
    features, maps = len(weight), head.maps
    window = Window(head.source, (features, 1, 1), kernel=maps[1:], pool=head.pool)
    return weight.reshape(features, *maps), window


def _kernel(
    name: str, node: nir.NIRNode | None, head: _Head, scales: Sequence[Floats]
) -> tuple[Floats, Window | None] | None:
    """The kernel of a convolution or pool; without a node, of the head alone."""
    each = head.of_channels()
    if node is None and each is None and head.pool == (1, 1):  # one to one, a scale of each
        size = math.prod(head.maps)
        head, each = _Head((size, 1, 1), (size, 1, 1), (1, 1), head.scale), head.scale
    if each is None:
        return None
    if node is None:
        window = Window(head.source, head.maps, (1, 1), head.pool, groups=head.maps[0])
    else:
        window = replace(window_of_map(name, node), source=head.source, pool=head.pool)
    (features, *_), groups = window.target, window.groups
    weight: Floats = np.ones((features, 1, *window.kernel))
    if isinstance(node, CONVOLUTIONS):
        weight = node.weight.astype(np.float64).reshape(features, -1, *window.kernel)
    # weights of a group see its channels alone
    parted = weight.reshape(groups, -1, *weight.shape[1:]) * each.reshape(groups, 1, -1, 1, 1)
    weight = parted.reshape(weight.shape)
    if isinstance(node, nir.AvgPool2d):
        weight = weight / math.prod(weight.shape[2:])
    for scale in scales:
        if (after := _alike(scale, features)) is None:
            return None
        weight = weight * after[:, None, None, None]
    # what only padding comes under is no weight
    rows, columns = window.seen
    used = np.logical_and.outer(rows.any(axis=0), columns.any(axis=0))
    return weight * used + 0.0, window


def window_of_map(name: str, node: nir.NIRNode) -> Window:
    """The window of a convolution or pool."""
    geometry, source = window_of(name, node), _shape(node, "input")
    return Window(
        source=source,
        target=_shape(node, "output"),
        kernel=_axes(geometry.kernel),
        stride=_axes(geometry.stride),
        padding=_axes(tuple(before for before, _ in geometry.padding), 0),
        dilation=_axes(geometry.dilation),
        groups=int(node.groups) if isinstance(node, CONVOLUTIONS) else source[0],
    )


def _is_division(name: str, node: nir.NIRNode) -> bool:
    """True for a pool whose positions neither overlap nor leave anything out between them."""
    window = window_of(name, node)
    return window.stride == window.kernel and not any(map(any, window.padding))


def _shape(node: nir.NIRNode, end: str) -> Maps:
    types = node.input_type if end == "input" else node.output_type
    return _maps(tuple(int(n) for n in types[end]))


def _maps(shape: Shape) -> Maps:
    """A shape of any axes as channels and two axes: (C, X) as (C, 1, X), more than three joined."""
    if len(shape) < 3:
        return shape[0], 1, math.prod(shape[1:])
    return math.prod(shape[:-2]), shape[-2], shape[-1]


def _axes(numbers: Shape, missing: int = 1) -> tuple[int, int]:
    """Numbers (y, x) of two axes; those of one are x."""
    y, x = (missing, *numbers)[-2:]
    return y, x
