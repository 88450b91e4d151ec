"""Films: complete or not there, and one pair of frames for each moment."""

import av
import gymnasium
import numpy as np
import pytest

from spikedeploy.comparison.evaluation import run_policy
from spikedeploy.runtime.errors import ConfigError, EnvError
from spikedeploy.video import Pace, add_caption, mp4
from tests.own_env import Reach


def frames(path):
    with av.open(str(path)) as file:
        return [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]


def test_a_film_has_every_frame_at_an_even_size(tmp_path):
    with mp4(tmp_path / "new/film.mp4", fps=25) as write:
        for level in range(0, 250, 10):
            write(np.full((49, 65, 3), level, np.uint8))
    found = frames(tmp_path / "new/film.mp4")
    assert len(found) == 25
    assert found[0].shape == (48, 64, 3)
    means = [frame.mean() for frame in found]
    assert means == sorted(means)


def test_a_film_that_breaks_off_leaves_no_file(tmp_path):
    def break_off():
        with mp4(tmp_path / "film.mp4", fps=25) as write:
            write(np.zeros((48, 64, 3), np.uint8))
            raise EnvError("the light went out")

    with pytest.raises(EnvError, match="light"):
        break_off()
    assert list(tmp_path.iterdir()) == []


def test_a_caption_covers_the_lower_edge_only():
    frame = np.full((200, 300, 3), 255, np.uint8)
    found = add_caption(frame, "popsan · loihi1")
    assert found.shape == frame.shape
    assert (found[:180] == 255).all()
    assert found[185:].min() < 50


def test_run_films_the_first_episode_only(stroll):
    run_policy(
        "stroll/popsan", "stroll", "loihi1", range(10_000, 10_002), video=stroll / "film.mp4"
    )
    assert len(frames(stroll / "film.mp4")) == 1 + 10  # the start, and every second of its 20 steps


@pytest.mark.parametrize("render", [lambda env: None, gymnasium.Env.render])
def test_an_environment_that_draws_nothing_is_refused_a_film(render, tmp_path, monkeypatch):
    monkeypatch.setattr(Reach, "render", render)
    with pytest.raises(ConfigError, match="--video: render"):
        run_policy("random", "tests.own_env:Reach", None, [10_000], video=tmp_path / "film.mp4")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("dt", "every", "fps"), [(0.02, 2, 25), (1 / 60, 2, 30), (0.1, 1, 10)])
def test_a_film_runs_as_fast_as_its_world(dt, every, fps):
    pace = Pace.for_period(dt)
    assert (pace.every, pace.fps) == (every, pytest.approx(fps))
