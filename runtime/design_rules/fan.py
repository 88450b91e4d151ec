"""Fans: how many synapses leave each source and reach each target of a map without a state."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.graph.shapes import (
    CONVOLUTIONS,
    DENSE,
    POOLS,
    ConvWindow,
    convolution_window,
    pool_window,
)

Counts = NDArray[np.int64]
_WITH_A_FAN = (*DENSE, *CONVOLUTIONS, *POOLS)


@dataclass(frozen=True, eq=False)
class SynapseCounts:
    """The synapses from M sources to N targets.

    out: (M,) of each source.
    into: (N,) of each target.
    weight: (M, N) where they are listed; None where they are not (convolutions), or no longer.
    largest: greatest magnitude among their weights.
    biased: whether a map between them adds something in every timestep.
    delayed: whether a Delay is between them.
    late: whether the way closes a loop.
    most: whether the counts are the most that it can be: two maps in a row, whose product is not
        made.
    maps: names of the nodes between them that have a fan or flatten.
    """

    out: Counts
    into: Counts
    weight: NDArray[Any] | None = None
    largest: float = 1.0
    biased: bool = False
    delayed: bool = False
    late: bool = False
    most: bool = False
    maps: tuple[str, ...] = ()

    @property
    def synapses(self) -> int:
        """All of them."""
        return int(self.into.sum())

    def in_blocks(self, block: int, lists: int) -> list[Counts]:
        """(M, k) synapses of each source in each block of targets; of 2 lists, one for each sign.

        Where synapses are listed.
        """
        targets = self.into.size
        starts = np.arange(0, targets, block)
        ends = np.minimum(starts + block, targets)
        counts = [
            np.subtract(before[ends], before[starts], dtype=np.int64).T for before in self._before
        ]
        return counts if lists == 2 else [counts[0] + counts[1]]

    @cached_property
    def _before(self) -> NDArray[np.int32]:
        """(2, N + 1, M) positive and negative synapses onto the targets before each.

        Added up once, because a mapping tries many blocks.
        """
        before = np.zeros((2, self.into.size + 1, self.out.size), np.int32)
        if self.weight is not None:
            np.cumsum(self.weight.T > 0, axis=0, out=before[0, 1:])
            np.cumsum(self.weight.T < 0, axis=0, out=before[1, 1:])
        return before


def one_to_one(size: int) -> SynapseCounts:
    """Every source with its own target."""
    ones = np.broadcast_to(np.int64(1), size)
    return SynapseCounts(ones, ones)


def merged(fans: Sequence[SynapseCounts]) -> SynapseCounts:
    """The ways of several fans between the same sources and targets, as one."""
    if len(fans) == 1:
        return fans[0]
    targets, sources = fans[0].into.size, fans[0].out.size
    return SynapseCounts(
        out=np.minimum(np.sum([fan.out for fan in fans], axis=0), targets),
        into=np.minimum(np.sum([fan.into for fan in fans], axis=0), sources),
        largest=sum(fan.largest for fan in fans),
        biased=any(fan.biased for fan in fans),
        delayed=any(fan.delayed for fan in fans),
        late=any(fan.late for fan in fans),
        most=True,
        maps=tuple(dict.fromkeys(name for fan in fans for name in fan.maps)),
    )


def through(fan: SynapseCounts, name: str, node: nir.NIRNode) -> SynapseCounts:
    """The fan after one more node."""
    if isinstance(node, nir.Delay):
        return replace(fan, delayed=fan.delayed or bool(node.delay.any()))
    if isinstance(node, nir.Scale):
        return replace(fan, largest=fan.largest * float(np.abs(node.scale).max()))
    if not isinstance(node, (*_WITH_A_FAN, nir.Flatten)):
        return fan
    fan = replace(fan, maps=(*fan.maps, name))
    return _composed(fan, name, node) if isinstance(node, _WITH_A_FAN) else fan


def _composed(fan: SynapseCounts, name: str, node: nir.NIRNode) -> SynapseCounts:
    alone = _one_map(name, node)
    if not _weighted(fan):
        return replace(
            alone,
            largest=fan.largest * alone.largest,
            delayed=fan.delayed,
            late=fan.late,
            maps=fan.maps,
        )
    sources, targets = fan.out.size, alone.into.size
    out = np.minimum(fan.out * alone.out.max(), targets)
    into = np.minimum(alone.into * fan.into.max(), sources)
    return replace(
        fan,
        out=out,
        into=into,
        weight=None,
        largest=fan.largest * alone.largest * float(fan.into.max()),
        biased=fan.biased or alone.biased,
        most=True,
    )


def _weighted(fan: SynapseCounts) -> bool:
    """Whether a map with a fan of its own is between them already."""
    same = fan.weight is None and not fan.most and fan.out.size == fan.into.size
    return not (same and (fan.out == 1).all() and (fan.into == 1).all())


def _one_map(name: str, node: nir.NIRNode) -> SynapseCounts:
    """The fan of one map."""
    if isinstance(node, DENSE):
        return _dense(node)
    if isinstance(node, POOLS):
        return _convolved(node, pool_window(name, node), 1, 1, 1.0, False)
    groups = int(np.ravel(node.groups)[0])
    features, channels = len(node.weight) // groups, int(node.weight.shape[1])
    largest, biased = float(np.abs(node.weight).max()), bool(node.bias.any())
    window = convolution_window(name, node)
    return _convolved(node, window, features, channels, largest, biased)


def _dense(node: nir.NIRNode) -> SynapseCounts:
    there = node.weight != 0
    if node.weight.ndim > 2:  # a stack of maps, each for its own part
        out, into = there.sum(axis=-2).ravel(), there.sum(axis=-1).ravel()
    else:
        out, into = np.count_nonzero(there, axis=0), np.count_nonzero(there, axis=1)
    biased = isinstance(node, nir.Affine) and bool(node.bias.any())
    weight = node.weight.T if node.weight.ndim == 2 else None
    return SynapseCounts(
        out, into, weight, float(np.abs(node.weight).max()), biased, most=weight is None
    )


def _convolved(
    node: nir.NIRNode,
    window: ConvWindow,
    features: int,
    channels: int,
    largest: float,
    biased: bool,
) -> SynapseCounts:
    """The fan of a kernel of features x channels of its group; zeros in it count as synapses."""
    takes, puts = (tuple(map(int, t)) for t in (_shape(node, "input"), _shape(node, "output")))
    axes = [_axis(window, axis, takes[axis + 1], puts[axis + 1]) for axis in range(len(takes) - 1)]
    seen = reduce(np.multiply.outer, [count for _, count in axes])
    used = reduce(np.multiply.outer, [count for count, _ in axes])
    out = np.broadcast_to(used * features, takes).ravel()
    into = np.broadcast_to(seen * channels, puts).ravel()
    return SynapseCounts(out, into, None, largest, biased)


def _axis(window: ConvWindow, axis: int, extent: int, places: int) -> tuple[Counts, Counts]:
    """Places that use each element of an axis, and elements that each place of it sees."""
    before, _ = window.padding[axis]
    kernel = np.arange(window.kernel[axis]) * window.dilation[axis] - before
    index = np.arange(places)[:, None] * window.stride[axis] + kernel
    inside = (index >= 0) & (index < extent)
    return np.bincount(index[inside], minlength=extent), inside.sum(axis=1)


def _shape(node: nir.NIRNode, end: str) -> Any:  # noqa: ANN401
    return (node.input_type if end == "input" else node.output_type)[end]
