"""A table of patterns gives the bits of going through the timesteps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.codec.population import (
    MAX_TABLE_TIMESTEPS,
    integrate,
    pattern_table,
    spike_patterns,
)


def test_two_timesteps_have_three_patterns():
    table = pattern_table(0.6, 2, "<f8")
    # up to 0.3 never; up to 0.6 the second time, where v = 2 A; above, the first time, and the
    # second too, where v = 2 A - 0.6
    assert table.spikes.T.tolist() == [[0, 0], [0, 1], [1, 1]]
    np.testing.assert_allclose(table.edges, [0.3, 0.6], rtol=1e-15)


@settings(max_examples=16)
@given(
    st.floats(0.05, 1.5),
    st.sampled_from([1, 2, 5, 16, MAX_TABLE_TIMESTEPS, MAX_TABLE_TIMESTEPS + 1]),
    st.sampled_from([np.float64, np.float32]),
    st.integers(0, 2**32 - 1),
)
def test_looking_up_equals_integrating(threshold, timesteps, dtype, seed):
    drive = np.random.default_rng(seed).random((3, 200)).astype(dtype)
    expected = integrate(drive, threshold, timesteps)
    found = spike_patterns(drive, threshold, timesteps)
    np.testing.assert_array_equal(found, expected)
    assert found.dtype == np.uint8


@pytest.mark.parametrize("dtype", ["<f8", "<f4"])
@pytest.mark.parametrize("timesteps", [3, 5, 32])
@pytest.mark.parametrize("threshold", [0.999, 0.5, 0.1, 1.2])
def test_edges_are_exact_to_the_last_bit(threshold, timesteps, dtype):
    edges = pattern_table(threshold, timesteps, dtype).edges
    one = np.ones(1, dtype)
    drive = np.concatenate([edges, np.nextafter(edges, one), np.nextafter(edges, -one), one])
    np.testing.assert_array_equal(
        spike_patterns(drive, threshold, timesteps), integrate(drive, threshold, timesteps)
    )
