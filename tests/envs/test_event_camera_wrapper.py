"""Event cameras on environments: what they see, when, and what is recorded."""

import math

import gymnasium
import h5py
import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.event_camera_wrapper import EventCameraWrapper, average
from spikedeploy.runtime.errors import EnvError

IDEAL = {"mismatch": 0.0}


class Lamp(gymnasium.Env):
    """A grey wall whose left half is as bright as the action says, in a picture of 8 x 20."""

    observation_space = gymnasium.spaces.Box(0.0, 255.0, (1,))
    action_space = gymnasium.spaces.Box(0.0, 255.0, (1,))
    metadata = {"render_modes": ["rgb_array", "ansi"], "render_fps": 50}  # noqa: RUF012

    def __init__(self, render_mode="rgb_array", fps=50):
        self.render_mode = render_mode
        self.metadata = {"render_fps": fps}

    def reset(self, *, seed=None, options=None):
        self._light = 50.0
        return np.array([self._light]), {"wall": 1}

    def step(self, action):
        self._light = float(action[0])
        return np.array([self._light]), 1.0, False, False, {"wall": 2}

    def render(self):
        if self.render_mode == "ansi":
            return "dark"
        picture = np.full((8, 20, 3), 100, np.uint8)
        picture[:, :10] = round(self._light)
        return picture


def hopper(**options):
    return gymnasium.make("Hopper-v5", render_mode="rgb_array", **options)


def watched(**options):
    return EventCameraWrapper(Lamp(), (4, 10), IDEAL, **options)


def test_counts_are_the_changes_of_each_pixel_in_the_control_step():
    env = watched()
    seen, info = env.reset(seed=1)
    assert not seen.any()
    assert len(info["events"]) == 0
    seen, reward, *_, info = env.step(np.array([100.0]))  # ln 2 / 0.2 is 3.47
    assert (reward, info["wall"]) == (1.0, 2)
    assert (seen[0] == [[3] * 5 + [0] * 5] * 4).all()
    assert not seen[1].any()
    seen, *_ = env.step(np.array([45.0]))  # 0.71 below the 0.6 above 50 that is remembered
    assert (seen[1] == [[3] * 5 + [0] * 5] * 4).all()
    assert env.observation_space.contains(seen)


@pytest.mark.parametrize(
    ("frames", "times"), [(1, [6667, 13333, 20000]), (2, [10000, 20000, 20000])]
)
def test_frames_between_two_pictures_are_interpolated_in_the_logarithm(frames, times):
    env = watched(frames=frames)
    env.reset(seed=1)
    *_, info = env.step(np.array([50.0 * math.exp(0.7)]))  # passes 0.2 in the first half
    events = info["events"]
    one = events[(events["x"] == 2) & (events["y"] == 1)]
    # each frame divides its time by as many events as it has: one, then two
    assert one["t"].tolist() == ([10000, 15000, 20000] if frames == 2 else times)
    *_, info = env.step(np.array([50.0]))
    assert info["events"]["t"].min() > 20000


def test_the_same_seed_gives_the_same_events_and_another_other_pixels():
    def events(seed):
        env = EventCameraWrapper(Lamp(), (4, 10), "noisy", frames=3)
        env.reset(seed=seed)
        found = [env.step(np.array([light]))[-1]["events"] for light in (80, 200, 30)]
        return np.concatenate(found).tolist()

    assert events(1) == events(1) != events(2)


def test_a_recording_holds_all_events_and_is_there_after_close(tmp_path):
    path, found = tmp_path / "lamp.h5", []
    env = watched(frames=2, record=path)
    for seed in (1, 2):
        env.reset(seed=seed)
        found += [env.step(np.array([light]))[-1]["events"] for light in (90, 20)]
    assert not path.exists()
    env.close()
    with h5py.File(path) as file:
        group = file["events"]
        for name in "xytp":
            assert (group[name][:] == np.concatenate(found)[name]).all()
        assert (group.attrs["height"], group.attrs["width"]) == (4, 10)
        assert "Lamp" in file.attrs["remark"]
        assert (np.diff(group["t"][:]) >= 0).all()  # time runs on over episodes


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1", "kart-gazebo"])
def test_it_sees_worlds_that_draw(name):
    env = EventCameraWrapper(envs.make(name, render_mode="rgb_array"), frames=2)
    env.action_space.seed(0)
    env.reset(seed=0)
    total = 0
    for _ in range(15):
        seen, _, over, *_ = env.step(1 if "kart" in name else env.action_space.sample())
        assert env.observation_space.contains(seen)
        total += int(seen.sum())
        if over:
            break
    assert total > 5
    env.close()


