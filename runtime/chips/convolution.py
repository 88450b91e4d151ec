"""Synapses of a convolution: one kernel that all positions share, in place of their matrix.

Shape letters besides the usual: **C** channels of the source, **O** of the target, **G** groups,
**I** = C / G channels that a kernel sees, **Y**, **X** extents, **K** = (ky, kx) of the kernel.

What arrives at the position (oy, ox) of a target's channel o, of the pooled source s:

    sum over i, ky, kx of weight[o, i, ky, kx] s[i, oy sy + ky dy - py, ox sx + kx dx - px]

as torch.nn.functional.conv2d defines it. A source and a target share at most one weight.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import DTypeLike, NDArray

Numbers = NDArray[Any]
Places = NDArray[np.int64]
Axes = tuple[int, int]

# numbers that are written for each weight that is added: its place, if it is inside, itself, the
# sum; of a window that is unfolded one for each element
_PER_ADDITION = 4
# bytes of the windows that are unfolded at once
_UNFOLDED = 1 << 25


@dataclass(frozen=True)
class Window:
    """The synapses that a kernel (O, I, ky, kx) stands for.

    source: (C, Y, X) of what sends, in C order; Y is 1 where there is one axis.
    target: (O, Y, X) of what receives, likewise.
    pool: (y, x) by which the coordinates of a spike are divided first, rounded down, as in a sum
        pool without overlap; spikes of rows and columns left over reach nothing. (1, 1) is none.
    stride: (y, x) distance of neighbouring positions in the pooled source.
    padding: (top, left) zeros around it; those below and on the right follow from the target.
    dilation: (y, x) distance of neighbouring elements of the kernel.
    groups: G into which channels are divided, each with targets of its own.
    kernel: (y, x) extents of the kernel.
    """

    source: tuple[int, int, int]
    target: tuple[int, int, int]
    kernel: Axes
    pool: Axes = (1, 1)
    stride: Axes = (1, 1)
    padding: Axes = (0, 0)
    dilation: Axes = (1, 1)
    groups: int = 1

    @property
    def shape(self) -> tuple[int, int]:
        """Axons M and neurons N."""
        return math.prod(self.source), math.prod(self.target)

    @property
    def pooled(self) -> tuple[int, int, int]:
        """(C, Y, X) of the source behind the pool."""
        channels, *extents = self.source
        y, x = (extent // pool for extent, pool in zip(extents, self.pool, strict=True))
        return channels, y, x

    @property
    def is_one_to_one(self) -> bool:
        """True if each axon is the only one of the neuron of its number."""
        one = (1, 1)
        return (
            self.source == self.target
            and self.kernel == self.pool == self.stride == one
            and (self.padding == (0, 0) and self.groups == self.source[0])
        )

    @cached_property
    def reach(self) -> tuple[Places, Places]:
        """Position that a pooled row (Y, ky), or column (X, kx), reaches by each element; or -1."""
        found = []
        for axis in (0, 1):
            # i = o stride + k dilation - padding
            at = np.arange(self.pooled[1 + axis])[:, None] + self.padding[axis]
            ahead = at - np.arange(self.kernel[axis]) * self.dilation[axis]
            place, rest = np.divmod(ahead, self.stride[axis])
            inside = (rest == 0) & (place >= 0) & (place < self.target[1 + axis])
            found.append(np.where(inside, place, -1))
        return found[0], found[1]

    def fan_out(self, weight: Numbers) -> NDArray[np.int64]:
        """(M,) non-zero weights of each axon."""
        some = self.by_source(weight != 0).sum(axis=1, dtype=np.int64)  # (C, ky, kx)
        rows, columns = (place >= 0 for place in self.reach)
        reached = np.einsum("ckl,yk,xl->cyx", some, rows, columns, optimize=True)
        (_, y, x), (py, px) = self.pooled, self.pool
        out = np.zeros(self.source, np.int64)
        out[:, : y * py, : x * px] = reached.repeat(py, axis=1).repeat(px, axis=2)
        return out.ravel()

    def over_axons(self, values: Numbers, reduce: np.ufunc) -> Numbers:
        """Sum or maximum (N,) over the axons of each neuron, of values of the kernel.

        values: (O, I, ky, kx), none below 0.
        reduce: np.add or np.maximum.
        """
        rows, columns = self.seen
        each = reduce.reduce(values, axis=1)
        each = reduce.reduce(each[:, :, None] * columns, axis=3)  # (O, ky, X)
        each = reduce.reduce(each[:, None] * rows[:, :, None], axis=2)
        return np.ravel(each * math.prod(self.pool) if reduce is np.add else each)

    def of_channels(self, values: Numbers) -> Numbers | None:
        """Numbers (N,) of the neurons as (O, 1, 1, 1); None where those of a channel differ."""
        each = values.reshape(self.target[0], -1)
        return each[:, :1, None, None] if (each == each[:, :1]).all() else None

    def row(self, weight: Numbers, axon: int) -> tuple[Places, Numbers]:
        """Neurons (k,) in ascending order that an axon reaches, and its weights (k,), zeros too."""
        channel, y, x = (int(n) for n in np.unravel_index(axon, self.source))
        y, x = y // self.pool[0], x // self.pool[1]
        if y >= self.pooled[1] or x >= self.pooled[2]:
            return np.zeros(0, np.int64), weight[:0, 0, 0, 0]
        rows, columns = self.reach[0][y], self.reach[1][x]
        # positions descend while elements of the kernel ascend
        ky, kx = (np.flatnonzero(places >= 0)[::-1] for places in (rows, columns))
        kernel = self.by_source(weight)[channel][:, ky[:, None], kx]
        places = self._features(channel)[:, None, None] * math.prod(self.target[1:])
        places = places + rows[ky][:, None] * self.target[2] + columns[kx]
        return places.ravel(), kernel.ravel()

    def dense(self, weight: Numbers) -> Numbers:
        """The matrix (M, N)."""
        matrix = np.zeros(self.shape, weight.dtype)
        for axon, row in enumerate(matrix):
            places, weights = self.row(weight, axon)
            row[places] = weights
        return matrix

    def sums(self, weight: Numbers, spikes: Numbers, dtype: DTypeLike = np.float64) -> Numbers:
        """Sums (..., N) of the weights that spikes (..., M) bring; of whole numbers exact.

        Few spikes add their weights one by one; for many, windows become rows of a matrix.
        """
        maps = self._divide(spikes)
        shape = (*spikes.shape[:-1], self.shape[1])
        features, elements = self.target[0] // self.groups, math.prod(self.kernel)
        additions = np.count_nonzero(maps) * features * elements
        unfolded = maps.shape[0] * maps.shape[1] * math.prod(self.target[1:]) * elements
        if additions * _PER_ADDITION <= unfolded:
            return self._scatter(weight, maps).astype(dtype, copy=False).reshape(shape)
        some = max(1, _UNFOLDED // (8 * unfolded // len(maps)))
        parts = [
            self._multiply(weight, maps[k : k + some], dtype) for k in range(0, len(maps), some)
        ]
        return np.concatenate(parts).reshape(shape)

    def by_source(self, values: Numbers) -> Numbers:
        """Values (O, I, ky, kx) of the kernel by channels of the source, (C, O / G, ky, kx)."""
        parted = values.reshape(self.groups, -1, *values.shape[1:]).swapaxes(1, 2)
        return np.asarray(parted.reshape(self.source[0], -1, *self.kernel))

    def _scatter(self, weight: Numbers, maps: Numbers) -> Numbers:
        """(B, N) sums, to which each of the events of maps (B, *pooled) adds its weights."""
        batch, channel, y, x = np.nonzero(maps)
        rows, columns = self.reach[0][y], self.reach[1][x]
        first = batch * self.target[0] + self._features(channel).T  # (O / G, events)
        place = (first[..., None] * self.target[1] + rows)[..., None] * self.target[2]
        place = place + columns[:, None]  # (O / G, events, ky, kx)
        there = (rows >= 0)[..., None] & (columns >= 0)[:, None]
        count = maps[batch, channel, y, x][:, None, None, None]
        brought = (self.by_source(weight)[channel] * count).swapaxes(0, 1)
        size = len(maps) * self.shape[1]
        sums = np.bincount(place[:, there].ravel(), brought[:, there].ravel(), minlength=size)
        return sums.reshape(len(maps), -1)

    def _multiply(self, weight: Numbers, maps: Numbers, dtype: DTypeLike) -> Numbers:
        """(B, N) sums of maps (B, *pooled) as a product of their windows and the kernel."""
        spans = [d * (k - 1) + 1 for d, k in zip(self.dilation, self.kernel, strict=True)]
        padded = np.zeros((*maps.shape[:2], *map(self._extent, (0, 1))), dtype)
        (top, left), (_, _, height, width) = self.padding, padded.shape
        y, x = (
            min(n, m - p)
            for n, m, p in zip(maps.shape[2:], (height, width), (top, left), strict=True)
        )
        padded[:, :, top : top + y, left : left + x] = maps[:, :, :y, :x]
        (sy, sx), (dy, dx) = self.stride, self.dilation
        seen = sliding_window_view(padded, spans, axis=(2, 3))[:, :, ::sy, ::sx, ::dy, ::dx]
        # (B, G, I, Y, X, ky, kx) to (B, G, Y X, I ky kx)
        parted = seen.reshape(len(maps), self.groups, -1, *seen.shape[2:]).transpose(
            0, 1, 3, 4, 2, 5, 6
        )
        rows = parted.reshape(*parted.shape[:2], math.prod(self.target[1:]), -1)
        kernel = weight.reshape(self.groups, -1, rows.shape[-1]).swapaxes(1, 2).astype(dtype)
        return np.asarray((rows @ kernel).swapaxes(2, 3).reshape(len(maps), -1))

    def _extent(self, axis: int) -> int:
        """Extent of what the positions of an axis see, padding included."""
        last = (self.target[1 + axis] - 1) * self.stride[axis]
        return last + self.dilation[axis] * (self.kernel[axis] - 1) + 1

    def _divide(self, spikes: Numbers) -> Numbers:
        """Spikes (..., M) behind the pool, (B, *pooled)."""
        maps = spikes.reshape(-1, *self.source)
        if self.pool == (1, 1):
            return maps
        (channels, y, x), (py, px) = self.pooled, self.pool
        # rows and columns left over are cut
        maps = maps[:, :, : y * py, : x * px].reshape(-1, channels, y, py, x, px)
        return np.asarray(maps.sum(axis=(3, 5)))

    @property
    def seen(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Masks (Y, ky) and (X, kx): elements of the kernel inside the source at each position."""
        found = []
        for axis in (0, 1):
            at = np.arange(self.target[1 + axis])[:, None] * self.stride[axis]
            at = at + np.arange(self.kernel[axis]) * self.dilation[axis] - self.padding[axis]
            found.append((at >= 0) & (at < self.pooled[1 + axis]))
        return found[0], found[1]

    def _features(self, channel: int | Places) -> Places:
        """Channels (..., O / G) of the target that a channel of the source reaches."""
        each = self.target[0] // self.groups
        group = np.asarray(channel) // (self.source[0] // self.groups)
        return np.asarray(group[..., None] * each + np.arange(each))
