"""Operations of scripts."""

import numpy as np
import pytest

from spikedeploy.policies.counting import count_operations
from spikedeploy.runtime.errors import ConfigError


def test_results_of_ufuncs_reductions_and_searches_are_counted():
    table = np.ones((3, 4))

    def script(seen):
        rows = seen.reshape(3, 4)  # of 12 numbers
        both = np.concatenate([rows * 2.0 - table, np.zeros((1, 4))])  # 12 of each
        far = np.square(both).sum(-1)  # 16, and 3 additions in each of 4 rows
        nearest = np.argmin(far)  # 3 comparisons
        far[[0, 2]] += np.arctan2(far[:2], 1.0)  # 2 of each
        return np.clip(np.where(far > 1.0, far, 0.0), 0.0, nearest)  # 4 and 8 comparisons

    assert dict(count_operations(script, np.arange(12.0)[None])) == {
        "multiplications": 12 + 16,
        "additions": 12 + 12 + 2,
        "comparisons": 3 + 4 + 8,
        "arctan2": 2,
    }


def test_what_comes_of_constants_alone_is_not_counted():
    assert not count_operations(lambda seen: np.sin(np.ones(3)) + 1.0, np.zeros((1, 2)))


def test_a_function_without_a_known_operation_is_refused():
    with pytest.raises(ConfigError, match="no operation is known for sinh"):
        count_operations(np.sinh, np.zeros((1, 2)))


def test_results_are_those_without_counting():
    def script(seen):
        found.append(np.asarray(np.hypot(seen, 2.0).reshape(2, 1) * [[1.0, 3.0]]))

    found = []
    count_operations(script, np.array([[1.0, -2.0]]))
    script(np.array([1.0, -2.0]))
    np.testing.assert_array_equal(*found)
