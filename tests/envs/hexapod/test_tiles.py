import math

import mujoco
import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.hexapod.footholds import FootholdScript, TileMap
from spikedeploy.envs.hexapod.legs import feet, joints
from spikedeploy.envs.hexapod.robot import LEGS, STANCE, Field
from spikedeploy.envs.hexapod.tiles import AIRTIME, SCANS, HexapodTilesEnv, Tiles
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.recordings import record
from spikedeploy.runtime.errors import ConfigError, EnvError


def walk(env, seed, steps=None):
    """Infos of an episode of the script."""
    script = FootholdScript(env)
    observation, _ = env.reset(seed=seed)
    infos, over = [], False
    while not over and len(infos) != steps:
        observation, _, terminated, truncated, info = env.step(script.act(observation))
        infos.append(info)
        over = terminated or truncated
    return infos


# legs


@pytest.fixture(scope="module")
def env():
    return HexapodTilesEnv()


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
    far = feet(STANCE) * [3.0, 3.0, 1.0]
    assert np.isfinite(joints(far)).all()  # as far as legs reach


# tiles


def test_a_point_has_the_tile_that_it_lies_on():
    forbidden = np.zeros((3, 2), bool)
    forbidden[2, 1] = True
    tiles = Tiles(forbidden, 0.1, (-0.1, 0.0))
    on, beside, before, beyond = [0.15, 0.19], [0.15, 0.05], [0.05, 0.15], [0.25, 0.15]
    assert tiles.at(np.array([on, beside, before, beyond])).tolist() == [True, False, False, False]
    np.testing.assert_allclose(tiles.centres, [[0.15, 0.15]])


def test_a_course_that_is_turned_is_what_heading_offset_and_distance_are_relative_to(env):
    script = FootholdScript(env)
    seen, _ = env.reset(seed=3)
    heading, lateral = (env.OBSERVATION[name] for name in ("heading", "lateral"))
    for _ in range(50):
        seen, *_, before = env.step(script.act(seen))
    env.steer(math.pi / 2)
    seen, *_, info = env.step(script.act(seen))
    centre, spread = env.scaling
    measured = seen * spread + centre
    assert measured[heading][0] == pytest.approx(info["heading"] - math.pi / 2)
    assert abs(measured[lateral][0]) < 0.01
    assert info["distance"] == pytest.approx(before["distance"], abs=0.01)
    for _ in range(400):
        seen, *_, info = env.step(script.act(seen))
    # it walks along y now, still on free tiles, and what it came far counts
    x, y, _ = env.robot.sense().position
    assert abs(info["heading"] - math.pi / 2) < 0.3
    assert y > 1.0 > abs(x - env.FIELD.start[0])
    assert info["distance"] == pytest.approx(before["distance"] + y, abs=0.3)
    assert info["misstep_share"] < 0.1
    assert not info["fall"]
    env.reset(seed=3)
    assert env.course == 0.0
    with pytest.raises(EnvError, match="no direction"):
        env.steer(math.nan)


def test_a_share_is_forbidden_and_none_at_the_start():
    field = Field(length=10.0, width=5.0, start=(-4.0, 0.0))
    tiles = Tiles.draw(field, 0.1, 0.3, np.random.default_rng(0))
    assert tiles.forbidden.shape == (100, 50)
    assert tiles.forbidden.mean() == pytest.approx(0.3, abs=0.02)
    assert np.hypot(*(tiles.centres - field.start).T).min() >= 0.42


@pytest.mark.parametrize("view", ["around", "ahead"])
def test_a_scan_moves_and_turns_with_the_body(view):
    env = HexapodTilesEnv(view=view, noise=0.0)
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
    env = HexapodTilesEnv(view="ahead", delays=4, noise=0.0)
    script = FootholdScript(env)
    observation, _ = env.reset(seed=2)
    rows = []
    for _ in range(150):  # to where tiles are forbidden
        rows.append(observation[env.OBSERVATION["scan"]][:23])
        observation, *_ = env.step(script.act(observation))
    earlier = observation[env.OBSERVATION["earlier"]].reshape(4, 23)
    np.testing.assert_array_equal(earlier, [rows[-6], rows[-12], rows[-18], rows[-24]])
    assert len(np.unique(earlier, axis=0)) > 1
    observation, _ = env.reset(seed=3)
    assert not observation[env.OBSERVATION["earlier"]].any()


