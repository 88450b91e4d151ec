"""Tracks: their files, and the rules that they keep."""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from spikedeploy.envs.kart import track as track_file
from spikedeploy.runtime.errors import EnvError

LANE = {  # a lane 400 px long and 100 px wide, open at its right end, where the finish is
    "name": "lane",
    "walls": [[[400, 0], [0, 0], [0, 100], [400, 100]]],
    "gates": [[[200, 0], [200, 100]], [[395, 0], [395, 100]]],
    "start": {"position": [60, 50], "spread": 10, "heading": [-0.5, 0.5]},
}
everyone = pytest.mark.parametrize("name", track_file.names())


def changed(**fields):
    return {**LANE, **fields}


def begun(**fields):
    return changed(start={**LANE["start"], **fields})


def written(folder, content):
    path = folder / "mine.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def refusal(folder, content):
    with pytest.raises(EnvError) as caught:
        track_file.load(written(folder, content))
    message = str(caught.value)
    assert "mine.json" in message
    assert "\n" not in message
    return message


def test_big_s_has_kart_simulators_walls_gates_and_length():
    found = track_file.load("big_S")
    assert found.walls.shape == (12, 2, 2)
    assert found.box == (54.0, 81.0, 990.0, 958.0)
    assert found.midpoints[:2] == ((448.0, 205.0), (807.5, 256.0))
    assert found.start.tolist() == [150.0, 200.0]
    assert found.spread == 50.0
    legs = -np.diff(found.rest)
    np.testing.assert_allclose(legs, [363, 217, 357, 263, 182, 261, 454], atol=0.6)
    assert found.length == pytest.approx(2396, abs=1)


@everyone
def test_the_remaining_path_is_the_sum_of_its_legs(name):
    found = track_file.load(name)
    points = [found.start, *found.midpoints]
    way = sum(math.dist(a, b) for a, b in pairwise(points))
    assert found.length == pytest.approx(way)
    assert found.remaining(*found.midpoints[-1], len(found.gates) - 1) == pytest.approx(0.0)
    assert found.remaining(3.0, 4.0, len(found.gates)) == 0.0


def test_any_track_file_is_loaded_by_its_path(tmp_path):
    path = written(tmp_path, LANE)
    for name in (path, str(path)):
        found = track_file.load(name)
        assert found.name == "lane"
        assert found.walls.tolist() == [
            [[400, 0], [0, 0]],
            [[0, 0], [0, 100]],
            [[0, 100], [400, 100]],
        ]
        assert found.heading == (-0.5, 0.5)


def test_a_file_that_was_changed_is_read_again(tmp_path):
    path = written(tmp_path, LANE)
    assert track_file.load(path).name == "lane"
    path.write_text(json.dumps(changed(name="other")))
    assert track_file.load(path).name == "other"


def test_an_unknown_name_is_answered_with_a_suggestion():
    with pytest.raises(EnvError, match=r"unknown track 'bigS'; did you mean 'big_S'\?"):
        track_file.load("bigS")
    with pytest.raises(EnvError, match=r"known: big_S, circuit"):
        track_file.load("monza")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([1], "must be an object with name, walls, gates, start"),
        ({key: LANE[key] for key in ("name", "walls", "gates")}, "'start' is missing"),
        (changed(width=3), "unknown field 'width'; it has name, walls, gates, start"),
        (changed(start={"position": [60, 50], "spread": 1}), "start: 'heading' is missing"),
        (changed(walls=[]), "walls: must be a list of lines, at least one"),
        (changed(walls=[[[0, 0]]]), "wall 1: 1 point; a line needs two"),
        (changed(walls=[[[0, 0], [1]]]), "wall 1: must be numbers of shape ('n', 2)"),
        (changed(walls=[[[0, 0], [1, "x"]]]), "wall 1: must be numbers"),
        (changed(walls=[[[0, 0], [1, float("nan")]]]), "wall 1: must be numbers"),
        (changed(walls=[[[0, 0], [1e300, -1e300]]]), "all finite and within ±1e+09"),
        (changed(walls=[[[0, 0], [1, 10**400]]]), "wall 1: must be numbers"),
        (changed(walls=[*LANE["walls"], [[1, 2], [1, 2]]]), "wall 2: points 1 and 2 are the same"),
        (changed(gates=[[[1, 2], [3, 4], [5, 6]]]), "gate 1 has 3 points; a gate has two"),
        (begun(spread=-1), "spread -1.0 must not be negative"),
        (begun(heading=[1, -1]), "heading [1.0, -1.0] must be in ascending order"),
        (begun(heading=1), "start heading: must be numbers of shape (2,)"),
        # its left end is missing
        (changed(walls=[[[400, 0], [0, 0]], [[0, 100], [400, 100]]]), "the walls are open"),
        # the finish leaves the right end open
        (changed(gates=[LANE["gates"][0], [[395, 0], [395, 50]]]), "the walls are open"),
        (begun(position=[60, 300]), "or the start is outside of them"),
        (begun(position=[60, 85]), "can start 5.0 px from a wall"),
        (begun(spread=40), "can start 10.0 px from a wall"),
        (
            changed(gates=[[[200, 300], [200, 400]], LANE["gates"][1]]),
            "gate 1 is off the track: no kart can get from the start to (200, 300)-(200, 400)",
        ),
        # a wall across the lane
        (
            changed(walls=[*LANE["walls"], [[300, 0], [300, 100]]]),
            "gate 2 is off the track",
        ),
    ],
)
def test_a_track_that_makes_no_sense_is_refused_with_the_reason(tmp_path, content, message):
    assert message in refusal(tmp_path, content)


def test_shipped_tracks_keep_the_rules():
    for name in track_file.names():
        track_file.check(track_file.load(name), name)


def test_a_track_of_a_million_pixels_is_refused(tmp_path):
    record = json.loads((Path(track_file.__file__).parent / "tracks" / "small_S.json").read_text())
    record["walls"][0][0][0] = 1e9
    (tmp_path / "a.json").write_text(json.dumps(record))
    with pytest.raises(EnvError, match="Scale it down"):
        track_file.load(tmp_path / "a.json")
    (tmp_path / "b.json").write_text("[" * 100_000)
    with pytest.raises(EnvError, match="not a JSON file"):
        track_file.load(tmp_path / "b.json")
