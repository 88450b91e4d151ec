"""The distance of van Rossum equals its definition, by hand and by quadrature."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.analysis.activity import mean_distance, van_rossum


def train(*times, length=8):
    spikes = np.zeros((1, length, 1), np.uint8)
    spikes[0, list(times)] = 1
    return spikes


def test_equal_trains_are_no_distance_apart():
    assert van_rossum(train(1, 4), train(1, 4)).item() == 0.0


@pytest.mark.parametrize("time", [0, 3, 7])
@pytest.mark.parametrize("tau", [0.5, 5.0, 1e4])
def test_a_spike_more_is_half_wherever_it_is(time, tau):
    assert van_rossum(train(time), train(), tau).item() == pytest.approx(0.5)


def test_a_spike_that_moves_is_as_far_as_its_kernels_are_apart():
    # 1 - exp(-|t1 - t2| / tau)  (van Rossum 2001)
    assert van_rossum(train(1), train(4), 5.0).item() == pytest.approx(1 - np.exp(-3 / 5))


def test_a_short_kernel_counts_what_differs_and_a_long_one_the_difference_of_counts():
    one, other = train(0, 2, 5), train(1, 2)
    assert van_rossum(one, other, 1e-3).item() == pytest.approx(3 / 2)
    # (3 - 2)**2 / 2
    assert van_rossum(one, other, 1e6).item() == pytest.approx(1 / 2, abs=1e-4)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 5.0]))
def test_it_is_the_integral_of_the_definition(seed, tau):
    rng = np.random.default_rng(seed)
    one, other = rng.integers(0, 2, (2, 1, 8, 1), dtype=np.uint8)
    fine = 1000
    time = (np.arange((8 + 20 * int(tau)) * fine) + 0.5) / fine
    traces = [
        sum(np.where(time >= t, np.exp(-(time - t) / tau), 0.0) for t in np.flatnonzero(spikes))
        for spikes in (one, other)
    ]
    integral = ((traces[0] - traces[1]) ** 2).sum() / fine / tau
    assert van_rossum(one, other, tau).item() == pytest.approx(integral, abs=1e-3)


def test_inferences_that_go_on_are_one_train():
    # four inferences of one timestep: the spike moves by one timestep, over the border of two
    one, other = (train(time, length=4).reshape(4, 1, 1) for time in (1, 2))
    assert mean_distance(one, other) == pytest.approx((0.5 + 0.5) / 4)
    assert mean_distance(one, other, trains=(4,)) == pytest.approx((1 - np.exp(-1 / 5)) / 4)
    assert mean_distance(one, other, trains=(2, 2)) == pytest.approx((0.5 + 0.5) / 4)
