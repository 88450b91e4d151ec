"""Replays: ghosts, their time, the spikes beside them, and films of them."""

import json
from dataclasses import replace

import av
import numpy as np
import pygame
import pytest
from PIL import Image

from spikedeploy import envs
from spikedeploy.envs.ghosts import Ghost, GhostRecorder, Ghosts
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.play.ghosts import COLOURS, GhostGroup, count_gates, ghost_observations
from spikedeploy.play.replay import Playback, distinct_names, open_replay, open_source, save_film
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from tests import toy_stroll_env
from tests.delta_policies import delta_policy
from tests.networks import spiking_mlp
from tests.windows import press

KARTS = ("kart-grid", "kart-gazebo", "kart-steer")
ORIGIN = Provenance("kart-gazebo", "smoke", 0, 0, "2026-01-01T00:00:00Z", "0.1.0")


def drive(name, seed, steps, wild=0.2):
    """A follow-the-gap driver that does what it likes now and then: observations and ghost."""
    env = envs.make(name)
    rng, driver = np.random.default_rng(seed), GapDriver.of(env)
    observation, info = env.reset(seed=seed)
    recorder = GhostRecorder(f"spikedeploy/{type(env.unwrapped).__name__[:-3]}-v0", {})
    recorder.begin(0, info, seed)
    seen = [observation]
    for _ in range(steps):
        free = rng.random() < wild
        action = int(rng.integers(env.action_space.n)) if free else int(driver.act(observation))
        observation, reward, terminated, truncated, info = env.step(action)
        recorder.add(0, info, action, reward)
        seen.append(observation)
        if terminated or truncated:
            break
    recorder.end(0, env_step=seed)
    return env, np.array(seen), recorder.take().drives[0]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder with three batches of ghosts."""
    folder = tmp_path_factory.mktemp("runs") / "kart-gazebo-ann-s0"
    seed = iter(range(1, 100))
    for batch, count in enumerate((2, 3, 2)):
        drives = [drive("kart-gazebo", next(seed), 40 * (batch + 1))[2] for _ in range(count)]
        ghosts = Ghosts("spikedeploy/KartGazebo-v0", drives, {"track": "big_S"})
        ghosts.save(folder / f"ghosts/{batch + 1:05d}.npz")
    return folder


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A spiking policy with random weights for karts that drive or turn."""
    path = tmp_path_factory.mktemp("policies") / "snn.nir"
    observed = envs.make("kart-gazebo").observation_space.shape[0]
    save(replace(spiking_mlp(observed, 4, (16, 12)), provenance=ORIGIN), path)
    return path


def pressed(app, *keys):
    for key in keys:
        app.handle(press(key))


def frame(app):
    return pygame.surfarray.array3d(app.draw())


# time


def test_time_passes_at_the_speed_that_is_asked_for_pauses_and_can_be_sought():
    play = Playback(3, 1 / 60, 120)
    play.tick(1.0)
    assert play.now == 60
    pressed(play, "DOWN")
    play.tick(1.0)
    assert play.now == 90
    pressed(play, "UP", "UP")
    assert play.speed == 2.0
    pressed(play, "SPACE")
    play.tick(1.0)
    assert (play.now, play.paused) == (90, True)
    for keys, now in ((["LEFT"], 30), (["LEFT"] * 2, 0), (["RIGHT"] * 5, 120)):
        pressed(play, *keys)
        assert play.now == now
    pressed(play, "SPACE")
    assert not play.paused


def test_after_a_batch_and_a_rest_comes_the_next_and_after_the_last_the_first():
    play = Playback(2, 1 / 60, 120)
    for seconds, found in ((2.9, (0, 120, 0)), (0.2, (1, 0, 0)), (3.1, (0, 0, 1))):
        play.tick(seconds)
        assert (play.batch, play.now, play.rounds) == found


# ghosts


def straight(steps, x=0.0, **more):
    pose = np.zeros((steps + 1, 3), np.float32)
    pose[:, 0] = x + np.arange(steps + 1)
    line = np.zeros(steps, np.float32)
    given = {"finish": False, "crash": False, "gates": 0, **more}
    return Ghost(pose, np.zeros(steps + 1, np.float32), line.astype(int), line, **given)


def test_a_crowd_knows_where_everybody_is_and_who_has_ended():
    group = GhostGroup(
        [straight(3, crash=True), straight(5, 100.0, finish=True), straight(9, 200.0)]
    )
    assert group.length == 9
    assert group.poses(4)[:, 0].tolist() == [3, 104, 204]
    assert group.states(4)["driving"].tolist() == [False, True, True]
    assert group.counts(5) == {"driving": 1, "finished": 1, "crashed": 1}
    assert group.counts(0) == {"driving": 3, "finished": 0, "crashed": 0}


