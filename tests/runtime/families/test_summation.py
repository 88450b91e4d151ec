"""However spikes become sums of weights, the sums are the same; their density says how."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.emulator.backend import LINE, aligned_zeros
from spikedeploy.runtime.families.cuba.numpy_backend import FEW, LARGE, SMALL, Raster, Summation

NEURONS = 33


def summation(weight, bias, partial, out):
    return Summation(weight, bias, partial, 64, out, np.zeros(8 * weight.size, np.uint8))


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 20, LARGE // NEURONS + 1]),
    st.sampled_from([1, 5, 300]),
    st.sampled_from([1, 3]),
    st.sampled_from([0.0, 0.02, 0.5, 1.0]),
    st.sampled_from([np.bool_, np.uint8]),
    st.booleans(),
)
def test_all_ways_give_the_exact_sums(seed, axons, timesteps, batch, rate, dtype, biased):
    rng = np.random.default_rng(seed)
    timesteps = min(timesteps, 5) if axons > 20 else timesteps
    weight = rng.integers(-255, 256, (axons, NEURONS)).astype(np.int16)
    rows = (rng.random((timesteps, batch, axons)) < rate).astype(dtype)
    bias = rng.integers(-255, 256, NEURONS).astype(np.int16) * biased
    expected = 64 * (rows.astype(np.int64) @ weight.astype(np.int64) + bias)
    out = np.full((timesteps, batch, NEURONS), np.nan)
    way = summation(weight, bias, 255 * (axons + 1), out)
    ways = [way, way.multiply]
    if batch == 1:
        ways.append(way.multiply_active)
    if way.whole is not None:
        ways.append(lambda raster: way.gather(raster, way.whole))
    for each in ways:
        # the second time in the same memory
        for spikes, sums in ((rows, expected), (rows[::-1], expected[::-1])):
            out.fill(np.nan)
            each(Raster(spikes))
            np.testing.assert_array_equal(out, sums)


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
    way = summation(
        np.zeros((512, 256), np.int16), np.zeros(256, np.int64), partial, np.empty((5, 1, 256))
    )
    whole = None if way.whole is None else way.whole.dtype
    assert (whole, way.weight.dtype) == dtypes


FULL, FEWER = (LARGE // 256, 256), (SMALL // 64, 64)


@pytest.mark.parametrize(
    ("shape", "batch", "active", "timesteps", "way"),
    [
        (FULL, 1, FEW, 5, "multiply_active"),
        (FULL, 1, FEW + 0.01, 2, "gather"),
        (FULL, 1, 1, 2, "gather"),
        (FULL, 1, 1, 3, "multiply"),
        (FULL, 2, FEW, 2, "multiply"),
        (FEWER, 1, FEW, 2, "multiply_active"),
        (FEWER, 1, 1, 2, "multiply"),
        ((SMALL // 64 - 1, 64), 1, FEW, 2, "multiply"),
    ],
)
def test_the_size_the_batch_and_the_density_decide(
    shape, batch, active, timesteps, way, monkeypatch
):
    rows = np.zeros((5, batch, shape[0]), np.bool_)
    rows[:timesteps, :, : int(active * shape[0])] = True
    taken = []
    for name in ("multiply", "multiply_active", "gather"):
        monkeypatch.setattr(Summation, name, lambda self, *_, name=name: taken.append(name))
    weight, bias = np.ones(shape, np.int16), np.zeros(shape[1], np.int64)
    summation(weight, bias, sum(shape), np.empty((5, batch, shape[1])))(Raster(rows))
    assert taken == [way]


def test_arrays_begin_with_a_cache_line_and_hold_zeros():
    for shape, dtype in (((1,), np.uint8), ((3, 5), np.int16), ((0, 4), float), ((7, 2, 1), "f4")):
        array = aligned_zeros(shape, dtype)
        assert (array.shape, array.dtype) == (shape, dtype)
        assert not array.any()
        assert array.size == 0 or array.ctypes.data % LINE == 0