def test_pictures_between_the_steps_of_mujoco_leave_its_physics_as_they_are():
    plain = gymnasium.make("Hopper-v5")
    times = []
    drawn = hopper(width=96, height=48)
    seen = EventCameraWrapper(drawn, (24, 48), "clean", 3)
    view = seen._picture
    seen._picture = lambda: times.append(drawn.unwrapped.data.time) or view()
    plain.reset(seed=5)
    try:
        seen.reset(seed=5)
    except Exception as error:  # every GL library raises its own type
        pytest.skip(f"this machine cannot draw: {error}")
    total = 0
    plain.action_space.seed(0)
    for _ in range(10):
        action = plain.action_space.sample()
        plain.step(action)
        total += int(seen.step(action)[0].sum())
        assert (drawn.unwrapped.data.qpos == plain.unwrapped.data.qpos).all()
    assert total > 0
    # the start, then after 1, 2 and 4 of the four steps of 2 ms
    assert times[:4] == pytest.approx([0.0, 0.002, 0.004, 0.008])
    seen.close()


def test_pictures_are_averaged_over_the_area_of_each_pixel():
    picture = np.random.default_rng(0).uniform(0, 255, (12, 20)).astype(np.float32)
    even = picture.reshape(4, 3, 5, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(average(picture, (4, 5)), even, rtol=1e-5)
    odd = average(picture, (5, 7))
    assert odd.mean() == pytest.approx(picture.mean(), rel=1e-5)
    # 2.4 rows and 20 / 7 columns in a pixel; the last column covers its part of the third
    weights = np.outer([1, 1, 0.4], [1, 1, 6 / 7])
    assert odd[0, 0] == pytest.approx((picture[:3, :3] * weights).sum() / (2.4 * 20 / 7), rel=1e-5)


def test_make_puts_one_on_an_environment_of_other_people():
    env = envs.make("CartPole-v1", event_camera={"size": [16, 32], "frames": 2})
    observation, _ = env.reset(seed=0)
    assert observation.shape == env.observation_space.shape == (2 * 16 * 32,)
    assert env.given == {"event_camera": {"size": [16, 32], "frames": 2}}
    assert sum(env.step(0)[0].sum() for _ in range(8)) > 0
    assert envs.make("CartPole-v1", event_camera=True).observation_space.shape == (4096,)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: EventCameraWrapper(Lamp(None)), 'make it with render_mode="rgb_array"'),
        (lambda: EventCameraWrapper(Lamp(fps=0)), "give dt"),
        (lambda: EventCameraWrapper(Lamp(), (4, 10, 3)), "a size of"),
        (lambda: EventCameraWrapper(Lamp(), (-4, 10)), "a shape of"),
        (lambda: EventCameraWrapper(Lamp(), frames=0), "0 frames"),
        (lambda: EventCameraWrapper(Lamp(), frames=1.5), "1.5 frames"),
        (lambda: envs.make("CartPole-v1", event_camera={"record": "a.h5"}), "size, parameters"),
        (lambda: envs.make("CartPole-v1", event_camera="noisy"), "neither true nor options"),
        (lambda: EventCameraWrapper(hopper(), frames=9), "at most 4"),
    ],
)  # fmt: skip
def test_what_cannot_be_seen_is_refused_in_a_line(make, message):
    with pytest.raises(EnvError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_a_picture_that_is_none_is_refused():
    env = EventCameraWrapper(lamp := Lamp())
    lamp.render_mode = "ansi"
    with pytest.raises(EnvError, match=r"render\(\) gave str"):
        env.reset(seed=0)
