import numpy as np
import pytest

from spikedeploy.runtime.codec.codec import (
    Codec,
    DeltaEncoder,
    EventEncoder,
    Normaliser,
    PopulationEncoder,
    RateEncoder,
)
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.runtime.metadata import Record
from tests.networks import codec


@pytest.mark.parametrize(
    ("drive", "spikes"),
    [
        # v: 0.5, 1.0 -> spike, 0.001; 0.501, 1.001 -> spike, 0.002; 0.502
        (0.5, [0, 1, 0, 1, 0]),
        # v: 1 -> spike, 0.001; 1.001 -> spike, 0.002; ...
        (1.0, [1, 1, 1, 1, 1]),
        # v: 0.7, 1.4 -> 0.401, 1.101 -> 0.102, 0.802, 1.502 -> spike; a reset to 0 would skip one
        (0.7, [0, 1, 1, 0, 1]),
    ],
)
def test_a_driven_neuron_keeps_what_is_above_the_threshold(drive, spikes):
    x = np.sqrt(-2 * np.log(drive))
    encoder = PopulationEncoder(np.zeros((1, 1)), np.ones((1, 1)))
    assert encoder.encode(np.array([[x]]), 5)[0, :, 0].tolist() == spikes


def test_spikes_equal_the_definition_worked_neuron_by_neuron():
    rng = np.random.default_rng(1)
    encoder = PopulationEncoder(rng.normal(size=(3, 4)), rng.uniform(0.2, 1, (3, 4)), 0.8)
    x = rng.normal(size=(5, 3))
    spikes = encoder.encode(x, 7)
    for b, i, p in np.ndindex(5, 3, 4):
        drive = np.exp(-0.5 * ((x[b, i] - encoder.mean[i, p]) / encoder.std[i, p]) ** 2)
        v = 0.0
        for t in range(7):
            v += drive
            assert spikes[b, t, i * 4 + p] == (v > 0.8)
            v -= 0.8 * (v > 0.8)


def test_the_normaliser_shifts_scales_and_clips():
    normaliser = Normaliser(np.array([1.0, 1.0, 1.0]), np.array([2.0, 2.0, 2.0]), 3.0)
    x = normaliser(np.array([[5.0, 100.0, -100.0]]))
    np.testing.assert_array_equal(x, [[2.0, 3.0, -3.0]])


def test_decoding_squashes_the_mean_over_time():
    output = np.array([[[1.0, 0.0], [0.0, 0.0], [2.0, 0.0], [0.0, 0.0], [-1.0, 5.0]]])
    np.testing.assert_allclose(codec(2).decode(output), np.tanh([[0.4, 1.0]]))
    np.testing.assert_allclose(codec(2, squash="none").decode(output), [[0.4, 1.0]])


def test_a_choice_is_the_action_with_the_largest_mean_and_the_first_of_equals():
    output = np.zeros((3, 5, 4))
    output[0, :, 2] = 1.0
    output[1, 0, 3], output[1, 1:, 1] = 1.0, 0.25  # a mean of 1/5 each
    output[2] = -1.0
    choosing = codec(2, squash="argmax")
    assert choosing.decode(output).tolist() == [2, 1, 0]
    assert choosing.chooses
    np.testing.assert_allclose(choosing.scores(output)[1], [0.0, 0.2, 0.0, 0.2])
    assert not codec(2).chooses


def test_float32_encodes_in_float32_and_differs_in_few_spikes():
    obs = np.random.default_rng(0).normal(size=(300, 20))
    double, single = codec(20), codec(20).astype(np.float32)
    assert single.encoder.mean.dtype == single.normaliser.std.dtype == np.float32
    assert np.mean(double.encode(obs) != single.encode(obs)) < 1e-4


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_observation_that_is_not_finite_is_refused_by_index(bad):
    obs = np.zeros((2, 3))
    obs[1, 2] = bad
    with pytest.raises(ObservationError, match=r"index 2 of row 1"):
        codec(3).encode(obs)


@pytest.mark.parametrize("shape", [(3,), (1, 4), (1, 1, 3)])
def test_an_observation_of_the_wrong_size_is_refused(shape):
    with pytest.raises(ObservationError, match=r"needs \(B, 3\)"):
        codec(3).encode(np.zeros(shape))


def test_a_codec_survives_its_record_bit_for_bit():
    before = codec(6, squash="none")
    after = Codec.from_record(Record(before.to_record(), "codec"))
    obs = np.random.default_rng(0).normal(size=(50, 6))
    np.testing.assert_array_equal(before.encode(obs), after.encode(obs))
    assert (after.timesteps, after.squash) == (before.timesteps, before.squash)


