"""However spikes become sums of weights, the sums are exact; their density says how."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.families.cuba.numpy_backend import (
    FEW_SPIKES,
    LARGE_WEIGHTS,
    SPARSE_SHARE,
    SPARSE_WEIGHTS,
    Raster,
    Summation,
)

NEURONS = 33


def summation(weight, bias, partial, out):
    return Summation(weight, bias, partial, 64, out, np.zeros(8 * weight.size, np.uint8))


@settings(max_examples=24)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 20, SPARSE_WEIGHTS // NEURONS + 1, LARGE_WEIGHTS // NEURONS + 1]),
    st.sampled_from([1, 5]),
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
    out = np.empty((timesteps, batch, NEURONS))
    sums = summation(weight, bias, 255 * (axons + 1), out)
    ways = [sums, sums.multiply]
    if batch == 1:
        ways += [sums.multiply_active, sums.add_rows]
    for way in ways:
        # the second time in the same memory
        for spikes, wanted in ((rows, expected), (rows[::-1], expected[::-1])):
            out.fill(np.nan)
            way(Raster(spikes))
            np.testing.assert_array_equal(out, wanted)


@pytest.mark.parametrize(
    ("partial", "dtype"), [(32767, "f4"), ((1 << 24) // 64, "f8"), (None, "f8")]
)
def test_number_types_are_as_small_as_the_bounds_allow(partial, dtype):
    weight, bias = np.zeros((64, 8), np.int16), np.zeros(8, np.int64)
    assert summation(weight, bias, partial, np.empty((5, 1, 8))).weight.dtype == dtype


SMALL, LARGE = SPARSE_WEIGHTS // 64, LARGE_WEIGHTS // 64


@pytest.mark.parametrize(
    ("axons", "batch", "active", "timesteps", "way"),
    [
        (SMALL, 1, SPARSE_SHARE, 5, "multiply_active"),
        (SMALL, 1, SPARSE_SHARE + 0.01, 1, "multiply"),
        (SMALL, 2, SPARSE_SHARE, 5, "multiply"),
        (SMALL - 1, 1, SPARSE_SHARE, 5, "multiply"),
        (LARGE, 1, SPARSE_SHARE, 5, "multiply_active"),
        (LARGE, 1, SPARSE_SHARE + 0.01, int(FEW_SPIKES), "add_rows"),
        (LARGE, 1, SPARSE_SHARE + 0.01, int(FEW_SPIKES) + 1, "multiply"),
        (LARGE, 2, SPARSE_SHARE + 0.01, int(FEW_SPIKES), "multiply"),
    ],
)
def test_the_size_the_batch_and_the_density_decide(
    axons, batch, active, timesteps, way, monkeypatch
):
    rows = np.zeros((5, batch, axons), np.bool_)
    rows[:timesteps, :, : int(active * axons)] = True
    taken = []
    for name in ("multiply", "multiply_active", "add_rows"):
        monkeypatch.setattr(Summation, name, lambda self, *_, name=name: taken.append(name))
    weight, bias = np.ones((axons, 64), np.int16), np.zeros(64, np.int64)
    summation(weight, bias, axons, np.empty((5, batch, 64)))(Raster(rows))
    assert taken == [way]
