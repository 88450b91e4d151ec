import numpy as np
import pytest
import torch

from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.rate import RateEncoder, Xorshift
from spikedeploy.runtime.metadata import Record
from spikedeploy.trainers.policies.spiking import TorchRateEncoder as TorchEncoder


def encoder(mode="regular", observed=1):
    return RateEncoder(np.full(observed, -1.0), np.ones(observed), mode)


def spikes(x, timesteps, mode="regular"):
    return encoder(mode).encode(np.array([[x]]), timesteps)[0, :, 0].tolist()


def test_an_accumulator_worked_by_hand():
    # n = 64, from 128: 192, 256 -> spike, 0; 64, 128, 192, 256 -> spike
    assert spikes(-0.5, 8) == [0, 1, 0, 0, 0, 1, 0, 0]
    # n = 96: 224, 320 -> spike, 64; 160, 256 -> spike, 0; 96, 192, 288 -> spike, 32
    assert spikes(-0.25, 7) == [0, 1, 0, 1, 0, 0, 1]


@pytest.mark.parametrize("timesteps", [1, 3, 16, 100])
def test_regular_spikes_equal_an_accumulator_for_every_level(timesteps):
    x = np.arange(257) / 128 - 1
    found = encoder(observed=257).encode(x[None], timesteps)[0]
    for n in range(257):
        accumulator = 128
        for t in range(timesteps):
            accumulator += n
            assert found[t, n] == accumulator // 256
            accumulator %= 256


def test_each_number_has_a_range_of_its_own():
    wide = RateEncoder(np.array([0.0, -4.0]), np.array([1.0, 4.0]))
    assert wide.levels(np.array([[0.5, 0.5]])).tolist() == [[128, 144]]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_torch_and_numpy_spike_alike(dtype):
    x = np.random.default_rng(0).uniform(-1.5, 1.5, (500, 28))
    x[:4] = np.linspace(-1, 1, 112).reshape(4, 28)
    theirs = TorchEncoder(28, "regular").to(dtype)(torch.from_numpy(x).to(dtype), 16)
    precision = np.float32 if dtype == torch.float32 else np.float64
    ours = encoder(observed=28).astype(precision).encode(x.astype(precision), 16)
    np.testing.assert_array_equal(ours, theirs.transpose(0, 1).numpy())


def test_a_byte_below_the_level_is_a_spike():
    x = np.random.default_rng(0).uniform(-1, 1, (3, 5))
    found = encoder("bernoulli", 5).encode(x, 20, Xorshift(9, 5))
    levels = np.rint(128 * (x + 1))
    np.testing.assert_array_equal(found, Xorshift(9, 5).draw(3, 20) < levels[:, None])
    assert found.dtype == np.uint8


def test_without_a_generator_encoding_is_a_function_of_the_observation():
    x = np.zeros((2, 5))
    code = encoder("bernoulli", 5)
    np.testing.assert_array_equal(code.encode(x, 16), code.encode(x, 16))
    np.testing.assert_array_equal(code.encode(x, 16), code.encode(x, 16, Xorshift(0, 5)))


@pytest.mark.parametrize("mode", ["regular", "bernoulli"])
def test_a_codec_of_rates_survives_its_record(mode):
    before = Codec(Normaliser(np.zeros(3), np.ones(3), 1.0), encoder(mode, 3), 16, squash="argmax")
    after = Codec.from_record(Record(before.to_record(), "codec"))
    x = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    np.testing.assert_array_equal(before.encode(x), after.encode(x))
    assert (after.encoder.mode, after.squash, after.chooses) == (mode, "argmax", True)
