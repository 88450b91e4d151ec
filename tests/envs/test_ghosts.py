import numpy as np
import pytest

from spikedeploy.envs.ghosts import Ghost, GhostRecorder, Ghosts
from spikedeploy.envs.rollout import Rollout
from spikedeploy.runtime.errors import EnvError


def drive(rng, steps, **more):
    """A smooth drive of some 7 px a step, as a kart's is."""
    heading = np.cumsum(rng.normal(0, 0.05, steps + 1))
    x, y = 150 + 7 * np.cumsum(np.cos(heading)), 200 + 7 * np.cumsum(np.sin(heading))
    return Ghost(
        pose=np.stack((x, y, heading), axis=1).astype(np.float32),
        speed=np.full(steps + 1, 433.7, np.float32),
        action=rng.integers(0, 5, steps),
        reward=rng.normal(0, 1, steps).astype(np.float32),
        **{"finish": False, "crash": False, "gates": 0, **more},
    )


@pytest.fixture
def ghosts():
    rng = np.random.default_rng(0)
    drives = [
        drive(rng, 31, finish=True, gates=8, env_step=31, seed=77),
        drive(rng, 1, crash=True, env_step=32),
        drive(rng, 400, gates=3, env_step=432),
    ]
    return Ghosts("spikedeploy/KartGrid-v0", drives, {"track": "small_S", "max_steps": 400})


def info(x, **more):
    return {"x": x, "y": 2.0, "heading": 0.5, "speed": 10.0 * x, **more}


def test_what_is_saved_is_loaded_to_a_sixteenth_of_a_pixel(ghosts, tmp_path):
    ghosts.save(tmp_path / "ghosts" / "00001.npz")
    loaded = Ghosts.load(tmp_path / "ghosts" / "00001.npz")
    assert (loaded.env_id, loaded.track) == (ghosts.env_id, "small_S")
    assert loaded.options == ghosts.options
    for found, kept in zip(loaded.drives, ghosts.drives, strict=True):
        assert found.pose.dtype == found.speed.dtype == found.reward.dtype == np.float32
        np.testing.assert_allclose(found.pose[:, :2], kept.pose[:, :2], atol=1 / 32 + 1e-4)
        np.testing.assert_allclose(found.pose[:, 2], kept.pose[:, 2], atol=1 / 2000)
        np.testing.assert_allclose(found.speed, kept.speed, atol=1 / 32 + 1e-4)
        np.testing.assert_allclose(found.reward, kept.reward, rtol=2**-12)
        np.testing.assert_array_equal(found.action, kept.action)
        for name in ("finish", "crash", "gates", "env_step", "seed", "steps"):
            assert getattr(found, name) == getattr(kept, name)


def test_saving_what_was_loaded_changes_nothing_any_more(ghosts, tmp_path):
    ghosts.save(tmp_path / "a.npz")
    Ghosts.load(tmp_path / "a.npz").save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_batch_without_a_finished_episode_is_kept_too(tmp_path):
    Ghosts("spikedeploy/KartGrid-v0", []).save(tmp_path / "a.npz")
    assert list(Ghosts.load(tmp_path / "a.npz").drives) == []


def test_broken_and_strange_files_are_refused_in_one_line(ghosts, tmp_path):
    path = tmp_path / "a.npz"
    with pytest.raises(EnvError, match=r"a\.npz: no such ghost file"):
        Ghosts.load(path)
    ghosts.save(path)
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(EnvError, match=r"a\.npz: not a whole ghost file"):
        Ghosts.load(path)
    np.savez(path, weights=np.zeros(3))
    with pytest.raises(EnvError, match=r"not a ghost file, .*header.* missing"):
        Ghosts.load(path)


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("reward", lambda rows: rows[:-5], r"reward has shape \(427,\), the episodes ask for"),
        ("moves", lambda rows: rows[:, :-5], "do not fit together"),
        ("steps", lambda rows: -rows, "negative steps"),
        ("gates", lambda r: r * np.nan, "finite"),
        ("header", lambda text: np.array(str(text).replace("1,", "9,", 1)), "layout version 9"),
        ("header", lambda text: np.array("{"), "its header is not JSON"),
        ("header", lambda text: np.array("[]"), "must be a JSON object"),
    ],
)
def test_a_file_of_another_layout_or_whose_arrays_disagree_is_refused(
    name, change, said, ghosts, tmp_path
):
    path = tmp_path / "a.npz"
    ghosts.save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **{**arrays, name: change(arrays[name])})
    with pytest.raises(EnvError, match=said):
        Ghosts.load(path)


def test_the_recorder_separates_copies_and_orders_episodes_by_their_ends():
    recorder = GhostRecorder("spikedeploy/KartGrid-v0", {"track": "big_S"}, copies=2)
    recorder.begin(0, info(0.0), seed=5)
    recorder.begin(1, info(100.0))
    for step in (1, 2):
        recorder.add(0, info(float(step)), 3, 0.5)
        recorder.add(1, info(100.0 + step, crash=step == 2, gates=2), 1, -5.0)
    recorder.end(1, env_step=4)
    recorder.add(0, info(3.0, finish=True), 0, 10.0)
    recorder.end(0, env_step=5)
    ghosts = recorder.take()
    first, second = ghosts.drives
    assert (first.crash, first.finish, first.gates, first.env_step) == (True, False, 2, 4)
    assert (second.crash, second.finish, second.env_step, second.seed) == (False, True, 5, 5)
    assert first.pose[:, 0].tolist() == [100.0, 101.0, 102.0]
    assert second.speed.tolist() == [0.0, 10.0, 20.0, 30.0]
    assert second.action.tolist() == [3, 3, 0]
    assert second.reward.tolist() == [0.5, 0.5, 10.0]
    assert list(recorder.take().drives) == []


def test_the_recorder_requires_poses():
    recorder = GhostRecorder("spikedeploy/Hexapod-v0", {})
    with pytest.raises(EnvError, match="'heading' is missing"):
        recorder.begin(0, {"x": 1.0, "y": 2.0})
    with pytest.raises(EnvError, match="call begin before add"):
        recorder.add(0, info(1.0), 0, 0.0)


def played(**infos):
    return Rollout(
        env_id="spikedeploy/KartGrid-v0",
        seed=3,
        observation=np.zeros((3, 4)),
        action=np.array([1, 2]),
        reward=np.array([0.5, 10.0]),
        terminated=True,
        truncated=False,
        info={name: np.asarray(values, dtype=np.float64) for name, values in infos.items()},
    )


def test_a_rollout_of_a_kart_becomes_a_ghost():
    ghosts = Ghosts.from_rollout(
        played(x=[1, 2], y=[3, 4], heading=[0, 1], speed=[5, 6], finish=[0, 1], gates=[7, 8])
    )
    (ghost,) = ghosts.drives
    assert ghosts.env_id == "spikedeploy/KartGrid-v0"
    assert ghost.pose.tolist() == [[1, 3, 0], [1, 3, 0], [2, 4, 1]]
    assert (ghost.steps, ghost.finish, ghost.crash, ghost.gates, ghost.seed) == (
        2,
        True,
        False,
        8,
        3,
    )


def test_a_rollout_without_poses_leaves_no_ghost():
    with pytest.raises(EnvError, match="has no heading, speed in its infos"):
        Ghosts.from_rollout(played(x=[1, 2], y=[3, 4]))
