"""Recorded episodes are those of the comparison, spike by spike and step by step."""

import json
import zlib
from base64 import b64decode
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from spikedeploy import envs, recordings
from spikedeploy.comparison.evaluation import compare_policies, line_up
from spikedeploy.recordings import (
    NetworkTrace,
    RecordedEpisode,
    first_difference,
    info_curves,
    pack,
    pack_bits,
    record,
    record_comparison,
    scene_of,
)
from tests import toy_stroll_env
from tests.packed_arrays import unpacked

TABLE = "horowitz45-int8"


@pytest.fixture
def entries(monkeypatch, tmp_path):
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    return line_up("stroll", (), ("loihi1",))


def on_chip(entries):
    return next(entry for entry in entries if entry.chip == "loihi1")


def test_what_is_recorded_is_what_was_compared(entries):
    entry = on_chip(entries)
    compared = compare_policies("stroll", entries, [10_003], processes=1)
    episode = compared.row(entry).episodes[0]
    found = record(envs.make("stroll"), entry.candidate, "loihi1", "x", 10_003, TABLE)
    assert found.played.total == episode.total
    assert found.network.sops.mean() == pytest.approx(episode.costs.sops)
    assert found.network.energy.mean() == pytest.approx(episode.costs.energy_j[TABLE].value)
    assert np.mean([raster.sum() for raster in found.network.rasters["input"]]) == pytest.approx(
        episode.costs.input_spikes
    )
    assert found.network.membranes.keys() == found.network.rasters.keys() - {"input"}


def test_a_page_has_the_first_and_the_worst_episode_while_it_is_small(entries, monkeypatch):
    compared = compare_policies("stroll", entries, range(10_000, 10_006), processes=1)
    main = [row.entry for row in compared.rows].index(on_chip(entries))
    first, worst = record_comparison(compared, main, {}, TABLE)
    returns = compared.rows[main].returns
    assert (first["seed"], worst["seed"]) == (10_000, 10_000 + int(np.argmin(returns)))
    labels = [player["label"] for player in worst["players"]]
    assert labels == ["sac", "popsan · float", "popsan · loihi1"]
    assert worst["players"][-1]["total"] == min(returns)
    assert worst["players"][0]["network"] is None
    assert worst["twin"]
    json.dumps([first, worst], allow_nan=False)
    monkeypatch.setattr(recordings, "_MOST_BYTES", 100)
    monkeypatch.setattr(recordings, "_MOST_BITS", 10)
    (only,) = record_comparison(compared, main, {}, TABLE)
    network = only["players"][-1]["network"]
    assert network["layers"] == []
    assert network["left_out"][0].startswith("input: ")


def film_of(monkeypatch, tmp_path, **changes):
    """The scene of the toy walker, which draws itself ever lighter, and its pictures as arrays."""
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    for name, value in changes.items():
        monkeypatch.setattr(toy_stroll_env.StrollEnv, name, value)
    compared = compare_policies("stroll", line_up("stroll", ("gait",), ()), [10_000], processes=1)
    (episode,) = record_comparison(compared, 0, {}, TABLE)
    found = [Image.open(BytesIO(b64decode(each))) for each in episode["scene"]["pictures"]]
    return episode["scene"], [np.asarray(each.convert("RGB")) for each in found]


def test_an_environment_without_a_scene_is_filmed_in_the_episode_that_is_replayed(
    monkeypatch, tmp_path
):
    scene, pictures = film_of(monkeypatch, tmp_path)
    assert (scene["kind"], scene["every"]) == ("film", 2)  # 25 a second
    shades = [picture.mean() for picture in pictures]
    assert shades == pytest.approx([10 * step for step in range(0, 21, 2)], abs=3)


def test_films_are_small(monkeypatch, tmp_path):
    rng = np.random.default_rng(0)
    noise = {"render": lambda env: rng.integers(0, 256, (300, 900, 3), np.uint8), "max_steps": 700}
    scene, pictures = film_of(monkeypatch, tmp_path, **noise)
    assert pictures[0].shape == (107, 320, 3)
    assert sum(map(len, scene["pictures"])) < 4 / 3 * 700_000 + 4 * len(pictures)
    assert scene["every"] > 2
    plain = {"render": lambda env: np.zeros((48, 64, 3), np.uint8)}
    scene, pictures = film_of(monkeypatch, tmp_path / "plain", **plain)
    assert (scene["every"], len(pictures)) == (8, 88)


