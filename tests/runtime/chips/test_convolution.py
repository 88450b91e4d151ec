"""Windows against torch's convolutions, and against the matrix that these make of impulses."""

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from torch.nn.functional import conv2d

from spikedeploy.runtime.chips import convolution as windows
from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.errors import RuleError


def _pairs(least: int, most: int) -> st.SearchStrategy[tuple[int, int]]:
    return st.tuples(st.integers(least, most), st.integers(least, most))


@st.composite
def synapses(draw: st.DrawFn) -> Synapses:
    groups, seen, features = draw(st.integers(1, 3)), draw(st.integers(1, 2)), draw(_pairs(1, 3))[0]
    extents, pool = draw(_pairs(1, 7)), draw(_pairs(1, 2))
    kernel, stride, dilation = draw(_pairs(1, 3)), draw(_pairs(1, 3)), draw(_pairs(1, 2))
    padding = draw(_pairs(0, 3))
    after = draw(_pairs(0, 3))
    target = []
    for axis in (0, 1):
        padded = extents[axis] // pool[axis] + padding[axis] + after[axis]
        target.append((padded - dilation[axis] * (kernel[axis] - 1) - 1) // stride[axis] + 1)
    assume(min(target) > 0 and all(n >= p for n, p in zip(extents, pool, strict=True)))
    window = Window(
        source=(groups * seen, *extents),
        target=(groups * features, target[0], target[1]),
        kernel=kernel,
        pool=pool,
        stride=stride,
        padding=padding,
        dilation=dilation,
        groups=groups,
    )
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    weight = rng.integers(-3, 4, (groups * features, seen, *kernel))
    return Synapses("source", weight, 0, window=window)


def _by_torch(found: Synapses, spikes: NDArray[np.int64]) -> NDArray[np.float64]:
    window = found.window
    assert window is not None
    maps = torch.tensor(spikes, dtype=torch.float64).reshape(-1, *window.source)
    pooled = torch.nn.functional.avg_pool2d(maps, window.pool) * np.prod(window.pool)
    # more padding behind than is needed; what is too much is cut
    (top, left), wide = window.padding, 24
    padded = torch.nn.functional.pad(pooled, (left, wide, top, wide))
    kernel = torch.tensor(found.weight, dtype=torch.float64)
    puts = conv2d(padded, kernel, None, window.stride, 0, window.dilation, window.groups)
    _, y, x = window.target
    return puts[:, :, :y, :x].round().reshape(len(spikes), -1).numpy()


@settings(max_examples=32)
@given(synapses(), st.integers(0, 99), st.sampled_from([0.02, 0.5]))
def test_the_matrix_of_a_window_is_that_of_torchs_convolution(
    found: Synapses, seed: int, density: float
) -> None:
    matrix = _by_torch(found, np.eye(found.shape[0], dtype=np.int64))
    listed = found.dense()
    np.testing.assert_array_equal(listed.weight, matrix)
    np.testing.assert_array_equal(found.fan_out, listed.fan_out)
    for reduce in (np.add, np.maximum):
        over = found.over_axons(np.abs(found.weight), reduce)
        np.testing.assert_array_equal(over, listed.over_axons(np.abs(matrix), reduce))
    rng = np.random.default_rng(seed)
    spikes = rng.integers(1, 4, (3, found.shape[0])) * (rng.random((3, found.shape[0])) < density)
    np.testing.assert_array_equal(found.sums(spikes), spikes @ matrix)
    np.testing.assert_array_equal(found.sums(spikes, np.float32), spikes @ matrix)


@settings(max_examples=20)
@given(synapses(), st.integers(0, 99))
def test_both_ways_of_summing_agree(found: Synapses, seed: int) -> None:
    window = found.window
    assert window is not None
    maps = np.random.default_rng(seed).integers(0, 3, (2, *window.pooled))
    one_by_one = window._scatter(found.weight, maps)
    np.testing.assert_array_equal(one_by_one, window._multiply(found.weight, maps, np.float64))


def test_an_axon_reaches_neurons_in_ascending_order_zeros_included() -> None:
    window = Window((1, 3, 3), (2, 3, 3), kernel=(3, 3), padding=(1, 1))
    weight = np.arange(18).reshape(2, 1, 3, 3)
    neurons, weights = window.row(weight, 4)
    assert neurons.tolist() == list(range(18))
    assert weights.tolist() == [*range(8, -1, -1), *range(17, 8, -1)]
    neurons, weights = window.row(weight, 0)
    assert neurons.tolist() == [0, 1, 3, 4, 9, 10, 12, 13]
    assert weights.tolist() == [4, 3, 1, 0, 13, 12, 10, 9]


def test_windows_are_unfolded_a_few_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    window = Window((2, 8, 8), (3, 6, 6), kernel=(3, 3))
    weight = np.random.default_rng(0).integers(-9, 9, (3, 2, 3, 3))
    spikes = np.ones((7, 128), np.uint8)
    whole = window.sums(weight, spikes)
    monkeypatch.setattr(windows, "_UNFOLDED", 1)
    np.testing.assert_array_equal(window.sums(weight, spikes), whole)


def test_a_window_too_large_for_a_matrix_and_neurons_that_differ_are_refused() -> None:
    window = Window((2, 128, 128), (8, 126, 126), kernel=(3, 3))
    found = Synapses("in", np.ones((8, 2, 3, 3)), 0, window=window)
    with pytest.raises(RuleError, match="as a matrix"):
        found.dense()
    with pytest.raises(RuleError, match="share a kernel"):
        found.by_weight(np.arange(found.shape[1]))
