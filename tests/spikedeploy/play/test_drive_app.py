"""Windows: what keys do, what is drawn, and how they close. No display is needed."""

import numpy as np
import pygame
import pytest

from spikedeploy import envs
from spikedeploy.comparison.evaluation import run_policy
from spikedeploy.envs.rollout import Rollout, rollout
from spikedeploy.play import window
from spikedeploy.play.drive import (
    CommandedPolicyDriver,
    DriveApp,
    KeyboardDriver,
    open_session,
)
from spikedeploy.runtime.errors import ConfigError
from tests import toy_stroll_env

KARTS = {
    "kart-grid": {"w": "up", "s": "down", "a": "left", "d": "right"},
    "kart-gazebo": {"w": "forward", "a": "left", "d": "right"},
    "kart-steer": {"w": "accelerate", "s": "brake", "space": "brake", "a": "left", "d": "right"},
}


@pytest.fixture(autouse=True)
def dummy(monkeypatch):
    """A display that shows nothing."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


def key(name, kind=pygame.KEYDOWN):
    return pygame.Event(kind, key=pygame.key.key_code(name))


def up(name):
    return key(name, pygame.KEYUP)


@pytest.fixture
def key_names():
    pygame.display.init()  # which names keys
    return None


class Script(window.App):
    """Posts events into a window, so many frames after it opened."""

    def __init__(self, app, **events):
        self._app, self.frame = app, 0
        self._events = {int(name[1:]): posted for name, posted in events.items()}
        self.title, self.name, self.fps = app.title, app.name, 10_000.0

    def handle(self, event):
        self._app.handle(event)

    def tick(self):
        self.frame += 1
        for event in self._events.get(self.frame, ()):
            pygame.event.post(event)
        self._app.tick()

    def draw(self):
        return self._app.draw()


def drive(env, **options):
    return open_session(env, options, None, None, 10_000)


@pytest.mark.usefixtures("key_names")
@pytest.mark.parametrize("name", KARTS)
def test_the_keys_of_kart_simulator_drive_every_kart(name):
    driven = drive(name)
    for cap, action in KARTS[name].items():
        driven.driver.handle(key(cap))
        assert driven.world.ACTIONS[driven.driver.act(None)] == action
        driven.driver.handle(up(cap))
        assert driven.driver.act(None) == 0
    assert isinstance(driven.driver, KeyboardDriver)


@pytest.mark.usefixtures("key_names")
def test_the_key_pressed_last_counts_and_the_one_before_goes_on_after_it():
    keys = KeyboardDriver(("none", "accelerate", "brake", "left", "right"))
    keys.handle(key("w"))
    keys.handle(key("a"))
    assert keys.act(None) == 3
    keys.handle(up("a"))
    assert keys.act(None) == 1
    keys.handle(key("q"))  # drives nothing
    assert keys.act(None) == 1


@pytest.mark.usefixtures("key_names")
def test_a_continuous_kart_takes_throttle_and_steering_at_once():
    driven = drive("kart-steer", actions="continuous")
    driven.driver.handle(key("w"))
    driven.driver.handle(key("d"))
    np.testing.assert_array_equal(driven.driver.act(None), [1.0, 1.0])
    driven.driver.handle(key("a"))
    np.testing.assert_array_equal(driven.driver.act(None), [1.0, 0.0])


@pytest.mark.usefixtures("key_names")
def test_arrows_command_speed_and_turn_within_bounds():
    keys = CommandedPolicyDriver(None, "x", None)
    for _ in range(9):
        keys.handle(key("up"))
        keys.handle(key("left"))
    assert (keys.speed, keys.turn) == (0.45, 0.8)
    keys.handle(key("down"))
    keys.handle(key("right"))
    assert (keys.speed, keys.turn) == (0.4, 0.6)
    keys.handle(key("space"))
    assert (keys.speed, keys.turn) == (0.0, 0.0)


@pytest.mark.parametrize(
    "closing",
    [pygame.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE), pygame.Event(pygame.QUIT)],
    ids=["ESC", "close"],
)
def test_a_window_closes_cleanly(closing):
    app = Script(DriveApp(drive("kart-grid"), "kart-grid"), f3=[closing])
    window.show(app)
    assert 3 <= app.frame <= 3 + window.MAX_TICKS
    assert not pygame.display.get_init()


def test_p_keeps_pictures_in_a_folder_that_is_made(tmp_path):
    picture, leave = (pygame.Event(pygame.KEYDOWN, key=k) for k in (pygame.K_p, pygame.K_ESCAPE))
    app = Script(DriveApp(drive("kart-grid"), "kart-grid"), f1=[picture], f2=[picture], f4=[leave])
    window.show(app, tmp_path / "screenshots")
    names = sorted(path.name for path in (tmp_path / "screenshots").iterdir())
    assert names == ["kart-grid-1.png", "kart-grid-2.png"]
    kept = pygame.image.load(tmp_path / "screenshots/kart-grid-1.png")
    assert kept.get_size() == app.draw().get_size()


def test_a_window_of_another_size_shows_the_whole_frame():
    screen, frame = pygame.Surface((300, 100)), pygame.Surface((200, 200))
    frame.fill((255, 255, 255))
    window._fit(screen, frame)
    pixels = pygame.surfarray.array3d(screen)[:, :, 0]
    assert (pixels[105:195] == 255).all()
    assert (pixels[:98] < 255).all()


def test_r_begins_the_next_episode():
    driven = drive("kart-grid")
    app = DriveApp(driven, "kart-grid")
    first = driven.episode.observation
    app.tick()
    app.handle(pygame.Event(pygame.KEYDOWN, key=pygame.K_r))
    assert driven.episode.steps == 0
    assert not np.array_equal(driven.episode.observation, first)
    assert driven.outcomes == []


def crash(driven):
    """Drive straight ahead until a wall ends it."""
    driven.driver.handle(pygame.Event(pygame.KEYDOWN, key=pygame.K_w))
    while not driven.waiting:
        driven.tick()


def test_the_end_is_shown_a_while_and_then_the_next_episode_begins():
    driven = drive("kart-gazebo")
    crash(driven)
    (outcome,) = driven.outcomes
    assert (outcome.word, outcome.good, outcome.seconds) == ("crash", False, None)
    assert outcome.line.startswith(f"crash, {outcome.steps} steps, return ")
    for _ in range(90):
        assert driven.waiting
        driven.tick()
    assert not driven.waiting
    assert driven.episode.steps == 0


def test_a_crash_is_written_over_the_picture():
    driven = drive("kart-gazebo")
    app = DriveApp(driven, "kart-gazebo")
    before = pygame.surfarray.array3d(app.draw())
    crash(driven)
    after = pygame.surfarray.array3d(app.draw())
    assert (before[300:500, 380:420] != after[300:500, 380:420]).mean() > 0.3


def test_a_recorded_drive_is_a_rollout_that_its_actions_repeat(tmp_path):
    driven = open_session(
        "kart-gazebo", {"track": "small_S"}, None, None, 10_003, tmp_path / "a/d.npz"
    )
    crash(driven)
    driven.restart()
    crash(driven)
    driven.close()
    assert [path.name for path in driven.files] == ["d.npz", "d-2.npz"]
    kept = Rollout.load(tmp_path / "a/d.npz")
    assert (kept.env_id, kept.seed) == ("spikedeploy/KartGazebo-v0", 10_003)
    assert kept.options == {"track": "small_S"}
    again = rollout(envs.make("kart-gazebo", **kept.options), Told(kept.action), kept.seed)
    np.testing.assert_array_equal(again.observation, kept.observation)


class Told:
    """A controller that repeats what it was told."""

    def __init__(self, actions):
        self._actions = iter(actions)

    def reset(self, seed):
        pass

    def act(self, observation):
        return next(self._actions)


def test_leaving_in_the_middle_keeps_what_was_driven(tmp_path):
    driven = open_session("kart-grid", {}, None, None, 10_000, tmp_path / "d.npz")
    for _ in range(7):
        driven.tick()
    driven.close()
    kept = Rollout.load(tmp_path / "d.npz")
    assert (kept.steps, kept.truncated) == (7, True)


def test_a_hexapod_walks_as_the_arrows_command():
    driven = open_session("hexapod-command", {"terrain": 0.0}, None, None, 10_000)
    assert isinstance(driven.driver, CommandedPolicyDriver)
    assert driven.driver.name == "popsan on loihi1"
    for _ in range(2):
        driven.driver.handle(pygame.Event(pygame.KEYDOWN, key=pygame.K_LEFT))
    driven.tick()
    assert driven.info["command_speed"] == pytest.approx(0.25)
    assert driven.info["command_turn"] == pytest.approx(0.4)


def test_a_spiking_policy_shows_its_spikes_and_what_a_step_costs(monkeypatch, tmp_path):
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    driven = open_session("stroll", {}, "stroll/popsan", "loihi1", 10_000)
    app, network = DriveApp(driven, "stroll"), driven.driver.network
    empty = pygame.surfarray.array3d(app.draw())
    for _ in range(19):
        app.tick()
    shown = pygame.surfarray.array3d(app.draw())
    assert shown.shape == empty.shape
    assert (shown != empty)[-800:-400].any()
    (row,) = run_policy("stroll/popsan", None, "loihi1", [10_000]).as_json()
    app.tick()
    assert network.sops == pytest.approx(row["sops_per_inference"])
    assert network.joules == pytest.approx(row["energy_per_inference_j"]["horowitz45-int8"])
    assert network.trace.rasters["input"].shape[0] == len(network.trace.scores) == 20
    assert driven.outcomes[0].total == row["return_mean"]


def test_worlds_that_are_no_karts_show_what_their_camera_sees(monkeypatch, tmp_path):
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    driven = open_session("stroll", {}, None, None, 10_000)
    app = DriveApp(driven, "stroll")
    for _ in range(5):
        app.tick()
    pixels = pygame.surfarray.array3d(app.draw())
    assert (pixels[300:600, 300:500] == 50).all()


@pytest.fixture
def leaves_at_once(monkeypatch):
    shown = []

    def show(app):
        shown.append(app)
        for _ in range(3):
            app.tick()

    monkeypatch.setattr(window, "show", show)
    return shown


def test_the_command_opens_a_window_and_tells_what_it_kept(command, leaves_at_once, tmp_path):
    path = tmp_path / "drive.npz"
    code, out, err = command("play", "kart-steer", "--track", "small_S", "--record", path)
    assert (code, err) == (0, "")
    assert out == f"wrote {path}\n"
    assert leaves_at_once[0].title == "kart-steer – spikedeploy"
    assert Rollout.load(path).options["track"] == "small_S"


@pytest.mark.usefixtures("leaves_at_once")
@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["kart-gird"], "unknown environment 'kart-gird'; did you mean 'kart-grid'"),
        (["kart-grid", "--track", "big_T"], "big_T"),
        (["kart-grid", "--chip", "loihi1"], "--chip is for a policy"),
        (["kart-grid", "--record", "drive.txt"], "ends in .npz"),
        (["kart-grid", "--policy", "hexapod/popsan"], "was made for spikedeploy/Hexapod-v0"),
        (["hexapod", "--track", "big_S"], "hexapod has no option 'track'"),
    ],
)
def test_mistakes_are_one_line(words, line, command):
    code, _, err = command("play", *words)
    assert code == 2
    assert err.startswith("error: ")
    assert line in err
    assert err.count("\n") == 1


def test_without_a_display_the_window_says_so(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "nonsense")
    with pytest.raises(ConfigError, match="no window can be opened here"):
        window.show(DriveApp(drive("kart-grid"), "kart-grid"))


def test_an_environment_that_is_not_ours_is_watched(tmp_path):
    drive = open_session("tests.own_env:Reach", {}, None, None, 3, tmp_path / "seen.npz")
    app = DriveApp(drive, "tests.own_env:Reach")
    assert (app.name, app.fps) == ("tests.own_env:Reach", 40.0)
    assert drive.driver.name == "random"
    for _ in range(12):
        app.tick()
        app.draw()
    (outcome,) = drive.outcomes
    assert (outcome.word, outcome.steps) == ("time is up", 12)
    drive.close()
    assert Rollout.load(tmp_path / "seen.npz").env_id == "tests.own_env:Reach"
