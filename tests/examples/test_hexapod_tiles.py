"""The project examples/hexapod_tiles: its environment, scripts, networks and policies."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from examples.hexapod_tiles import HexapodTiles, HexapodTilesAhead, footholds
from examples.hexapod_tiles.env import AIRTIME, SCANS, Tiles
from examples.hexapod_tiles.footholds import RememberingScript, TileMap
from examples.hexapod_tiles.kinematics import feet, joints
from spikedeploy import envs
from spikedeploy.comparison.evaluation import run_policy
from spikedeploy.envs.hexapod.robot import LEGS, STANCE, Field
from spikedeploy.envs.rollout import rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.policies.scripts import teacher_candidate
from spikedeploy.runtime.errors import ConfigError, EnvError

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "hexapod_tiles"
AROUND, AHEAD = "examples.hexapod_tiles:HexapodTiles", "examples.hexapod_tiles:HexapodTilesAhead"


@pytest.fixture(scope="module")
def env():
    return HexapodTiles()


# policies


@pytest.mark.parametrize(
    ("key", "file", "chip", "name"),
    [
        ("snn", "legs-snn.nir", "loihi1", AROUND),
        ("mlp", "legs-mlp.onnx", None, AROUND),
        ("ahead", "legs-mlp-ahead.onnx", None, AHEAD),
    ],
)
def test_policies_act_as_they_did_when_they_were_shipped(key, file, chip, name):
    known = np.load(Path(__file__).with_name("hexapod_tiles.npz"))
    player = open_policy(find(str(FOLDER / "policies" / file)), chip, envs.make(name))
    player.reset(1)
    actions = [player.act(seen) for seen in known[f"{key}_observations"]]
    if chip:
        assert np.array_equal(actions, known[f"{key}_actions"])
    else:  # float32, by the machine's own kernels
        np.testing.assert_allclose(actions, known[f"{key}_actions"], atol=1e-5)


def test_a_policy_of_the_project_runs_in_the_environment_that_the_user_names(monkeypatch):
    monkeypatch.chdir(ROOT)
    policy = "examples/hexapod_tiles/policies/legs-snn.nir"
    found = run_policy(policy, AROUND, None, [10_000], Setup(set_=("max_steps=20",)))
    assert found.env == AROUND


def test_code_is_not_run_because_a_file_names_it(monkeypatch):
    monkeypatch.chdir(ROOT)
    with pytest.raises(ConfigError, match="--env"):
        run_policy(str(FOLDER / "policies/legs-snn.nir"), None, None, [10_000])


# legs


def test_feet_are_where_mujoco_has_them(env):
    env.reset(seed=0)
    model, data = env.robot.model, mujoco.MjData(env.robot.model)
    rng = np.random.default_rng(0)
    for _ in range(5):
        angles = STANCE + rng.uniform(-0.5, 0.5, 18)
        data.qpos[:] = 0.0
        data.qpos[3] = 1.0
        data.qpos[7:] = angles
        mujoco.mj_kinematics(model, data)
        places = [data.geom_xpos[model.geom(f"{leg}_foot").id] for leg in LEGS]
        np.testing.assert_allclose(feet(angles), places, atol=1e-6)  # hexapod.xml rounds angles


def test_joints_bring_feet_to_their_places():
    rng = np.random.default_rng(1)
    angles = STANCE + rng.uniform(-0.4, 0.4, (20, 18))
    np.testing.assert_allclose(joints(feet(angles)), angles, atol=1e-9)
    assert np.isfinite(joints(feet(STANCE) * [3.0, 3.0, 1.0])).all()  # as far as legs reach


# tiles and their scan


def test_a_point_has_the_tile_that_it_lies_on():
    forbidden = np.zeros((3, 2), bool)
    forbidden[2, 1] = True
    tiles = Tiles(forbidden, 0.1, (-0.1, 0.0))
    points = np.array([[0.15, 0.19], [0.15, 0.05], [0.05, 0.15], [0.25, 0.15]])
    assert tiles.contain(points).tolist() == [True, False, False, False]
    np.testing.assert_allclose(tiles.centres, [[0.15, 0.15]])


def test_a_share_is_forbidden_and_none_at_the_start():
    field = Field(length=10.0, width=5.0, start=(-4.0, 0.0))
    tiles = Tiles.draw(field, 0.1, 0.3, np.random.default_rng(0))
    assert tiles.forbidden.shape == (100, 50)
    assert tiles.forbidden.mean() == pytest.approx(0.3, abs=0.02)
    assert np.hypot(*(tiles.centres - field.start).T).min() >= 0.42


@pytest.mark.parametrize("view", ["around", "ahead"])
def test_a_scan_moves_and_turns_with_the_body(view):
    env = HexapodTiles(view=view, noise=0.0)
    observation, _ = env.reset(seed=4)
    for _ in range(60):
        observation, *_ = env.step(np.full(18, 0.05))
    motion = env.robot.sense()
    for (ahead, left), seen in zip(SCANS[view], observation[env.OBSERVATION["scan"]], strict=True):
        x, y = motion.position[:2]
        x += ahead * math.cos(motion.heading) - left * math.sin(motion.heading)
        y += ahead * math.sin(motion.heading) + left * math.cos(motion.heading)
        i, j = math.floor((x + 5.0) / 0.1), math.floor((y + 2.5) / 0.1)
        assert seen == env.tiles.forbidden[i, j]


def test_a_delay_line_shows_the_nearest_row_as_it_was_seen_before():
    env = HexapodTilesAhead(delays=4, noise=0.0)
    script = RememberingScript()
    observation, _ = env.reset(seed=2)
    rows = []
    for _ in range(150):  # to where tiles are forbidden
        rows.append(observation[env.OBSERVATION["scan"]][:23])
        observation, *_ = env.step(script(observation))
    earlier = observation[env.OBSERVATION["earlier"]].reshape(4, 23)
    np.testing.assert_array_equal(earlier, [rows[-6], rows[-12], rows[-18], rows[-24]])
    assert len(np.unique(earlier, axis=0)) > 1
    observation, _ = env.reset(seed=3)
    assert not observation[env.OBSERVATION["earlier"]].any()


def test_noise_is_the_share_of_points_that_are_wrong():
    def scans(noise):
        env = HexapodTiles(noise=noise)
        found = [env.reset(seed=seed)[0][env.OBSERVATION["scan"]] for seed in range(20)]
        return np.concatenate(found)

    assert (scans(0.1) != scans(0.0)).mean() == pytest.approx(0.1, abs=0.02)


# what counts


def test_touchdowns_and_missteps_are_those_that_a_plain_count_finds(env):
    observation, _ = env.reset(seed=2)
    airtime, touchdowns, missteps = [0] * 6, 0, 0
    for _ in range(250):
        observation, _, _, _, info = env.step(footholds(observation))
        contact = env.robot.sense().contact
        for leg, name in enumerate(LEGS):
            x, y, _ = env.robot.data.geom(f"{name}_foot").xpos
            on = env.tiles.forbidden[math.floor((x + 5.0) / 0.1), math.floor((y + 2.5) / 0.1)]
            if contact[leg] and airtime[leg] >= AIRTIME:
                touchdowns += 1
                missteps += on
            airtime[leg] = 0 if contact[leg] else airtime[leg] + 1
        assert (info["touchdowns"], info["missteps"]) == (touchdowns, missteps)
        assert info["misstep_share"] == missteps / max(touchdowns, 1)
        assert info["reward_terms"]["jerk"] == 0.0
    assert touchdowns > 30


def test_an_action_moves_the_servos_targets_and_they_keep_to_their_reach(env):
    env.reset(seed=0)
    action = np.linspace(-1.0, 1.0, 18)
    observation, *_ = env.step(action)
    np.testing.assert_allclose(observation[env.OBSERVATION["previous"]], 0.25 * action)
    for _ in range(12):
        observation, *_ = env.step(action)
    assert np.abs(observation[env.OBSERVATION["previous"]]).max() == 2.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"view": "behind"}, "view"),
        ({"tile": 0.0}, "tile"),
        ({"share": (0.1, 0.2)}, "share"),
        ({"noise": 0.9}, "noise"),
        ({"delays": 3}, "delays"),
        ({"view": "ahead", "delays": 2.5}, "delays"),
        ({"view": "ahead", "delays": 61}, "delays"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(EnvError, match=message):
        HexapodTiles(**options)


# scripts


def test_the_script_succeeds_as_a_teacher_and_standing_does_not(env):
    world = envs.make(AROUND)
    player = open_policy(teacher_candidate("examples.hexapod_tiles:footholds"), None, world)
    played = rollout(world, player, seed=10_000)
    assert played.success
    assert played.info["distance"][-1] > 2.5
    assert played.info["misstep_share"][-1] <= 0.05
    assert not played.info["success"][played.info["distance"] < 2.5].any()
    env.reset(seed=10_000)
    for _ in range(100):
        *_, info = env.step(np.zeros(18))
    assert (info["fall"], info["touchdowns"], info["success"]) == (False, 0, False)


def test_looking_ahead_the_script_steps_by_its_map():
    """With pushes; what lies about the feet was seen before, and has to be remembered."""
    world = envs.make(AHEAD, max_steps=400)
    player = open_policy(teacher_candidate("examples.hexapod_tiles:footholds_ahead"), None, world)
    played = rollout(world, player, seed=5_001)
    assert played.info["touchdowns"][-1] > 40
    assert played.info["misstep_share"][-1] < 0.08  # blind it is about 0.28
    player.reset(0)
    fresh = RememberingScript()(played.observation[0])
    np.testing.assert_allclose(player.act(played.observation[0]), fresh, atol=1e-9)


def test_a_map_takes_the_majority_of_its_points():
    found, points = TileMap(), np.array([[0.51, 0.1], [0.53, 0.1]])
    assert found.look_up(points).tolist() == [0.0, 0.0]
    found.add(points, np.array([1.0, 0.0]))
    assert found.look_up(points + 0.005).tolist() == [1.0, 0.0]
    for _ in range(2):
        found.add(points, np.array([0.0, 1.0]))
    assert found.look_up(points).tolist() == [0.0, 1.0]
