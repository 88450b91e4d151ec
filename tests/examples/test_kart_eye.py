"""kart-eye: one kart equals a batch, rates share a physics, gates are quiet, the teacher drives."""

import numpy as np
import pytest

from examples.kart_eye.batch import EyeBatch, EyeOptions, nearest_action
from examples.kart_eye.course import draw_course
from spikedeploy import envs
from spikedeploy.comparison.evaluation import compare_policies, line_up
from spikedeploy.envs.rollout import rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.exporters.parity import check as parity
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.policies.costs import NOTHING
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import train
from tests.paths import ROOT

ENV = "examples.kart_eye:KartEye"
POLICIES = ROOT / "examples/kart_eye/policies"


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
    together, alone = EyeBatch(3), envs.make(ENV)
    together.reset([10_000, 7, 10_002])
    alone.reset(seed=7)
    for _ in range(40):
        action = nearest_action(together.teacher())
        seen, reward, *_ = together.step(action)
        observed, earned, *_ = alone.step(action[1])
        np.testing.assert_array_equal(observed, seen[1].reshape(-1))
        assert earned == reward[1]


def test_the_teacher_passes_all_forks_of_unseen_courses():
    batch = EyeBatch(4, forks=2)
    batch.reset(range(10_000, 10_004))
    _, ended = drive(batch, 340)
    assert len(ended) == 4
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


def test_events_of_a_second_are_as_many_at_every_rate():
    totals = []
    for each in (60, 240):
        batch = EyeBatch(2, rate=each)
        batch.reset(range(2))
        straight = np.full(2, 3)
        totals.append(sum(batch.step(straight)[0].sum(dtype=np.int64) for _ in range(each)))
    assert totals[1] == pytest.approx(totals[0], rel=0.06)


def test_a_kart_waits_at_gates_and_is_quiet_there():
    batch = EyeBatch(4, quiet=0.5, forks=1)
    batch.reset(range(4))
    events, steps = np.zeros(2), np.zeros(2)  # driving, waiting
    for _ in range(250):
        seen, _, _, _, info = batch.step(nearest_action(batch.teacher()))
        waits = info["waiting"] & batch.closed & (batch._hold > 0.5)
        for state, mask in ((0, batch.speed > 2.9), (1, waits)):
            events[state] += seen[mask].sum(dtype=np.int64)
            steps[state] += mask.sum()
    driving, waiting = events / steps
    assert 0 < waiting < driving / 50
    assert steps[1] > 100


def test_the_wrong_arm_ends_the_episode_and_is_no_crash():
    batch = EyeBatch(2)
    batch.reset([3, 3])
    arm = batch.courses[0].arm[0]
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
    with pytest.raises(ValueError, match=words):
        EyeOptions(**options)


def test_the_world_is_frozen():
    course = draw_course(10_000, 6, "letters", 1.0)
    assert course.arm.tolist() == [-1, 1, -1, -1, 1, 1]
    assert course.pictures.sum(dtype=np.float64) == pytest.approx(-17140.1076, rel=1e-6)
    batch = EyeBatch(2, quiet=0.2)
    batch.reset([10_000, 10_001])
    seen = np.stack([batch.step(nearest_action(batch.teacher()))[0] for _ in range(240)])
    assert batch.x == pytest.approx([5.79661909518106, 6.0297083321673], abs=1e-9)
    assert batch.y == pytest.approx([2.0001735584526754, 2.0001751975254645], abs=1e-9)
    # a last bit of an exponential may move an event
    assert seen.sum((0, 2, 3, 4), dtype=np.int64) == pytest.approx([101257, 116444], rel=1e-3)


def test_the_expert_drives_by_no_observation_and_costs_nothing():
    world = envs.make(ENV, forks=1)
    player = open_policy(find("expert"), None, world)
    played = rollout(world, player, 10_000)
    assert played.success
    assert player.costs(played) is NOTHING
    with pytest.raises(ConfigError, match="looks at no observations"):
        player.replay(played.observation[:-1])
    with pytest.raises(ConfigError, match="has no expert"):
        rollout(karts := envs.make("kart-grid"), open_policy(find("expert"), None, karts), 0)


# what they did when they were shipped: actions of 120 control steps from seed 10,000 on
SHIPPED = [
    (
        "cnn.onnx",
        None,
        "154444444444444433333333333322222222223333333333333444344433333333333333333333333333333333333333333333333331000000000000",
    ),
    (
        "if.nir",
        "speck2f",
        "005555555555444433333222222222222222222233333344444444444433333333333333333333333333333222333333333333333333300000000000",
    ),
    (
        "snn.nir",
        "loihi1",
        "444434333333344444444444433333222222222223333333333333333334444433333333333233333333333323333333333333333333100000000000",
    ),
    (
        "snn.nir",
        "float",
        "444434333333444433344433333333232333333333333333443333333332222222222233333334444444444443343333333332323331000000000000",
    ),
]


@pytest.mark.parametrize(("file", "chip", "actions"), SHIPPED)
def test_shipped_policies_act_as_they_did(file, chip, actions):
    world = envs.make(ENV, forks=2, max_steps=120)
    candidate = find(str(POLICIES / file))
    assert candidate.env == ENV
    played = rollout(world, open_policy(candidate, chip, world), 10_000)
    assert "".join(str(int(action)) for action in played.action) == actions


def test_a_float_policy_with_a_memory_is_compared_beside_the_expert():
    setup = Setup(set_=("max_steps=12",))
    entries = line_up(ENV, [str(POLICIES / "cnn.onnx"), "expert"], (), setup=setup)
    found = compare_policies(ENV, entries, range(10_000, 10_002), 1).as_json()
    rows = {row["policy"]: row for row in found}
    # what looks at no observation is compared by what it earns alone
    assert {name: row["reference"] for name, row in rows.items()} == {
        "cnn": None, "random": "cnn", "expert": None,
    }  # fmt: skip
    assert 0 < rows["cnn"]["effective_macs"] < rows["cnn"]["macs_dense"]


def test_a_convolutional_network_imitates_the_expert_in_the_integers_of_loihi(tmp_path):
    settings = ["states=20", "updates=4", "iterations=2", "batch=8", "env.count=2", "log_every=2"]
    validation = ["validation.every=4", "validation.episodes=1", "validation.limit=5"]
    config = str(POLICIES.parent / "snn.toml")
    changes = {"config_file": config, "overrides": settings + validation}
    run = train("distill-network", env=ENV, runs=tmp_path, quiet=True, **changes)
    policy = RunFolder(run).policy()
    path = to_nir(policy, Provenance(ENV, "distill-network"), tmp_path / "snn.nir")
    seen = np.random.default_rng(0).poisson(0.4, (6, 1024)).astype(float)
    assert all(check.passed for check in parity(policy, path, seen))
    assert policy.network.takes == (2, 16, 32)


def test_a_picture_shows_the_view_its_events_and_the_map():
    env = envs.make(ENV, render_mode="rgb_array")
    env.reset(seed=3)
    first = env.render()
    for _ in range(5):
        env.step(3)
    assert first.shape == env.render().shape == (720, 960, 3)
    assert (env.render() != first).mean() > 0.1
