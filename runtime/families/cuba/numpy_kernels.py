"""The NumPy kernels: a layer's window of timesteps in few calls, equal to the interpreter.

States are float64, which holds 24-bit states and their products with 12-bit decays exactly, and
needs two calls where integers need five: trunc(x * decay) is the decay toward zero. Overflow is not
checked in every timestep: either the bounds prove that no number can be too large, or that so few
spikes cannot make one, or the states are looked at afterwards. A window that did overflow, which is
rare, is computed once more by the interpreter.

Spikes become sums of weights in three ways. Which is fastest depends on how many spikes there are
and where; a fixed rule on their density chooses. All ways sum whole numbers that their number type
is proven to hold exactly, so they agree bit for bit, in any order of summation and on any BLAS.
(`ideal` has no whole numbers and always multiplies in float64, timesteps and batch in one matrix.)
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState
from spikedeploy.runtime.chips.registers import magnitude
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import SavedState
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.neurons import update
from spikedeploy.runtime.families.cuba.quantise import (
    Bounds,
    bounds,
    exact_ticks,
    register_limit,
    spikes_without_overflow,
)

Floats = NDArray[Any]
Weights = NDArray[Any]
Bits = NDArray[np.bool_]


class Raster:
    """Spikes (T, B, M) of one source in a window, and counts of them, each found once.

    rows: uint8 or bool, 0 or 1.
    bits: the same in bool, on which NumPy searches and counts faster than on numbers.
    """

    __slots__ = ("_axons", "_per_axon", "_spikes", "bits", "rows")

    def __init__(self, rows: NDArray[Any]) -> None:
        self.rows = rows
        self.bits = rows.view(np.bool_) if rows.dtype.itemsize == 1 else rows.astype(np.bool_)
        self._axons: NDArray[np.intp] | None = None
        self._per_axon: NDArray[Any] | None = None
        self._spikes = -1

    def spikes(self) -> int:
        """Number of spikes."""
        if self._spikes < 0:
            self._spikes = int(np.count_nonzero(self.bits))
        return self._spikes

    def axons(self) -> NDArray[np.intp]:
        """Indices of the axons that spiked at least once; batch 1."""
        if self._axons is None:
            self._axons = np.logical_or.reduce(self.bits.squeeze(1), 0).nonzero()[0]
        return self._axons

    def per_axon(self) -> NDArray[Any]:
        """(B, M) spikes of each axon."""
        if self._per_axon is None:
            # eight bits hold the counts of a short window, and are summed several times faster
            dtype = np.uint8 if len(self.rows) < 256 else np.int64
            self._per_axon = np.add.reduce(self.rows, 0, dtype)
        return self._per_axon


# memory


# [bytes] of a cache line; large arrays of NumPy begin 16 bytes after one, which costs a fifth
LINE = 64


def aligned(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Zeros that begin with a cache line."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.zeros(size + LINE, np.uint8)
    start = -raw.ctypes.data % LINE
    return raw[start : start + size].view(dtype).reshape(shape)


def as_aligned(values: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    """A copy of the values that begins with a cache line."""
    copy = aligned(values.shape, dtype)
    np.copyto(copy, values, casting="unsafe")
    return copy


class Scratch:
    """Memory that one user after another fills; nothing in it lasts.

    size: [bytes] of the largest array that is needed.
    """

    def __init__(self, size: int) -> None:
        self._bytes = aligned((size,), np.uint8)

    def like(self, array: NDArray[Any]) -> NDArray[Any]:
        """An array of the same shape and type, in the memory that all share."""
        return self._bytes[: array.nbytes].view(array.dtype).reshape(array.shape)


# from spikes to sums of weights


# largest magnitudes up to which every whole number is held
_EXACT_FLOAT32 = 1 << 24
EXACT_INT16 = (1 << 15) - 1

# the rule, from the measurements in docs/performance.md: at batch 1, matrices of at least so many
# weights are not multiplied whole, but
SMALL = 1 << 15
# only the rows of axons that spike in the window, while those are no larger a part of all,
FEW = 0.4
# or rows are added one by one, in matrices of at least so many weights, while such an axon spikes
# no more often in the mean
LARGE, _SELDOM = 1 << 17, 2.5

# fills the memory that it was made for with the sums of a raster, those of an axon that always
# spikes included [state units]
Summation: TypeAlias = Callable[[Raster], None]


def choose_summation(
    weight: Weights, bias: Weights, partial: int | None, unit: int, out: Floats, scratch: Scratch
) -> Summation:
    """The exact way for a layer, or the choice among them.

    weight: (M, N).
    bias: (N,) weights of the axon that always spikes; (T, 1, N) where it does not always.
    partial: largest magnitude of any partial sum; None where weights are no whole numbers.
    unit: state units per weight unit.
    out: (T, B, N) where the sums are wanted.
    scratch: for as many float64 as there are weights.
    """
    exact32 = partial is not None and partial * unit < _EXACT_FLOAT32
    dtype = np.float32 if exact32 else np.float64
    scaled, pull = as_aligned(weight * float(unit), dtype), (bias * float(unit)).astype(dtype)
    dense = Matmul(scaled, pull, out)
    if partial is None or out.shape[1] > 1 or weight.size < SMALL:
        return dense
    large = weight.size >= LARGE
    gather = make_gather(weight, bias, partial, unit, out, scratch) if large else None
    return AutoSum(gather, ActiveRows(scaled, pull, out, scratch), dense)


def make_gather(
    weight: Weights, bias: Weights, partial: int, unit: int, out: Floats, scratch: Scratch
) -> "SparseSum":
    """Gather with numbers as small as the bounds allow; arguments as in summing."""
    whole = np.int16 if partial <= EXACT_INT16 else np.int32
    return SparseSum(as_aligned(weight, whole), bias.astype(whole), unit, out, scratch)


class Matmul:
    """All axons times all weights: one matrix product for the window."""

    def __init__(self, weight: Weights, bias: Weights, out: Floats) -> None:
        self.weight = weight
        timesteps, batch, neurons = out.shape
        # matrices over the same memory: BLAS wants two axes
        self._spikes = aligned((timesteps, batch, len(weight)), weight.dtype)
        self._flat = self._spikes.reshape(-1, len(weight))
        self._product = _Product(weight, bias, out.reshape(-1, neurons))

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        np.copyto(self._spikes, raster.rows)
        self._product(self._flat, self.weight)


class ActiveRows:
    """Only the weights of axons that spiked at least once, in one small product; batch 1.

    Best where the same axons spike again and again, as those of a population code do.
    """

    def __init__(self, weight: Weights, bias: Weights, out: Floats, scratch: Scratch) -> None:
        self._weight, self._fetched = weight, scratch.like(weight)
        self._product = _Product(weight, bias, out.squeeze(1))

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        axons = raster.axons()
        spikes = raster.rows.squeeze(1).take(axons, 1).astype(self._weight.dtype)
        # "clip" never has anything to clip here, and needs no second buffer
        self._product(spikes, self._weight.take(axons, 0, self._fetched[: len(axons)], "clip"))


class SparseSum:
    """Only the weights of axons that spiked, timestep by timestep; batch 1.

    Cost grows with the number of spikes; with int16 it has the fewest bytes to fetch.
    """

    def __init__(
        self, weight: Weights, bias: Weights, unit: int, out: Floats, scratch: Scratch
    ) -> None:
        self.weight = weight
        self._out, self._unit = out, out.dtype.type(unit)
        self._sums = aligned(out.shape, weight.dtype)
        self._bias = _spread_bias(self._sums, bias)
        self._rows = list(self._sums.squeeze(1))
        self._fetched = scratch.like(weight)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        take, add, fetched = self.weight.take, np.add.reduce, self._fetched
        for spikes, row in zip(raster.bits.squeeze(1), self._rows, strict=True):
            axons = spikes.nonzero()[0]
            add(take(axons, 0, fetched[: len(axons)], "clip"), 0, None, row)
        if self._bias is not None:
            np.add(self._sums, self._bias, self._sums)
        np.multiply(self._sums, self._unit, self._out)


class AutoSum:
    """The way that the density of the spikes makes fastest; batch 1.

    gather: only where the matrix is large.
    """

    def __init__(self, gather: SparseSum | None, union: ActiveRows, dense: Matmul) -> None:
        self.gather, self.union, self.dense = gather, union, dense
        self._few = FEW * len(dense.weight)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        axons = len(raster.axons())
        if axons <= self._few:
            self.union(raster)
        elif self.gather is not None and raster.spikes() <= _SELDOM * axons:
            self.gather(raster)
        else:
            self.dense(raster)


class _Product:
    """A product of spikes and weights, with the bias, in memory `out` of another number type."""

    def __init__(self, weight: Weights, bias: Weights, out: Floats) -> None:
        self._out = out
        # the place itself if its number type is that of the weights
        self._sums = out if out.dtype == weight.dtype else aligned(out.shape, weight.dtype)
        self._bias = _spread_bias(self._sums, bias)

    def __call__(self, spikes: Floats, weight: Weights) -> None:
        spikes.dot(weight, self._sums)
        if self._bias is not None:
            np.add(self._sums, self._bias, self._sums)
        if self._sums is not self._out:
            np.copyto(self._out, self._sums)


def _spread_bias(like: Weights, bias: Weights) -> Weights | None:
    """The bias on every row: arrays of one shape are added in half the time; None adds nothing."""
    if not bias.any():
        return None
    if bias.ndim > 1:  # of each timestep its own, for all of the batch
        copies = like.size // bias.size
        bias = np.broadcast_to(bias, (len(bias), copies, bias.shape[-1])).reshape(like.shape)
    return np.broadcast_to(bias, like.shape).astype(like.dtype)


# from sums to spikes


# from so many neurons on two calls without a branch are faster than putmask
_WIDE = 4096
_ALL = slice(None)


class LayerKernel:
    """One layer, ready to run windows of T timesteps for a batch of B, in the same memory.

    fixed: the integers of the chip; None computes in float64.
    biased: rows of a window in which the bias axon spikes.
    states: (T + 1, 2, B, N) current and membrane, before the window and after each timestep.
    spikes: (T, B, N) of the last window.
    waiting: whether the layer had not started in the last window.
    interpreted: whether the interpreter had to run the last window; only then are there
    overflows: (B,) numbers that did not fit their register.
    """

    def __init__(
        self,
        program: Program,
        layer: Layer,
        fixed: CubaFixedPoint | None,
        shape: tuple[int, int],
        kept: bool,
        scratch: Scratch,
        biased: slice = _ALL,
    ) -> None:
        self._program, self.layer, self._fixed, self._kept = program, layer, fixed, kept
        timesteps, batch = shape
        self.spikes = np.zeros((timesteps, batch, layer.size), np.bool_)
        self.overflows = np.zeros(batch, np.int64)
        self.waiting = self.interpreted = False
        self.states = aligned((timesteps + 1, 2, batch, layer.size), np.float64)
        self._refractory = np.zeros((batch, layer.size), np.int64)
        self._sums = aligned(self.spikes.shape, np.float64)
        self._check, partial = None, None
        if fixed:
            # of a window from zero, or of states that are kept
            window = None if kept else timesteps
            limits = bounds(program, layer, fixed, window)
            self._check = _OverflowCheck(layer, fixed, limits, window)
            partial = limits.partial
        self._unit = unit = 1 << fixed.mantissa_shift if fixed else 1
        self._more = aligned(self._sums.shape, np.float64)
        biases = [_biases(layer, biased, timesteps), *[0 * layer.bias] * (len(layer.synapses) - 1)]
        self._first, *self._others = (
            choose_summation(
                s.weight, bias, partial, unit, self._more if k else self._sums, scratch
            )
            for k, (s, bias) in enumerate(zip(layer.synapses, biases, strict=True))
        )
        subtract = program.convention.reset == "subtract"
        self._update = NeuronUpdate(
            layer, fixed, self.states, self._sums, self.spikes, kept, subtract
        )

    def reset(self) -> None:
        """Forget the state."""
        self.states[-1] = 0.0
        self._refractory[:] = 0

    @property
    def ordinary(self) -> bool:
        """True where the last window ran, and not in the interpreter."""
        return not (self.waiting or self.interpreted)

    def run(self, presynaptic: Sequence[Raster]) -> Raster:
        """Spikes of the window, from those that arrive through each synapses of the layer."""
        self.waiting = self.interpreted = False
        if self._kept:
            self.states[0] = self.states[-1]
        self._first(presynaptic[0])
        for index, summation in enumerate(self._others, start=1):
            summation(presynaptic[index])
            np.add(self._sums, self._more, self._sums)
        self._update()
        if self._check is not None and not self._check.fits(self.states, presynaptic):
            self._interpret(self._check.fixed)
        return Raster(self.spikes)

    def wait(self) -> Raster:
        """No spikes, because the layer has not started."""
        self.waiting, self.interpreted = True, False
        self.spikes.fill(False)
        return Raster(self.spikes)

    def saved(self) -> SavedState:
        """Copies of the states, and of the timesteps of refractory left."""
        return {"states": self.states[-1].copy(), "refractory": self._refractory.copy()}

    def restore(self, saved: SavedState) -> None:
        """Continue from there."""
        self.states[-1] = saved["states"]
        self._refractory = saved["refractory"].copy()

    def _interpret(self, fixed: CubaFixedPoint) -> None:
        """The window once more, by the specification."""
        self.interpreted = True
        before = self.states[0].astype(np.int64)
        state = LayerState(before[0], before[1], self._refractory)
        self.overflows.fill(0)
        for row, weights in enumerate(np.asarray(self._sums / self._unit, np.int64)):
            result = update(fixed, self._program.convention, self.layer, weights, state)
            self.states[row + 1] = state.current, state.membrane
            self.spikes[row] = result.spikes
            self.overflows += result.overflows.sum(axis=1)
        if self._kept:
            self._refractory = state.refractory


def _biases(layer: Layer, biased: slice, timesteps: int) -> NDArray[Any]:
    """Weights of the bias axon: (N,), or (T, 1, N) where it spikes in some timesteps alone."""
    if range(timesteps)[biased] == range(timesteps):
        return layer.bias
    biases = np.zeros((timesteps, 1, layer.size), layer.bias.dtype)
    biases[biased] = layer.bias
    return biases


class NeuronUpdate:
    """The neurons of a layer in the timesteps of a window, one after another, in few NumPy calls.

    drive: (T, B, N) what arrives [state units].
    kept: whether there may be a state before the first timestep.
    subtract: whether a spike takes the threshold off the membrane, and does not set it to 0.
    """

    def __init__(
        self,
        layer: Layer,
        fixed: CubaFixedPoint | None,
        states: Floats,
        drive: Floats,
        spikes: Bits,
        kept: bool,
        subtract: bool,
    ) -> None:
        self._drive, self._currents, self._kept = drive, states[1:, 0], kept
        # where nothing stays of a current, it is what arrives, and only the membrane decays
        self._first = 0 if layer.current_decay.any() else 1
        of = slice(self._first, 2)
        # (2, 1, N): one multiplication decays currents and membranes
        factors = np.stack([layer.current_decay, layer.membrane_decay])[of, None]
        self._decay = factors / float(fixed.decay_one if fixed else 1)
        # arrays of one shape take NumPy's shortest way; a (N,) beside a (1, N) costs half a us more
        shape = spikes[0].shape
        self._threshold = np.broadcast_to(layer.threshold.astype(np.float64), shape).copy()
        bias = np.broadcast_to(layer.voltage_bias.astype(np.float64), shape).copy()
        self._bias = bias if bias.any() else None
        exact = exact_ticks(layer, fixed) if fixed and not kept else -1
        self._timesteps = [
            (states[t, of], states[t + 1, of], *states[t + 1], drive[t], spike, fixed and t > exact)
            for t, spike in enumerate(spikes)
        ]
        self._others = np.empty_like(spikes[0])
        self._reset: Callable[[Floats, Bits, Floats], None] = np.putmask
        self._to = np.zeros(1)
        if subtract:
            self._reset, self._to = _subtract, self._threshold
        elif spikes[0].size >= _WIDE and fixed:
            self._reset = self._silence

    def __call__(self) -> None:
        """Fill the states and spikes that it was made for."""
        # names of the function are found faster than those of the module
        multiply, trunc, add, greater = np.multiply, np.trunc, np.add, np.greater
        decay, threshold, bias = self._decay, self._threshold, self._bias
        reset, to, has_current = self._reset, self._to, not self._first
        resting = not self._kept
        for before, after, current, membrane, drive, spikes, rounded in self._timesteps:
            if resting:
                # from zero, both states become what arrives
                np.copyto(after, drive)
                resting = False
            else:
                multiply(before, decay, after)
                if rounded:
                    trunc(after, after)
                if has_current:
                    add(current, drive, current)
                    add(membrane, current, membrane)
                else:
                    add(membrane, drive, membrane)
            if bias is not None:
                add(membrane, bias, membrane)
            greater(membrane, threshold, spikes)
            reset(membrane, spikes, to)
        if self._first:
            np.copyto(self._currents, self._drive)

    def _silence(self, membrane: Floats, spikes: Bits, _: Floats) -> None:
        np.logical_not(spikes, self._others)
        np.multiply(membrane, self._others, membrane)


def _subtract(membrane: Floats, spikes: Bits, threshold: Floats) -> None:
    np.subtract(membrane, threshold, out=membrane, where=spikes)


class _OverflowCheck:
    """A test that every number of a window fitted its register.

    What the bounds prove costs nothing; where they leave something open, so few spikes may not be
    able to overflow; else the largest and the smallest state are looked for, which may report an
    overflow where there was none, and is fast.

    fixed: the integers of the chip.
    limits: of the layer's numbers.
    timesteps: of a window that starts from zero; None where states are kept.
    """

    def __init__(
        self, layer: Layer, fixed: CubaFixedPoint, limits: Bounds, timesteps: int | None
    ) -> None:
        self.fixed = fixed
        current, membrane = register_limit(fixed.current), register_limit(fixed.membrane)
        self._limit = min(current, membrane)
        self._push = float(layer.voltage_bias.max(initial=0))
        self._open = max(limits.current, limits.above, limits.below) > self._limit
        # membranes that no spike resets are all kept, and looked at as they are
        self._open_above = layer.spiking and limits.above > self._limit
        pushed = min(limits.current, current) + magnitude(layer.voltage_bias)
        # refractory, and accumulators and pushes that overflow, are left to the interpreter
        self._never = (
            fixed.refractory > 1
            or limits.drive > register_limit(fixed.accumulator)
            or pushed > register_limit(fixed.push)
        )
        self._safe_spikes = -1
        if timesteps is not None:
            self._safe_spikes = spikes_without_overflow(layer, fixed, timesteps, self._limit)

    def fits(self, states: Floats, presynaptic: Sequence[Raster]) -> bool:
        """True where no register overflowed on the way to these states."""
        if self._never or not self._open:
            return not self._never
        if self._safe_spikes >= 0:
            spikes = sum([raster.spikes() for raster in presynaptic])
            if spikes <= self._safe_spikes:
                return True
        # what max() and min() do, without their overhead in Python
        highest = float(np.maximum.reduce(states, axis=None))
        lowest = float(np.minimum.reduce(states, axis=None))
        if self._open_above:
            # a membrane before its reset is not kept, but cannot have been higher than this: what
            # the one before left, and the current
            highest = 2 * max(highest, 0.0) + self._push
        return -self._limit <= lowest and highest <= self._limit
