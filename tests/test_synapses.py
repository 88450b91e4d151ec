"""However spikes become sums of weights, the sums are the same."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.synapses import Cheapest, Dense, Gather, Raster, Union, summing


def sums(way, raster):
    out = np.full((*raster.rows.shape[:2], NEURONS), np.nan)
    way(raster, out)
    return out


NEURONS = 33


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 20, 300]),
    st.sampled_from([1, 5, 300]),
    st.sampled_from([0.0, 0.02, 0.5, 1.0]),
    st.sampled_from([np.bool_, np.uint8]),
)
def test_all_ways_give_the_exact_sums(seed, axons, timesteps, rate, dtype):
    rng = np.random.default_rng(seed)
    weight = rng.integers(-255, 256, (axons, NEURONS)).astype(np.int16)
    rows = (rng.random((timesteps, 1, axons)) < rate).astype(dtype)
    bias = rng.integers(-255, 256, NEURONS).astype(np.int16)
    expected = 64 * (rows.astype(np.int64) @ weight.astype(np.int64) + bias)
    scaled = [(array * 64.0).astype(np.float32) for array in (weight, bias)]
    ways = [
        Dense(*scaled, timesteps, 1),
        Gather(weight.astype(np.int32), bias.astype(np.int32), 64, timesteps),
        Union(*scaled, timesteps),
        summing(weight, bias, 255 * (axons + 1), 64, timesteps, 1),
    ]
    for way in ways:
        np.testing.assert_array_equal(sums(way, Raster(rows)), expected)
        # the same memory is used again
        np.testing.assert_array_equal(sums(way, Raster(rows[::-1])), expected[::-1])


@pytest.mark.parametrize(
    ("partial", "batch", "kinds"),
    [
        (32767, 1, (Cheapest, np.int16, np.float32)),
        (32768, 1, (Cheapest, np.int32, np.float32)),
        ((1 << 24) // 64, 1, (Cheapest, np.int32, np.float64)),
        (32767, 2, (Dense, None, np.float32)),
        (None, 1, (Dense, None, np.float64)),
    ],
)
def test_number_types_are_as_small_as_the_bounds_allow(partial, batch, kinds):
    weight, bias = np.zeros((4, 3), np.int16), np.zeros(3, np.int64)
    way = summing(weight, bias, partial, 64, 5, batch)
    dense = way.dense if isinstance(way, Cheapest) else way
    gathered = way.gather._weight.dtype if isinstance(way, Cheapest) else None
    assert (type(way), gathered, dense._weight.dtype) == kinds


def chosen(rows, neurons=512):
    way = summing(np.zeros((770, neurons), np.int16), np.zeros(neurons), 1000, 64, 5, 1)
    taken = []
    for name in ("gather", "union", "dense"):
        setattr(way, name, Spy(name, getattr(way, name), taken))
    way(Raster(rows), np.empty((5, 1, neurons)))
    return taken


class Spy:
    def __init__(self, name, way, taken):
        self.name, self.taken = name, taken
        self.__dict__.update({k: v for k, v in vars(way).items() if k.startswith("cost")})

    def __call__(self, raster, out):
        self.taken.append(self.name)


def test_axons_that_spike_in_every_timestep_are_united():
    rows = np.zeros((5, 1, 770), np.bool_)
    rows[:, :, :90] = True
    assert chosen(rows) == ["union"]


def test_single_spikes_of_many_axons_are_gathered():
    rows = np.zeros((5, 1, 770), np.bool_)
    rows[0, 0, :200] = True
    assert chosen(rows) == ["gather"]


def test_when_most_axons_spike_all_are_multiplied():
    assert chosen(np.ones((5, 1, 770), np.bool_)) == ["dense"]
