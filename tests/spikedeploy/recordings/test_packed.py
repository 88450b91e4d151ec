"""Arrays in a page: unpacked as the page does it, they are what was packed."""

import zlib
from base64 import b64decode

import numpy as np
import pytest

from spikedeploy.recordings.packed import packed, packed_bits
from tests.packed_arrays import unpacked


@pytest.mark.parametrize("shape", [(1,), (50,), (40, 3), (30, 4, 7)])
def test_numbers_come_back_within_half_a_level(shape):
    values = np.random.default_rng(0).normal(0, 1e3, shape)
    found = packed(values)
    assert found["shape"] == list(shape)
    assert np.abs(unpacked(found) - values).max() <= 0.51 * found["step"]


def test_jumps_across_the_whole_range_come_back():
    values = np.array([0.0, 1.0, 0.0, 1.0, 1.0, 0.0])
    np.testing.assert_allclose(unpacked(packed(values)), values, atol=1e-4)


@pytest.mark.parametrize("values", [np.zeros(5), np.full((4, 2), -3.25)])
def test_constants_come_back_exactly(values):
    assert (unpacked(packed(values)) == values).all()


def test_nan_becomes_a_number_and_nothing_at_all_is_packed():
    assert np.isfinite(unpacked(packed([1.0, np.nan, 2.0]))).all()
    assert packed(np.zeros((0, 3)))["shape"] == [0, 3]


@pytest.mark.parametrize("neurons", [1, 7, 8, 9, 130])
def test_spikes_come_back(neurons):
    raster = np.random.default_rng(1).integers(-1, 2, (20, neurons))
    found = packed_bits(raster)
    bits = np.frombuffer(zlib.decompress(b64decode(found["data"])), np.uint8)
    rows = np.unpackbits(bits.reshape(20, -1), axis=1, bitorder="little")[:, :neurons]
    assert found["shape"] == [20, neurons]
    assert (rows == (raster != 0)).all()
