"""However spikes become sums of weights, the sums are the same."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.emulator.raster import Raster, Scratch
from spikedeploy.runtime.families.cuba_numpy.sums import (
    ActiveRows,
    AutoSum,
    Matmul,
    SparseSum,
    summing,
)
from spikedeploy.runtime.families.cuba_numpy.ways import SumCosts, measured

NEURONS = 33


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 20, 300]),
    st.sampled_from([1, 5, 300]),
    st.sampled_from([1, 3]),
    st.sampled_from([0.0, 0.02, 0.5, 1.0]),
    st.sampled_from([np.bool_, np.uint8]),
    st.sampled_from([np.float32, np.float64]),
    st.booleans(),
)
def test_all_ways_give_the_exact_sums(seed, axons, timesteps, batch, rate, dtype, into, biased):
    rng = np.random.default_rng(seed)
    weight = rng.integers(-255, 256, (axons, NEURONS)).astype(np.int16)
    rows = (rng.random((timesteps, batch, axons)) < rate).astype(dtype)
    bias = rng.integers(-255, 256, NEURONS).astype(np.int16) * biased
    expected = 64 * (rows.astype(np.int64) @ weight.astype(np.int64) + bias)
    scaled = [(array * 64.0).astype(np.float32) for array in (weight, bias)]
    out = np.full((timesteps, batch, NEURONS), np.nan, into)
    scratch = Scratch(8 * weight.size)
    ways = [
        Matmul(*scaled, out),
        ActiveRows(*scaled, out, scratch),
        summing(weight, bias, 255 * (axons + 1), 64, out, scratch),
    ]
    if batch == 1:
        whole = [weight.astype(np.int32), bias.astype(np.int32)]
        ways.append(SparseSum(*whole, 64, out, scratch))
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
def test_number_types_are_as_small_as_the_bounds_allow(partial, dtypes, monkeypatch):
    monkeypatch.setattr("spikedeploy.runtime.families.cuba_numpy.sums.measured", lambda *_: COSTS)
    weight, bias = np.zeros((4, 3), np.int16), np.zeros(3, np.int64)
    way = summing(weight, bias, partial, 64, np.empty((5, 1, 3)), Scratch(96))
    gather, dense = (way.gather, way.dense) if isinstance(way, AutoSum) else (None, way)
    assert (gather and gather.weight.dtype, dense.weight.dtype) == dtypes


# 40 us for everything; half a us an axon for a union, a tenth a spike for fetching
COSTS = SumCosts(
    dense=40.0, union=((0, 5.0), (70, 40.0), (100, 400.0)), gather=((0, 10.0), (50, 15.0))
)


class Spy:
    def __init__(self, name, taken, shape=None):
        self.name, self.taken, self.shape = name, taken, shape

    def __call__(self, raster):
        self.taken.append(self.name)


def chosen(rows, costs=COSTS):
    taken = []
    spies = [Spy("gather", taken), Spy("union", taken), Spy("dense", taken, rows.shape)]
    AutoSum(*spies, costs)(Raster(rows))
    return taken


@pytest.mark.parametrize(
    ("axons", "timesteps", "way"),
    [
        (60, 5, "union"),  # 35 us; 300 spikes would take 40
        (60, 1, "gather"),  # 60 spikes take 16
        (8, 5, "union"),  # 9 us; 40 spikes would take 14
        (80, 5, "dense"),  # 40 us; their union would take 160, 400 spikes 50
        (80, 3, "gather"),  # 240 spikes take 34
        (0, 0, "union"),
    ],
)
def test_the_cheapest_way_is_taken(axons, timesteps, way):
    rows = np.zeros((5, 1, 100), np.bool_)
    rows[:timesteps, 0, :axons] = True
    assert chosen(rows) == [way]


def test_a_batch_is_united_by_the_axons_of_each():
    rows = np.zeros((5, 4, 100), np.bool_)
    rows[:, :, :60] = True
    # a product of everything for four costs less than four unions, or more
    unions = ((0, 5.0), (100, 55.0))
    assert chosen(rows, SumCosts(dense=139.0, union=unions)) == ["dense"]
    assert chosen(rows, SumCosts(dense=141.0, union=unions)) == ["union"]


def test_costs_are_those_of_runs_with_none_some_and_all_axons():
    seen = []
    costs = measured(
        *[lambda raster: seen.append((raster.rows.shape[1], raster.spikes()))] * 3, (5, 3, 8)
    )
    assert set(seen) == {(3, 120), (1, 0), (1, 10), (1, 20), (1, 40)}
    assert [axons for axons, _ in costs.union] == [0, 2, 4, 8]
    assert [spikes for spikes, _ in costs.gather] == [0, 10]