def test_noise_is_the_share_of_points_that_are_wrong():
    def scans(noise):
        env = HexapodTilesEnv(noise=noise)
        found = [env.reset(seed=seed)[0][env.OBSERVATION["scan"]] for seed in range(20)]
        return np.concatenate(found)

    assert (scans(0.1) != scans(0.0)).mean() == pytest.approx(0.1, abs=0.02)


# what counts


def test_touchdowns_and_missteps_are_those_that_a_plain_count_finds(env):
    script = FootholdScript(env)
    observation, _ = env.reset(seed=2)
    airtime, touchdowns, missteps = [0] * 6, 0, 0
    for _ in range(250):
        observation, _, _, _, info = env.step(script.act(observation))
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


def test_the_script_succeeds_and_standing_does_not(env):
    infos = walk(env, 10_000)
    assert infos[-1]["success"]
    assert infos[-1]["distance"] > 2.5
    assert infos[-1]["misstep_share"] <= 0.05
    assert not any(info["success"] for info in infos if info["distance"] < 2.5)
    env.reset(seed=10_000)
    for _ in range(100):
        *_, info = env.step(np.zeros(18))
    assert not info["fall"]
    assert info["touchdowns"] == 0
    assert not info["success"]


def test_the_script_is_a_policy_of_both_views(env):
    player = open_policy(find("footholds"), None, envs.make("hexapod-tiles"))
    observation, _ = env.reset(seed=1)
    np.testing.assert_array_equal(player.act(observation), FootholdScript(env).act(observation))
    assert open_policy(find("footholds"), None, envs.make("hexapod-tiles", view="ahead"))
    with pytest.raises(ConfigError, match="footholds is for hexapod-tiles"):
        open_policy(find("footholds"), None, envs.make("hexapod"))


def test_looking_ahead_the_script_steps_by_its_map():
    """With pushes; what lies about the feet was seen before, and has to be remembered."""
    ahead = HexapodTilesEnv(view="ahead")
    script = FootholdScript(ahead)
    observation, _ = ahead.reset(seed=5_001)
    for _ in range(400):
        observation, *_, info = ahead.step(script.act(observation))
    assert info["touchdowns"] > 40
    assert info["misstep_share"] < 0.08  # blind it is about 0.28


def test_a_map_takes_the_majority_of_its_points():
    found, points = TileMap(), np.array([[0.51, 0.1], [0.53, 0.1]])
    assert found.at(points).tolist() == [0.0, 0.0]
    found.add(points, np.array([1.0, 0.0]))
    assert found.at(points + 0.005).tolist() == [1.0, 0.0]
    for _ in range(2):
        found.add(points, np.array([0.0, 1.0]))
    assert found.at(points).tolist() == [0.0, 1.0]


def test_operations_of_the_script_are_counted_and_shown(env):
    player = open_policy(find("footholds"), None, envs.make("hexapod-tiles"))
    played = rollout(envs.make("hexapod-tiles", max_steps=30), player, seed=1)
    found = player.costs(played).operations
    # three legs swing: 35 points are compared for each, and six legs have inverse kinematics
    assert found["comparisons"] >= 3 * 34
    assert (found["arccos"], found["hypot"]) == (12, 12)
    assert 1_000 < found["multiplications"] < 1_500 < found["additions"] < 2_000


def test_pages_show_tiles_and_missteps():
    world = envs.make("hexapod-tiles", share=0.6, max_steps=200)
    found = record(world, find("random"), None, "random", 10_000, "horowitz45")
    tiles = found.shapes["tiles"]
    assert tiles["size"] == 0.1
    assert len(tiles["centres"]) == len(world.unwrapped.tiles.centres)
    assert [mark[0] for mark in tiles["missed"]] == [s for s, *_ in world.unwrapped.missed]


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
        ({"view": "behind"}, "neither around nor ahead"),
        ({"tile": 0.0}, "from 0.02 to 1"),
        ({"share": (0.1, 0.2)}, "give one number"),
        ({"noise": 0.9}, "from 0 to 0.5"),
        ({"delays": 3}, "no rows to delay"),
        ({"view": "ahead", "delays": 2.5}, "no whole number"),
        ({"view": "ahead", "delays": 61}, "from 0 to 60"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(EnvError, match=message):
        HexapodTilesEnv(**options)