@pytest.mark.parametrize(
    ("error", "said"), [(NotImplementedError(), ""), (ImportError("no screen"), "no screen")]
)
def test_an_environment_that_cannot_draw_itself_is_shown_without_a_film(
    entries, monkeypatch, capsys, error, said
):
    def render(env):
        raise error

    monkeypatch.setattr(toy_stroll_env.StrollEnv, "render", render)
    compared = compare_policies("stroll", entries, [10_000], processes=1)
    capsys.readouterr()
    (episode,) = record_comparison(compared, 0, {}, TABLE)
    assert episode["scene"] is None
    assert episode["players"][-1]["steps"] == 20
    err = capsys.readouterr().err
    assert err.count("the page has no film") == len(said[:1])
    assert said in err


def episode_of(rasters):
    return RecordedEpisode(
        "x", "snn", None, None, None, 1, None, NetworkTrace(rasters, {}, None, None)
    )


def test_the_first_difference_is_the_earliest_in_time_then_in_the_order_of_layers():
    one = {name: np.zeros((5, 2, 3), np.uint8) for name in ("input", "lif1", "lif2")}
    other = {name: raster.copy() for name, raster in one.items()}
    assert first_difference(episode_of(one), episode_of(other)) is None
    other["lif2"][1, 1, 2] = 1
    other["lif1"][2, 0, 0] = 1
    found = first_difference(episode_of(one), episode_of(other))
    assert found == {"step": 1, "timestep": 1, "layer": "lif2", "neuron": 2}
    other["lif1"][1, 1, 1] = 1
    found = first_difference(episode_of(one), episode_of(other))
    assert (found["layer"], found["neuron"]) == ("lif1", 1)


def test_the_bodies_of_a_hexapod_are_drawn_where_they_are():
    env = envs.make("hexapod")
    env.reset(seed=3)
    scene = scene_of(env)
    shapes, pose = scene.shapes, scene.pose()
    assert shapes["kind"] == "bodies"
    assert pose.shape == (19, 7)
    assert {geom["kind"] for geom in shapes["geoms"]} <= {"box", "capsule", "cylinder", "sphere"}
    assert all(0 <= geom["body"] < 19 for geom in shapes["geoms"])
    # the start is clear: feet stand on the middle height of the bumps
    heights = unpacked(shapes["ground"]["heights"])
    assert shapes["ground"]["half"] == [12.0, 4.0]
    assert heights.min() >= -1e-6
    assert heights.max() <= 0.0301
    assert abs(pose[0, 0] + 10.0) < 0.01  # the torso, at the start of the course
    before = pose.copy()
    env.step(np.zeros(18))
    assert (scene.pose() != before).any()
    assert (before == pose).all()  # a copy


def test_a_kart_is_drawn_on_its_track_and_a_cart_pole_is_not_drawn():
    env = envs.make("kart-grid")
    env.reset(seed=3)
    scene = scene_of(env)
    assert scene.shapes["kind"] == "track"
    assert scene.pose().tolist() == [list(env.unwrapped.pose)]
    assert scene_of(envs.make("CartPole-v1")) is None


def test_commands_are_drawn_with_what_followed_them():
    played = record(
        envs.make("hexapod-command", max_steps=5),
        line_up("hexapod-command", ("hexapod-command/sparse",), ())[0].candidate,
        None, "x", 10_000, TABLE,
    ).played  # fmt: skip
    speed, turn = info_curves(played.info)
    assert (speed["unit"], turn["unit"]) == ("m/s", "rad/s")
    wanted, step = unpacked(turn["wanted"]), turn["wanted"]["step"]
    assert np.abs(wanted - played.info["command_turn"]).max() <= step
    found = unpacked(turn["values"]) - wanted
    assert np.abs(found + played.info["turn_error"]).max() < 0.001


@pytest.mark.parametrize("shape", [(1,), (50,), (40, 3), (30, 4, 7)])
def test_numbers_come_back_within_half_a_level(shape):
    values = np.random.default_rng(0).normal(0, 1e3, shape)
    found = pack(values)
    assert found["shape"] == list(shape)
    assert (np.abs(unpacked(found) - values) <= 0.51 * found["step"]).all()


def test_constants_come_back_exactly_and_nan_becomes_a_number():
    for values in (np.zeros(5), np.full((4, 2), -3.25)):
        assert (unpacked(pack(values)) == values).all()
    assert np.isfinite(unpacked(pack([1.0, np.nan, 2.0]))).all()
    assert pack(np.zeros((0, 3)))["shape"] == [0, 3]


@pytest.mark.parametrize("neurons", [1, 7, 8, 9, 130])
def test_spikes_come_back(neurons):
    raster = np.random.default_rng(1).integers(-1, 2, (20, neurons))
    found = pack_bits(raster)
    bits = np.frombuffer(zlib.decompress(b64decode(found["data"])), np.uint8)
    rows = np.unpackbits(bits.reshape(20, -1), axis=1, bitorder="little")[:, :neurons]
    assert found["shape"] == [20, neurons]
    assert (rows == (raster != 0)).all()
