"""However spikes become sums of weights, the sums are the same."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.families.cuba.numpy_kernels import (
    FEW,
    LARGE,
    SMALL,
    ActiveRows,
    AutoSum,
    Matmul,
    Raster,
    Scratch,
    SparseSum,
    choose_summation,
)

NEURONS = 33


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 20, 300]),
    st.sampled_from([1, 5, 300]),
    st.sampled_from([1, 3]),
    st.sampled_from([0.0, 0.02, 0.5, 1.0]),
    st.sampled_from([np.bool_, np.uint8]),
    st.booleans(),
)
def test_all_ways_give_the_exact_sums(seed, axons, timesteps, batch, rate, dtype, biased):
    rng = np.random.default_rng(seed)
    weight = rng.integers(-255, 256, (axons, NEURONS)).astype(np.int16)
    rows = (rng.random((timesteps, batch, axons)) < rate).astype(dtype)
    bias = rng.integers(-255, 256, NEURONS).astype(np.int16) * biased
    expected = 64 * (rows.astype(np.int64) @ weight.astype(np.int64) + bias)
    scaled = [(array * 64.0).astype(np.float32) for array in (weight, bias)]
    out = np.full((timesteps, batch, NEURONS), np.nan)
    scratch = Scratch(8 * weight.size)
    ways = [
        Matmul(*scaled, out),
        choose_summation(weight, bias, 255 * (axons + 1), 64, out, scratch),
    ]
    if batch == 1:
        whole = [weight.astype(np.int32), bias.astype(np.int32)]
        gather, union = SparseSum(*whole, 64, out, scratch), ActiveRows(*scaled, out, scratch)
        ways += [gather, union, AutoSum(gather, union, ways[0]), AutoSum(None, union, ways[0])]
    for way in ways:
        out.fill(np.nan)
        way(Raster(rows))
        np.testing.assert_array_equal(out, expected)
        # the same memory is used again
        way(Raster(rows[::-1]))
        np.testing.assert_array_equal(out, expected[::-1])


@pytest.mark.parametrize(
    ("partial", "dtypes"),
    [
        (32767, (np.int16, np.float32)),
        (32768, (np.int32, np.float32)),
        ((1 << 24) // 64, (np.int32, np.float64)),
        (None, (None, np.float64)),
    ],
)
def test_number_types_are_as_small_as_the_bounds_allow(partial, dtypes):
    weight, bias = np.zeros((512, 256), np.int16), np.zeros(256, np.int64)
    way = choose_summation(
        weight, bias, partial, 64, np.empty((5, 1, 256)), Scratch(8 * weight.size)
    )
    gather, dense = (way.gather, way.dense) if isinstance(way, AutoSum) else (None, way)
    assert (gather and gather.weight.dtype, dense.weight.dtype) == dtypes


@pytest.mark.parametrize(
    ("shape", "batch", "ways"),
    [
        ((SMALL // 64, 64), 1, "union dense"),
        ((SMALL // 64 - 1, 64), 1, "dense"),
        ((LARGE // 256, 256), 1, "gather union dense"),
        ((LARGE // 256, 256), 2, "dense"),
    ],
)
def test_the_size_and_the_batch_say_which_ways_there_are(shape, batch, ways):
    weight, bias = np.ones(shape, np.int16), np.zeros(shape[1], np.int64)
    out = np.empty((3, batch, shape[1]))
    way = choose_summation(weight, bias, sum(shape), 64, out, Scratch(8 * weight.size))
    found = ["dense"]
    if isinstance(way, AutoSum):
        found = [name for name in ("gather", "union", "dense") if getattr(way, name)]
    assert " ".join(found) == ways


class Spy:
    def __init__(self, name, taken):
        self.name, self.taken, self.weight = name, taken, np.zeros((100, 3))

    def __call__(self, raster):
        self.taken.append(self.name)


def chosen(rows, *names):
    taken = []
    AutoSum(
        *[Spy(name, taken) if name in names else None for name in ("gather", "union", "dense")]
    )(Raster(rows))
    return taken


@pytest.mark.parametrize(
    ("axons", "timesteps", "way"),
    [
        (0, 0, "union"),
        (int(100 * FEW), 5, "union"),
        (int(100 * FEW) + 1, 2, "gather"),
        (100, 2, "gather"),
        (int(100 * FEW) + 1, 3, "dense"),
        (100, 5, "dense"),
    ],
)
def test_the_density_of_the_spikes_decides(axons, timesteps, way):
    rows = np.zeros((5, 1, 100), np.bool_)
    rows[:timesteps, 0, :axons] = True
    assert chosen(rows, "gather", "union", "dense") == [way]
    # where rows are not added one by one, the whole matrix is multiplied
    assert chosen(rows, "union", "dense") == [{"gather": "dense"}.get(way, way)]


def test_where_the_axons_spike_just_so_often_rows_are_still_added_one_by_one():
    # 2.5 spikes of each of 50 axons
    rows = np.zeros((5, 1, 100), np.bool_)
    rows[:2, 0, :50] = rows[2, 0, :25] = True
    assert chosen(rows, "gather", "union", "dense") == ["gather"]
    rows[2, 0, 25] = True
    assert chosen(rows, "gather", "union", "dense") == ["dense"]


@pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.int64])
@pytest.mark.parametrize("timesteps", [1, 255, 256, 300])
def test_a_raster_counts_every_spike(timesteps, dtype):
    rows = np.zeros((timesteps, 1, 4), dtype)
    rows[:, 0, 1] = rows[-1, 0, 3] = 1
    raster = Raster(rows)
    for _ in range(2):  # found, and found again
        assert raster.spikes() == timesteps + 1
        assert raster.axons().tolist() == [1, 3]
        assert raster.per_axon().tolist() == [[0, timesteps, 0, 1]]
    assert Raster(0 * rows).spikes() == 0
    # eight bits hold counts up to 255
    assert raster.per_axon().dtype == (np.uint8 if timesteps < 256 else np.int64)


def test_spikes_in_one_byte_are_not_copied():
    rows = np.zeros((5, 2, 3), np.uint8)
    assert np.shares_memory(Raster(rows).bits, rows)
    assert Raster(rows.astype(np.int64)).bits.dtype == np.bool_
