"""Vectors of numbers: what is told apart, and what is not refused for being large."""

import numpy as np
import pytest

from spikedeploy.envs.errors import all_finite


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_one_value_that_is_no_number_is_found(wrong: float) -> None:
    values = np.zeros(18)
    values[7] = wrong
    assert not all_finite(values)


def test_numbers_whose_squares_overflow_are_finite() -> None:
    assert all_finite(np.full(18, 1e300))
