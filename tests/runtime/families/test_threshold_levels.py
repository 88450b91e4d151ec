"""Neurons share thresholds by giving up as little of their scales as possible."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.quantise import share_thresholds
from tests.networks import popsan


def test_two_levels_part_the_thresholds_where_least_is_lost():
    scale = share_thresholds(np.array([100.0, 110.0, 200.0, 230.0]), np.ones(4), 2)
    assert scale.tolist() == [100.0, 100.0, 200.0, 200.0]


def test_a_threshold_of_zero_counts_as_a_level():
    scale = share_thresholds(np.array([100.0, 110.0, 200.0]), np.array([1.0, 1.0, 0.0]), 2)
    assert scale.tolist() == [100.0, 100.0, 200.0]
    assert share_thresholds(np.array([9.0, 5.0]), np.zeros(2), 1).tolist() == [9.0, 5.0]


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 5, 16]))
def test_levels_are_few_whole_and_never_above(seed, most):
    rng = np.random.default_rng(seed)
    scale, thresholds = rng.uniform(50, 5000, 40), rng.choice([0.5, 1.0, 2.0], 40)
    found = share_thresholds(scale, thresholds, most)
    mantissas = found * thresholds
    assert (found <= scale).all()
    np.testing.assert_allclose(mantissas, np.rint(mantissas), rtol=1e-12)
    assert len(np.unique(np.rint(mantissas))) <= most
    # no number of equal groups on a scale of ratios could lose more
    low, high = (scale * thresholds).min(), (scale * thresholds).max()
    assert (scale / found).max() <= (high / np.floor(low)) ** (1 / most) * (1 + 2 / low) * (
        1 + 1e-8
    )


@pytest.mark.parametrize("rounding", ["nearest", "truncate"])
def test_a_compiled_layer_has_no_more_thresholds_than_it_may(rounding):
    plain, few = (
        compile_program(
            popsan(), chip("loihi1"), Quantisation("channel", rounding, thresholds=most)
        )
        for most in (None, 4)
    )
    for before, after in zip(plain.layers, few.layers, strict=True):
        assert len(np.unique(before.threshold)) > 4
        assert len(np.unique(after.threshold)) <= 4
        assert (after.scale >= before.scale).all()


def test_levels_need_scales_of_neurons():
    with pytest.raises(ConfigError, match="needs a scale for each 'channel'"):
        Quantisation(thresholds=16)
    with pytest.raises(ConfigError, match="thresholds is 0"):
        Quantisation("channel", thresholds=0)


def test_choices_are_said_in_words():
    assert PLAIN.describe() == ("a scale for each layer, the chip's own rounding, headroom 'none'")
    said = Quantisation("channel", rounding="truncate", thresholds=4, weight_shift=2).describe()
    assert said == (
        "a scale for each channel with at most 4 thresholds, rounding 'truncate', headroom 'none', "
        "weights shifted by 2 bits"
    )