@pytest.mark.parametrize(
    ("drives", "leader"),
    [
        ([straight(9), straight(8, finish=True), straight(5, finish=True)], 2),
        ([straight(9, gates=1), straight(5, gates=3), straight(4, gates=3)], 1),
        ([], None),
    ],
    ids=["the fastest that finishes", "the farthest", "nobody"],
)
def test_the_leader_is(drives, leader):
    assert GhostGroup(drives).leader == leader


def test_a_kart_without_a_heading_looks_where_it_goes():
    down = straight(3)
    down.pose[:, 1], down.pose[:, 0] = down.pose[:, 0].copy(), 0.0
    assert GhostGroup([down], pushed=True).poses(2)[0, 2] == pytest.approx(np.pi / 2)
    assert GhostGroup([down]).poses(2)[0, 2] == 0.0


def test_gates_count_in_their_order_from_the_first_touch_of_the_rim():
    gates = np.array([[[50, -10], [50, 10]], [[5, -10], [5, 10]], [[90, -10], [90, 10]]], float)
    path = np.stack((np.arange(0.0, 100.0), np.zeros(100)), axis=1)
    passed = count_gates(path, gates)
    assert passed[[30, 31, 49, 70]].tolist() == [0, 1, 1, 1]  # the second lies behind by then
    back = np.concatenate((path, path[::-1], path))
    assert count_gates(back, gates)[[99, 174, 175, 270, 271]].tolist() == [1, 1, 2, 2, 3]


@pytest.mark.parametrize("name", KARTS)
def test_what_a_ghost_saw_is_seen_again(name):
    env, seen, ghost = drive(name, 7, 150)
    again = ghost_observations(ghost, env.unwrapped)
    # the last turn of a kart that is told before it moves is known to nobody
    np.testing.assert_allclose(again[:-1], seen[:-1], atol=2e-3)


# sources


def test_a_run_folder_holds_a_batch_in_each_file(run):
    source = open_source(run)
    assert (source.name, source.env_id) == ("kart-gazebo-ann-s0", "spikedeploy/KartGazebo-v0")
    assert [len(source.batch(index)) for index in (0, 1, 2, 3, None)] == [2, 3, 2, 2, 7]
    assert len(open_source(run / "ghosts")) == 3
    assert len(open_source(run / "ghosts/00002.npz")) == 1


def test_what_is_no_source_is_refused_in_a_line(tmp_path, command):
    code, _, err = command("replay", tmp_path / "none")
    assert code == 2
    assert err == f"error: {tmp_path}/none: no such run folder, ghost file or rollout\n"
    with pytest.raises(ConfigError, match="no ghosts in it"):
        open_source(tmp_path)
    (tmp_path / "a.npz").write_text("not a zip file")
    with pytest.raises(Exception, match=r"a\.npz: not a whole ghost file"):
        open_source(tmp_path / "a.npz")


# the app


def test_batches_come_one_after_the_other_or_all_at_once(run):
    app = open_replay(run)
    assert (app.playback.batches, app.playback.length) == (3, 40)
    pressed(app, "n")
    assert app.playback.length == 80
    for _ in range(160):
        app.tick()
    assert (app.playback.batch, app.playback.length) == (2, 120)
    app = open_replay(run, mode="all")
    assert (app.playback.batches, app.playback.length) == (1, 120)
    facts = dict(app.view.facts(0))
    assert (facts["ghosts"], facts["driving"]) == ("7", "7")
    assert facts["training steps"] == "1 – 7"


def test_ghosts_move_on_the_track(run):
    app = open_replay(run, batch=3)
    before = frame(app)[:800]
    pressed(app, "RIGHT")
    after = frame(app)[:800]
    changed = np.argwhere((before != after).any(axis=2))
    assert len(changed) > 200
    leader = app.view.group.best.pose[60]
    assert np.hypot(*(changed - app.view.place((800, 800)).at(leader[:2])).T).min() < 5


