"""The delta code: events when an observation has moved, exact in integers, with a state."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.metadata import Record


def encoder(step=(0.5,), **fields):
    return DeltaEncoder(np.asarray(step, float), **fields)


def sent(code, xs, timesteps=1):
    """Signed events (S, T) of the first observation of one robot that sees xs."""
    state = code.start(0)
    return [code.events(np.array([[x]]), timesteps, state)[0, :, 0].tolist() for x in xs]


def test_a_trace_worked_by_hand():
    code = encoder(most=2)
    state = code.start(0)
    # step 0.5, K = 2, threshold 154/256 = 0.602; channels: +1 +2 -1 -2
    for x, spikes in (
        # X = 128, e = 128, not above 154
        (0.25, [0, 0, 0, 0]),
        # X = 154, e = 154, still not above
        (0.30, [0, 0, 0, 0]),
        # X = 155, e = 155, n = (155 + 128) >> 8 = 1, q = 1
        (0.303, [1, 0, 0, 0]),
        # X = 256, e = 0
        (0.50, [0, 0, 0, 0]),
        # X = 640, e = 384, n = (384 + 128) >> 8 = 2, q = 3: the half is sent
        (1.25, [1, 1, 0, 0]),
        # X = 614, e = 614 - 768 = -154
        (1.20, [0, 0, 0, 0]),
        # X = -512, e = -1280, n = -min(5, 2), q = 1
        (-1.0, [0, 0, 1, 1]),
        # e = -512 - 256 = -768, n = -2, q = -1
        (-1.0, [0, 0, 1, 1]),
        # e = -512 + 256 = -256, n = -1, q = -2
        (-1.0, [0, 0, 1, 0]),
        # e = 0
        (-1.0, [0, 0, 0, 0]),
    ):
        assert code.encode(np.array([[x]]), 1, state).tolist() == [[spikes]], x
    assert state.sent.tolist() == [[-2]]


def test_a_jump_is_caught_up_in_the_timesteps_of_an_inference_as_in_several():
    # X = 2560, ten events of at most 3: 3 3 3 1
    assert sent(encoder(), [5.0], 5) == [[3, 3, 3, 1, 0]]
    assert sent(encoder(), [5.0] * 5) == [[3], [3], [3], [1], [0]]
    assert sent(encoder(), [5.0, -5.0], 4) == [[3, 3, 3, 1], [-3, -3, -3, -3]]


def slow(x, step, most, threshold, q):
    """Events and new level of one observation, in Python's integers and fractions."""
    parts = 0 if step == np.inf else round(Fraction(256 * x / step))  # halves to even
    e = min(max(parts, -(2**30)), 2**30) - 256 * q
    n = min((abs(e) + 128) // 256, most) if abs(e) > threshold else 0
    n = -n if e < 0 else n
    return n, q + n


def channels(n, most, code):
    """Spikes of both signs of one observation."""
    spikes = [0] * (2 * most)
    for k in range(1, most + 1):
        if (k <= abs(n)) if code == "unary" else (k == abs(n)):
            spikes[(n < 0) * most + k - 1] = 1
    return spikes


numbers = st.floats(-40, 40).map(lambda x: x if abs(x) > 1e-300 else 0.0)
steps = st.one_of(st.floats(1e-4, 50), st.just(np.inf))


@settings(max_examples=80)
@given(
    data=st.data(),
    most=st.integers(1, 5),
    code=st.sampled_from(["unary", "one-hot"]),
    timesteps=st.integers(1, 3),
)
def test_every_spike_is_that_of_a_slow_version_in_integers(data, most, code, timesteps):
    step = data.draw(st.lists(steps, min_size=1, max_size=4))
    threshold = data.draw(st.integers(128, 256 * most))
    rows = st.lists(numbers, min_size=len(step), max_size=len(step))
    xs = data.draw(st.lists(rows, min_size=1, max_size=6))
    fast = encoder(step, most=most, code=code, threshold=threshold)
    state, levels = fast.start(0), [0] * len(step)
    for x in xs:
        expected = []
        for _ in range(timesteps):
            moved = [
                slow(*each, most, threshold, q)
                for each, q in zip(zip(x, step, strict=True), levels, strict=True)
            ]
            levels = [q for _, q in moved]
            expected.append([s for n, _ in moved for s in channels(n, most, code)])
        assert fast.encode(np.array([x]), timesteps, state)[0].tolist() == expected
        assert state.sent.tolist() == [levels]


def test_what_is_too_many_steps_is_clipped_without_a_warning():
    code = encoder([1e-300, 1e-9], most=256)
    state = code.start(0)
    for _ in range(4):
        events = code.events(np.array([[1e10, -1e10]]), 5000, state)
    assert state.sent.tolist() == [[2**22, -(2**22)]]
    assert not events[:, -1].any()


def test_another_batch_is_refused_before_anything_moves():
    code, x = encoder(), np.full((2, 1), 0.7)
    state = code.start(0)
    code.encode(x, 1, state)
    with pytest.raises(ObservationError, match=r"levels of 2 robots, .* of 3\. Call reset\(\)"):
        code.encode(np.zeros((3, 1)), 1, state)
    assert state.sent.tolist() == [[1], [1]]


def whole(step=(0.5, np.inf), timesteps=1, **fields):
    obs = len(step)
    return Codec(
        Normaliser(np.ones(obs), np.full(obs, 2.0), 5.0), encoder(step, **fields), timesteps
    )


def test_an_episode_is_its_observations_one_after_another():
    c = whole(timesteps=2)
    seen = np.random.default_rng(5).normal(0, 3, (30, 2))
    state = c.encoder.start(0)
    steps = [c.encode(row[None], state)[0] for row in seen]
    np.testing.assert_array_equal(c.encode_episode(seen), np.stack(steps))


def test_a_file_keeps_every_field():
    before = whole(timesteps=3, most=4, code="one-hot", threshold=200)
    after = Codec.from_record(Record(before.to_record(), "codec"))
    code = after.encoder
    assert (code.kind, code.most, code.code, code.threshold) == ("delta", 4, "one-hot", 200)
    np.testing.assert_array_equal(code.step, [0.5, np.inf])
    assert (code.observed, code.width) == (2, 16)
