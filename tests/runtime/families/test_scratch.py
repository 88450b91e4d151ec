"""Memory begins with a cache line and is used again."""

import numpy as np
import pytest

from spikedeploy.runtime.families.cuba_numpy.raster import LINE, Scratch, aligned, as_aligned


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32, np.float64])
@pytest.mark.parametrize("shape", [(1,), (3, 5), (0, 4), (7, 2, 1)])
def test_arrays_begin_with_a_cache_line_and_hold_zeros(dtype, shape):
    array = aligned(shape, dtype)
    assert (array.shape, array.dtype) == (shape, dtype)
    assert array.flags.c_contiguous
    assert not array.any()
    assert array.size == 0 or array.ctypes.data % LINE == 0


def test_a_copy_has_the_values_and_not_the_memory():
    values = np.arange(6).reshape(2, 3)
    copy = as_aligned(values, np.int16)
    copy[0, 0] = 9
    assert copy.tolist() == [[9, 1, 2], [3, 4, 5]]
    assert values[0, 0] == 0


def test_users_of_scratch_memory_share_it():
    scratch = Scratch(32)
    first, second = scratch.like(np.zeros((2, 4), np.float32)), scratch.like(np.zeros(4))
    first[:] = 1
    second[:] = 0
    assert not first.any()