@pytest.mark.parametrize("chip", ["loihi1", "float"])
def test_the_spikes_beside_a_ghost_are_those_of_its_policy(run, policy, chip, tmp_path):
    app = open_replay(run, batch=2, spikes=str(policy), chip=chip)
    inferences, artifact, observations = app.inferences, load(policy), app.view.observations()
    assert inferences.scores.shape == (app.view.group.best.steps + 1, 4)
    np.testing.assert_array_equal(inferences.rasters["input"], artifact.codec.encode(observations))
    controller = SpikingController(artifact, None if chip == "float" else datasheet(chip))
    acted = controller.act_batch(observations)
    np.testing.assert_array_equal(inferences.scores.argmax(axis=1), acted)
    widths = [rows.shape[2] for rows in inferences.rasters.values()]
    assert widths == [observations.shape[1], 16, 12]
    beside = open_replay(run, batch=2, spikes=str(policy), chip=chip, beside=[tiny(tmp_path)])
    np.testing.assert_array_equal(beside.inferences.scores, inferences.scores)


@pytest.mark.parametrize("hidden", [0, 6])
def test_events_and_readouts_are_drawn_beside_a_ghost(hidden, run, tmp_path):
    observed = envs.make("kart-gazebo").observation_space.shape[0]
    actions = envs.make("kart-gazebo").action_space.n
    network = delta_policy(obs=observed, act=actions, hidden=hidden, head="discrete")
    app = open_replay(run, batch=2, spikes=str(to_nir(network, ORIGIN, tmp_path / "event.nir")))
    before = frame(app)[800:1200]
    pressed(app, "RIGHT")
    after = frame(app)[800:1200]
    assert (before != after).any()
    codec = load(tmp_path / "event.nir").codec
    found = app.inferences.rasters
    np.testing.assert_array_equal(found["input"], codec.encode_episode(app.view.observations()))
    assert found.keys() == ({"input", "lif1"} if hidden else {"input"})


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"mode": "some"}, "--mode some: choose batch or all"),
        ({"batch": 4}, "--batch 4: kart-gazebo-ann-s0 has 1 to 3"),
        ({"speed": 0.0}, "--speed 0: choose a factor above 0"),
        ({"spikes": "gap"}, r"shows no spikes: give a \.nir file"),
        ({"spikes": "hexapod/popsan"}, r"was made for spikedeploy/Hexapod-v0"),
    ],
)
def test_wrong_settings_are_named(run, given, line):
    with pytest.raises(ConfigError, match=line):
        open_replay(run, **given)


# several sources


def tiny(folder, name="a", env_id="spikedeploy/KartGazebo-v0", steps=30, **options):
    """A ghost file with one straight drive."""
    path = folder / f"{name}.npz"
    drive = straight(steps, 200.0, finish=steps > 30)
    drive.pose[:, 1] = 200.0
    Ghosts(env_id, [drive], options).save(path)
    return path


def test_sources_are_laid_over_one_another_in_colours_of_their_own(run, tmp_path):
    app = open_replay(run, beside=[tiny(tmp_path, steps=90)])
    assert app.view.legend == {run.name: COLOURS[0], "a": COLOURS[1]}
    facts = app.view.facts(50)
    assert [name for name, _ in facts if name in app.view.legend] == [run.name, "a"]
    assert [value for name, value in facts if "driving" in name] == ["0 / 0 / 0", "1 / 0 / 0"]
    assert facts[-1] == ("leader", "finish, 1.50 s")
    shown = frame(app)
    for colour in COLOURS[:2]:
        assert (shown[:800] == colour).all(axis=2).sum() > 20  # on the track
        assert (shown[800:] == colour).all(axis=2).sum() > 20  # beside its name


def test_of_a_source_with_fewer_batches_the_last_one_stays(run, tmp_path):
    app = open_replay(tiny(tmp_path), batch=3, beside=[run])
    assert app.playback.batches == 3
    assert [len(group.drives) for group in app.view.groups.values()] == [1, 2]
    assert app.playback.length == 120
    together = open_replay(tiny(tmp_path), mode="all", beside=[run])
    assert [len(group.drives) for group in together.view.groups.values()] == [1, 7]


def test_sources_of_one_name_are_told_apart_by_their_folders(tmp_path):
    for folder in ("ann/ghosts", "snn/ghosts"):
        tiny(tmp_path / folder)
    paths = [tmp_path / "ann/ghosts/a.npz", tmp_path / "snn/ghosts/a.npz"]
    assert distinct_names(paths) == ["ann/a", "snn/a"]
    assert distinct_names([tmp_path / "ann", tmp_path / "snn/ghosts"]) == ["ann", "snn"]