def test_an_unknown_encoder_is_refused_with_the_known_ones():
    record = codec(3).to_record()
    record["encoder"]["kind"] = "latency"
    with pytest.raises(ArtifactError, match="'latency'; known encoders are delta"):
        Codec.from_record(Record(record, "codec"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"timesteps": 0}, "must be 1 to"),
        ({"timesteps": 10**9}, "must be 1 to 65,536"),
        ({"squash": "sigmoid"}, "known are tanh, none, argmax"),
        ({"encoder": codec(4).encoder}, "takes 3 numbers and the encoder 4"),
    ],
)
def test_a_codec_that_cannot_work_is_refused(change, message):
    c = codec(3)
    parts = {"normaliser": c.normaliser, "encoder": c.encoder, "timesteps": 5, "squash": "tanh"}
    with pytest.raises(ArtifactError, match=message):
        Codec(**{**parts, **change})


def test_an_output_with_the_wrong_number_of_timesteps_is_refused():
    with pytest.raises(ObservationError, match=r"\(B, 5, act\)"):
        codec(3).decode(np.zeros((1, 4, 2)))


@pytest.mark.parametrize(
    ("code", "spikes"),
    [
        # counts 0, 1 | 2, 7: a pixel of each of two polarities beside another
        ("channels", [[0, 1, 0, 0, 0, 0, 1, 1, 1, 1, 0, 1], [0] * 12]),
        ("spread", [[0, 1, 1, 1], [0, 0, 1, 1]]),
        ("counts", [[0, 1, 2, 3], [0, 0, 0, 0]]),
    ],
)
def test_counts_of_events_become_spikes(code, spikes):
    encoder = EventEncoder(4, polarities=2, most=3, code=code)
    assert encoder.encode(np.array([[-1.0, 1.9, 2.0, 7.0]]), 2)[0].tolist() == spikes
    record = Record(encoder.to_record(), "encoder")
    again = EventEncoder.from_record(record)
    assert vars(again) == vars(encoder)


def population(mean, std):
    return PopulationEncoder(np.full((2, 3), mean), np.full((2, 3), std))


def normaliser(mean, std):
    return Normaliser(np.full(2, mean), np.full(2, std), 5.0)


def rate(high, mode="regular"):
    return RateEncoder(np.zeros(2), np.array(high), mode)


def delta(step, **fields):
    return DeltaEncoder(np.array(step), **fields)


# what makes an encoder or a normaliser, its arguments, what is said of them
REFUSED = [
    *((make, numbers, {}, "mean must be finite")
      for make in (population, normaliser) for numbers in ((0, 0), (0, np.nan), (np.nan, 1))),
    (Normaliser, (np.zeros(2), np.ones(3), 5.0), {}, r"\(2,\) and \(3,\)"),
    (PopulationEncoder, (np.zeros(2), np.ones(2)), {}, r"\(2,\) and \(2,\)"),
    (EventEncoder, (4,), {"polarities": 3}, "3 polarities"),
    (EventEncoder, (4,), {"most": 0}, "found 0"),
    (rate, ([1.0, 1.0, 1.0],), {}, r"\(2,\) and \(3,\)"),
    (rate, ([1.0, 0.0],), {}, r"found 0\.0 and 0\.0 at index 1"),
    (rate, ([1.0, np.inf],), {}, "must be finite"),
    (rate, ([1.0, 1.0], "poisson"), {}, "'poisson' is unknown"),
    (delta, ([0.5, 0.0],), {}, r"above 0, found 0\.0"),
    (delta, ([np.nan],), {}, "above 0, found nan"),
    (delta, ([[0.5]],), {}, r"found shape \(1, 1\)"),
    (delta, ([0.5],), {"most": 0}, "from 1 to 256, found 0"),
    (delta, ([0.5],), {"most": 257}, "from 1 to 256, found 257"),
    (delta, ([0.5],), {"code": "binary"}, "code 'binary' is unknown"),
    (delta, ([0.5],), {"threshold": 127}, "from 128 to 768 .* found 127"),
    (delta, ([0.5],), {"threshold": 300, "most": 1}, "from 128 to 256 .* found 300"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "numbers", "fields", "said"), REFUSED)
def test_numbers_that_are_none_are_refused_with_their_limit(make, numbers, fields, said):
    with pytest.raises(ArtifactError, match=said):
        make(*numbers, **fields)
