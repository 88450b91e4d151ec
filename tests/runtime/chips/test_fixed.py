"""Integer arithmetic against Python's integers and against sentences of datasheets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spikedeploy.runtime.chips.registers import Register, decay

HALF = 1 << 23


def whole(*values):
    return np.array(values, np.int64)


@given(st.integers(-(2**40), 2**40), st.integers(0, 4096))
def test_decay_rounds_toward_zero(x, keep):
    exact = x * keep
    expected = exact // 4096 if exact >= 0 else -(-exact // 4096)
    assert decay(whole(x), whole(keep), 12)[0] == expected


@given(st.integers(-(2**41), 2**41), st.integers(0, 4096))
def test_decay_equals_truncated_float64(x, keep):
    assert decay(whole(x), whole(keep), 12)[0] == np.trunc(x * (keep / 4096))


@pytest.mark.parametrize(
    ("overflow", "expected"),
    [
        ("none", [HALF, HALF + 5, -HALF, -HALF - 5, HALF - 1]),
        ("wrap", [-HALF, -HALF + 5, -HALF, HALF - 5, HALF - 1]),
        # as lava: +2**23 stays, -2**23 becomes +2**23
        ("wrap-once", [HALF, -HALF + 5, HALF, HALF - 5, HALF - 1]),
        ("clip", [HALF - 1, HALF - 1, -HALF + 1, -HALF + 1, HALF - 1]),
    ],
)
def test_a_register_overflows_as_it_says(overflow, expected):
    values = whole(HALF, HALF + 5, -HALF, -HALF - 5, HALF - 1)
    assert Register(24, overflow).fit(values).tolist() == expected


@given(st.integers(1 - HALF, HALF - 1), st.sampled_from(["none", "wrap", "wrap-once", "clip"]))
def test_what_is_within_the_limit_fits_unchanged(x, overflow):
    register = Register(24, overflow)
    assert abs(x) <= register.limit
    assert register.fit(whole(x))[0] == x