def test_sources_that_cannot_be_shown_together_are_refused_in_a_line(tmp_path):
    run, files = tiny(tmp_path, "run"), [tiny(tmp_path, str(number)) for number in range(7)]
    grid = tiny(tmp_path, "grid", "spikedeploy/KartGrid-v0")
    for paths, line in (
        ([run, grid], "was driven in kart-grid on big_S"),
        ([run, tiny(tmp_path, track="small_S")],
         "was driven in kart-gazebo on small_S, run in kart-gazebo on big_S"),
        (files, "7 sources: at most 6"),
        ([files[0], files[0]], r"0\.npz is named twice"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=line):
            open_replay(paths[0], beside=paths[1:])


def test_a_track_drawn_at_random_is_the_leaders_in_every_batch(tmp_path):
    for seed in (1, 2):
        ghosts = Ghosts(
            "spikedeploy/KartGazebo-v0", [straight(9, seed=seed)], {"track": "corridor"}
        )
        ghosts.save(tmp_path / f"ghosts/{seed}.npz")
    app = open_replay(tmp_path)
    seen = []
    for key in ("SPACE", "n", "b"):
        pressed(app, key)
        seen.append(pygame.surfarray.array3d(app.view.ground((200, 200))))
    assert (seen[0] != seen[1]).any()
    np.testing.assert_array_equal(seen[0], seen[2])


class Doing:
    """A controller that does the same in each episode."""

    def __init__(self, action):
        self.action = action

    def reset(self, seed):
        self.step = 0

    def act(self, observation):
        self.step += 1
        return np.array(self.action(self.step))


def test_a_recorded_drive_is_replayed_as_the_only_ghost(tmp_path):
    played = rollout(
        envs.make("kart-gazebo", track="small_S", max_steps=30), Doing(lambda _: 2), 10_005
    )
    played.save(tmp_path / "drive.npz")
    app = open_replay(tmp_path / "drive.npz")
    assert (app.playback.batches, app.playback.length) == (1, 30)
    assert dict(app.view.facts(30))["ghosts"] == "1"
    np.testing.assert_array_equal(app.view.observations(), played.observation)


def test_a_robot_walks_its_recorded_walk_again_and_backwards(monkeypatch, tmp_path):
    toy_stroll_env.install(monkeypatch)
    waves = Doing(lambda step: [np.sin(step), 0.3])
    played = rollout(envs.make("stroll"), waves, 10_005)
    played.save(tmp_path / "walk.npz")
    app = open_replay(tmp_path / "walk.npz")
    seen = []
    for step in (20, 3, 12):
        app.playback.step = step
        app.draw()
        seen.append(app.view.world._state.copy())
    for state, step in zip(seen, (20, 3, 12), strict=True):
        np.testing.assert_array_equal(state, played.observation[step])


def test_a_hexapod_that_was_steered_is_steered_again(tmp_path):
    from spikedeploy.play.drive import open_session

    driven = open_session("hexapod-command", {}, "gait", None, 10_000, tmp_path / "walk.npz")
    for key in ["UP"] * 60 + ["LEFT"] * 60:
        driven.driver.handle(press(key))
        driven.tick()
    seen = driven.episode.observation
    driven.close()
    app = open_replay(tmp_path / "walk.npz")
    app.view.go(120)
    np.testing.assert_array_equal(app.view.newest, seen)


# films


def test_a_film_of_a_batch_lasts_as_long_as_it(run, tmp_path):
    app = open_replay(run, batch=3, speed=2.0)
    save_film(app, tmp_path / "new/film.mp4", seconds=60.0)
    with av.open(str(tmp_path / "new/film.mp4")) as file:
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert frames[0].shape == (800, 1140, 3)
    assert len(frames) / 30 == pytest.approx(120 / 60 / 2 + 1.0, abs=0.1)  # and a second's rest


def test_a_film_is_no_longer_than_asked_for(run, tmp_path):
    save_film(open_replay(run), tmp_path / "film.gif", seconds=0.5)
    with pytest.raises(ConfigError, match=r"choose a name that ends in \.mp4 or \.gif"):
        save_film(open_replay(run), tmp_path / "film.avi", seconds=1.0)
    with Image.open(tmp_path / "film.gif") as image:
        assert image.n_frames == 10
        assert image.info["duration"] == 50
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]


def test_the_command_films_without_a_window(command, run, tmp_path):
    path = tmp_path / "film.gif"
    code, out, err = command("replay", run, "--mode", "all", "--video", path, "--seconds", "0.2")
    assert (code, out, err) == (0, f"wrote {path}\n", "")
    _, out, _ = command("replay", run, "--video", path, "--seconds", "0.1", "--json")
    assert json.loads(out) == {"source": str(run), "batches": 3, "video": str(path)}
