"""Windows: what keys do, what is drawn, and how they close. No display is needed."""

import numpy as np
import pygame
import pytest

from spikedeploy import envs
from spikedeploy.comparison.evaluation import run_policy
from spikedeploy.envs.rollout import Rollout, rollout
from spikedeploy.play import drive_app as window
from spikedeploy.play.drive_app import DriveApp
from spikedeploy.play.session import CommandedPolicyDriver, KeyboardDriver, open_session
from spikedeploy.runtime.errors import ConfigError
from tests import toy_stroll_env
from tests.windows import play, press, release

KARTS = {
    "kart-grid": {"w": "up", "s": "down", "a": "left", "d": "right"},
    "kart-gazebo": {"w": "forward", "a": "left", "d": "right"},
    "kart-steer": {"w": "accelerate", "s": "brake", "SPACE": "brake", "a": "left", "d": "right"},
}


def drive(env, **options):
    return open_session(env, options, None, None, 10_000)


def frame(app):
    return pygame.surfarray.array3d(app.draw())


@pytest.mark.parametrize("name", KARTS)
def test_the_keys_of_kart_simulator_drive_every_kart(name):
    driven = drive(name)
    for cap, action in KARTS[name].items():
        driven.driver.handle(press(cap))
        assert driven.world.ACTIONS[driven.driver.act(None)] == action
        driven.driver.handle(release(cap))
        assert driven.driver.act(None) == 0


def test_the_key_pressed_last_counts_and_the_one_before_goes_on_after_it():
    keys = KeyboardDriver(("none", "accelerate", "brake", "left", "right"))
    keys.handle(press("w"))
    keys.handle(press("a"))
    assert keys.act(None) == 3
    keys.handle(release("a"))
    keys.handle(press("q"))  # drives nothing
    assert keys.act(None) == 1


def test_a_continuous_kart_takes_throttle_and_steering_at_once():
    driven = drive("kart-steer", actions="continuous")
    for key, action in (("w", [1.0, 0.0]), ("d", [1.0, 1.0]), ("a", [1.0, 0.0])):
        driven.driver.handle(press(key))
        np.testing.assert_array_equal(driven.driver.act(None), action)


def test_arrows_command_speed_and_turn_within_bounds():
    keys = CommandedPolicyDriver(None, "x", None)
    for names, found in ((["UP", "LEFT"] * 9, (0.45, 0.8)), (["DOWN", "RIGHT"], (0.4, 0.6)),
                         (["SPACE"], (0.0, 0.0))):  # fmt: skip
        for name in names:
            keys.handle(press(name))
        assert (keys.speed, keys.turn) == found


def test_a_closed_window_is_left():
    steps = drive("kart-grid")
    play(DriveApp(steps, "kart-grid"), None, None, pygame.Event(pygame.QUIT))
    assert 3 <= steps.episode.steps <= 3 + window.MAX_TICKS


def test_a_window_of_another_size_shows_the_whole_frame():
    screen, small = pygame.Surface((300, 100)), pygame.Surface((200, 200))
    small.fill((255, 255, 255))
    window._fit(screen, small)
    pixels = pygame.surfarray.array3d(screen)[:, :, 0]
    assert (pixels[105:195] == 255).all()
    assert (pixels[:98] < 255).all()


def test_r_begins_the_next_episode():
    driven = drive("kart-grid")
    app = DriveApp(driven, "kart-grid")
    first = driven.episode.observation
    app.tick()
    app.handle(press("r"))
    assert driven.episode.steps == 0
    assert not np.array_equal(driven.episode.observation, first)
    assert driven.outcomes == []


def crash(driven):
    """Drive straight ahead until a wall ends it."""
    driven.driver.handle(press("w"))
    while not driven.waiting:
        driven.tick()


def test_a_crash_is_shown_a_while_and_then_the_next_episode_begins():
    driven = drive("kart-gazebo")
    app = DriveApp(driven, "kart-gazebo")
    before = frame(app)
    crash(driven)
    (outcome,) = driven.outcomes
    assert (outcome.word, outcome.good, outcome.seconds) == ("crash", False, None)
    assert outcome.line.startswith(f"crash, {outcome.steps} steps, return ")
    assert (before[300:500, 380:420] != frame(app)[300:500, 380:420]).mean() > 0.3
    for _ in range(90):
        assert driven.waiting
        driven.tick()
    assert not driven.waiting
    assert driven.episode.steps == 0


class Told:
    """A controller that repeats what it was told."""

    def __init__(self, actions):
        self._actions = iter(actions)

    def reset(self, seed):
        pass

    def act(self, observation):
        return next(self._actions)


def test_a_recorded_drive_is_a_rollout_that_its_actions_repeat(tmp_path):
    options, path = {"track": "small_S"}, tmp_path / "a/d.npz"
    driven = open_session("kart-gazebo", options, None, None, 10_003, path)
    crash(driven)
    (tmp_path / "a/d-2.npz").write_text("of somebody else")
    driven.restart()
    driven.tick()
    driven.close()  # in the middle
    assert [file.name for file in driven.files] == ["d.npz", "d-3.npz"]
    kept, cut = (Rollout.load(file) for file in driven.files)
    assert (kept.env_id, kept.seed) == ("spikedeploy/KartGazebo-v0", 10_003)
    assert (cut.steps, cut.truncated) == (1, True)
    assert kept.options == options
    again = rollout(envs.make("kart-gazebo", **kept.options), Told(kept.action), kept.seed)
    np.testing.assert_array_equal(again.observation, kept.observation)


def test_a_hexapod_walks_as_the_arrows_command():
    driven = drive("hexapod-command", terrain=0.0)
    assert driven.driver.name == "popsan on loihi1"
    for _ in range(2):
        driven.driver.handle(press("LEFT"))
    driven.tick()
    assert driven.info["command_speed"] == pytest.approx(0.25)
    assert driven.info["command_turn"] == pytest.approx(0.4)


def test_a_policy_is_watched_and_its_return_is_that_of_a_run(monkeypatch, tmp_path):
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    driven = open_session("stroll", {}, "stroll/popsan", "loihi1", 10_000)
    app = DriveApp(driven, "stroll")
    for _ in range(19):
        app.tick()
    shown = frame(app)
    assert (shown[300:600, 300:500] == 190).all()  # what the camera sees
    app.tick()
    assert (frame(app)[-300:] != shown[-300:]).any()  # the numbers
    (row,) = run_policy("stroll/popsan", None, "loihi1", [10_000]).as_json()
    assert driven.outcomes[0].total == row["return_mean"]


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
    assert (code, out, err) == (0, f"wrote {path}\n", "")
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
    assert (code, err.count("\n")) == (2, 1)
    assert err.startswith("error: ")
    assert line in err


def test_without_a_display_the_window_says_so(monkeypatch):
    pygame.display.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "nonsense")
    with pytest.raises(ConfigError, match="no window can be opened here"):
        window.show(DriveApp(drive("kart-grid"), "kart-grid"))


def test_an_environment_that_is_not_ours_is_watched():
    watched = open_session("tests.own_env:Reach", {}, None, None, 3)
    app = DriveApp(watched, "tests.own_env:Reach")
    assert (app.name, app.fps, watched.driver.name) == ("tests.own_env:Reach", 40.0, "random")
    for _ in range(12):
        app.tick()
        app.draw()
    assert [(each.word, each.steps) for each in watched.outcomes] == [("time is up", 12)]
