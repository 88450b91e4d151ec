"""Films of a training: when, of what, and that nothing which is learned depends on them."""

import random
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

from spikedeploy.shipping import training_films
from spikedeploy.shipping.run_card import card_of
from spikedeploy.shipping.training_films import TrainingFilms
from spikedeploy.trainers.config import PopsanConfig
from spikedeploy.trainers.train import train
from tests import toy_stroll_env
from tests.toy_stroll_env import StrollEnv

QUICK = [
    "env.name=stroll", "steps=200", "warm_up=40", "batch=8", "policy.hidden=[8]",
    "critic_hidden=[8]", "log_every=20", "checkpoint_every=50", "validation.every=40",
]  # fmt: skip


@pytest.fixture(autouse=True)
def _stroll(monkeypatch):
    toy_stroll_env.install(monkeypatch)


@pytest.fixture
def run(tmp_path):
    return toy_stroll_env.run_folder(tmp_path, PopsanConfig(hidden=(6,), populations=3))


def films(run):
    """Steps of the films of a run."""
    return sorted(int(path.stem) for path in (run / "films").glob("*.gif"))


def learned(run):
    """What a training came to, but for its speed."""
    return [(run / f"checkpoints/{name}.safetensors").read_bytes() for name in ("last", "best")]


def drawn_next():
    """What each generator of the process would draw."""
    states = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
    drawn = random.random(), np.random.rand(), float(torch.rand(1))  # noqa: NPY002
    random.setstate(states[0]), np.random.set_state(states[1])  # noqa: NPY002
    torch.set_rng_state(states[2])
    return drawn


def test_a_filmed_training_learns_the_same_and_has_films_to_its_end(tmp_path, command):
    words = ["train", "smoke", *(word for each in QUICK for word in ("--set", each))]
    code, _, err = command(*words, "--films", "4", "--runs", tmp_path / "filmed")
    assert code == 0, err
    assert "film" not in err
    (filmed,) = (tmp_path / "filmed").iterdir()
    bare = train("smoke", overrides=QUICK, runs=tmp_path / "bare", quiet=True)
    assert learned(filmed) == learned(bare)
    assert not (bare / "films").exists()
    steps = films(filmed)
    assert len(steps) == 4
    assert [4 * step // 200 for step in steps] == [1, 2, 3, 4]
    assert "![A greedy episode](films/200.gif)" in (filmed / "card.md").read_text()


def filmed(run):
    TrainingFilms(1)(run, 5, 5)
    return Image.open(run / "films/5.gif")


def test_a_film_shows_the_episode_as_it_goes(run):
    with filmed(run) as film:
        assert (film.size, film.n_frames) == ((64, 48), 6)  # of 21, one in four
        assert film.info["duration"] == 80  # 4 control steps of 20 ms
        assert film.info["comment"] == b"written by spikedeploy train"
        film.seek(5)
        assert film.convert("RGB").getpixel((0, 0)) == (200, 200, 200)


def test_an_episode_is_cut_and_a_wide_picture_is_made_smaller(run, monkeypatch):
    monkeypatch.setattr(training_films, "_SECONDS", 0.2)
    picture = np.zeros((480, 640, 3), np.uint8)
    monkeypatch.setattr(StrollEnv, "render", lambda self: picture + 10 * self._step)
    with filmed(run) as film:
        assert (film.size, film.n_frames) == ((320, 240), 3)


def test_a_film_that_would_be_large_has_fewer_frames_and_the_same_time(run, monkeypatch):
    monkeypatch.setattr(training_films, "_LARGEST", 20_000)
    noise = np.random.default_rng(0)
    picture = lambda self: noise.integers(0, 255, (48, 64, 3), np.uint8)  # noqa: E731
    monkeypatch.setattr(StrollEnv, "render", picture)
    with filmed(run) as film:
        assert (film.n_frames, film.info["duration"]) == (3, 160)


def test_a_film_leaves_every_generator_as_it_was(run, monkeypatch):
    def render(self):
        random.random(), np.random.rand(), torch.rand(1)  # noqa: NPY002
        return np.zeros((48, 64, 3), np.uint8)

    monkeypatch.setattr(StrollEnv, "render", render)
    before = drawn_next()
    TrainingFilms(1)(run, 5, 5)
    assert films(run) == [5]
    assert drawn_next() == before


def test_a_resumed_training_does_not_film_again_what_is_there(run):
    for step in (3, 4, 5, 10):
        TrainingFilms(2)(run, step, 10)
    assert films(run) == [5, 10]
    (run / "films/5.gif").write_bytes(b"first")
    for step in (5, 6, 10):
        TrainingFilms(2)(run, step, 10)
    assert (films(run), (run / "films/5.gif").read_bytes()) == ([5, 10], b"first")


def test_what_hinders_a_film_is_said_once_and_the_training_goes_on(tmp_path, monkeypatch, capsys):
    def render(self):
        raise RuntimeError("no display")

    monkeypatch.setattr(StrollEnv, "render", render)
    kept = train("smoke", overrides=QUICK, runs=tmp_path, quiet=True, film=TrainingFilms(4))
    bare = train("smoke", overrides=QUICK, runs=tmp_path, quiet=True)
    assert learned(kept) == learned(bare)
    assert films(kept) == []
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "no more films of this training, which goes on: RuntimeError: no display"


def test_a_film_waits_for_a_validation_and_says_at_the_end_that_there_was_none(run, capsys):
    best = run / "checkpoints/best.safetensors"
    policy = best.read_bytes()
    best.unlink()
    film = TrainingFilms(2)
    film(run, 5, 10)
    assert capsys.readouterr().err == ""
    TrainingFilms(2)(run, 10, 10)
    assert "has no best checkpoint: no validation was due" in capsys.readouterr().err
    best.write_bytes(policy)
    film(run, 6, 10)
    assert films(run) == [6]


def test_nothing_is_written_through_a_link_and_a_card_shows_the_last_film_alone(
    run, tmp_path, capsys
):
    (tmp_path / "elsewhere").mkdir()
    (run / "films").symlink_to(tmp_path / "elsewhere")
    TrainingFilms(1)(run, 5, 5)
    assert list((tmp_path / "elsewhere").iterdir()) == []
    assert "films is a link" in capsys.readouterr().err
    (run / "films").unlink()
    assert "films/" not in card_of(run)
    for step in (9, 10):
        TrainingFilms(10)(run, step, 10)
    assert ("(films/10.gif)" in card_of(run), "(films/9.gif)" in card_of(run)) == (True, False)


def test_tensorboard_gets_the_film_as_an_image_of_its_step(run, monkeypatch):
    added = []
    board, proto = ModuleType("torch.utils.tensorboard"), ModuleType("summary_pb2")
    writer = SimpleNamespace(add_summary=lambda *point: added.append(point))
    board.SummaryWriter = lambda folder: SimpleNamespace(
        file_writer=writer, close=lambda: added.append(folder)
    )
    proto.Summary = type("Summary", (SimpleNamespace,), {})
    proto.Summary.Image = proto.Summary.Value = SimpleNamespace
    monkeypatch.setattr(training_films, "find_spec", lambda name: True)
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", board)
    for name in ("tensorboard", "tensorboard.compat", "tensorboard.compat.proto"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "tensorboard.compat.proto.summary_pb2", proto)
    TrainingFilms(1)(run, 5, 5)
    (summary, step), folder = added
    image = summary.value[0].image
    assert (step, image.width, image.height, folder) == (5, 64, 48, str(run / "films"))
    assert image.encoded_image_string == (run / "films/5.gif").read_bytes()
