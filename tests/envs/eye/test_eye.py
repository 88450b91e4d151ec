"""kart-eye: one kart equals a batch, rates share a physics, gates are quiet, the teacher drives."""

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.eye.batch import EyeBatch, EyeOptions, nearest_action


def drive(batch, steps):
    """Steps of the teacher: counts (S, B, ...) and the last outcome of each kart."""
    counts, ended = [], {}
    for _ in range(steps):
        seen, _, terminated, truncated, info = batch.step(nearest_action(batch.teacher()))
        counts.append(seen)
        for b in np.flatnonzero(terminated | truncated).tolist():
            ended.setdefault(b, {name: info[name][b] for name in ("finish", "wrong", "crash")})
    return np.stack(counts), ended


def test_a_kart_is_the_same_alone_and_in_a_batch():
    together, alone = EyeBatch(3), envs.make("kart-eye")
    together.reset([10_000, 7, 10_002])
    alone.reset(seed=7)
    for _ in range(40):
        action = nearest_action(together.teacher())
        seen, reward, *_ = together.step(action)
        observed, earned, *_ = alone.step(action[1])
        np.testing.assert_array_equal(observed, seen[1].reshape(-1))
        assert earned == reward[1]


@pytest.mark.parametrize("signs", ["letters", "chevrons"])
def test_the_teacher_passes_all_forks_of_unseen_courses(signs):
    batch = EyeBatch(8, signs=signs, forks=2)
    batch.reset(range(10_000, 10_008))
    _, ended = drive(batch, 340)
    assert len(ended) == 8
    assert all(each["finish"] and not each["wrong"] | each["crash"] for each in ended.values())


@pytest.mark.parametrize("rate", [240, 960])
def test_held_actions_drive_the_same_path_at_every_rate(rate):
    slow, fast = EyeBatch(2), EyeBatch(2, rate=rate)
    for batch in (slow, fast):
        batch.reset([1, 2])
    for step in range(12):
        action = np.array([step % 7, 3])
        slow.step(action)
        for _ in range(rate // 60):
            fast.step(action)
    for name in ("x", "y", "heading", "turn", "speed"):
        np.testing.assert_array_equal(getattr(slow, name), getattr(fast, name))


def test_a_kart_waits_at_gates_for_the_share_of_time_that_was_asked_for_and_is_quiet():
    batch = EyeBatch(8, quiet=0.5, forks=2, camera={"shot_noise_hz": 0.0})
    batch.reset(range(8))
    waits = quiet = lasted = 0
    over = np.zeros(8, np.bool_)
    for _ in range(1100):
        seen, _, terminated, _, info = batch.step(nearest_action(batch.teacher()))
        still = info["waiting"] & ~over
        lasted += (~over).sum()
        over |= terminated
        waits, quiet = waits + still.sum(), quiet + (still & ~seen.any((1, 2, 3))).sum()
    assert over.all()
    assert waits / lasted == pytest.approx(0.5, abs=0.08)
    assert quiet > 0.7 * waits > 0


def test_the_wrong_arm_ends_the_episode_and_is_no_crash():
    batch = EyeBatch(2)
    batch.reset([3, 3])
    arm = batch.known()["arm"][0]
    for _ in range(400):
        steering = batch.teacher()
        batch._arm[1] = -arm  # the second kart is told the other arm
        steering[1] = batch.teacher()[1]
        batch._arm[1] = arm
        _, _, terminated, _, info = batch.step(nearest_action(steering))
        if terminated[1]:
            break
    assert info["wrong"][1]
    assert not info["crash"][1]


@pytest.mark.parametrize(
    ("options", "words"),
    [({"rate": 50}, "60, 240 or 960"), ({"quiet": 1.0}, "0 to 0.95"), ({"signs": "x"}, "letters")],
)
def test_an_option_that_is_not_valid_is_one_sentence(options, words):
    with pytest.raises(EnvError, match=words):
        EyeOptions(**options)
