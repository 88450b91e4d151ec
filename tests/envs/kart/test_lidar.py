"""The LIDAR against pymunk's segment query, ray by ray, and against distances known by hand."""

import math

import numpy as np
import pymunk
import pytest

from spikedeploy.envs.kart import track as track_file
from spikedeploy.envs.kart.lidar import Lidar, LidarOptions
from spikedeploy.runtime.errors import EnvError

SQUARE = np.array(
    [[[-100, -100], [100, -100]], [[100, -100], [100, 100]], [[100, 100], [-100, 100]],
     [[-100, 100], [-100, -100]]], float,
)  # fmt: skip


def among(walls, **options):
    lidar = Lidar(LidarOptions(**options))
    lidar.set_walls(walls)
    return lidar


def oracle(walls, lidar, x, y, heading):
    """Distances (R,) as pymunk finds them: a query for every ray."""
    space = pymunk.Space()
    for a, b in walls:
        space.add(pymunk.Segment(space.static_body, tuple(a), tuple(b), 0.0))
    found = []
    for angle in heading + lidar.angles:
        end = x + lidar.range * math.cos(angle), y + lidar.range * math.sin(angle)
        hit = space.segment_query_first((x, y), end, 0.0, pymunk.ShapeFilter())
        found.append(hit.alpha * lidar.range if hit else lidar.range)
    return np.array(found)


def places(walls, rng, count):
    """(count, 3) places in and around the box of the walls, in any heading."""
    low, high = walls.reshape(-1, 2).min(axis=0), walls.reshape(-1, 2).max(axis=0)
    where = rng.uniform(low - 30, high + 30, (count, 2))
    return np.column_stack((where, rng.uniform(-10, 10, count)))


@pytest.mark.parametrize("name", track_file.names())
def test_distances_are_those_of_pymunks_segment_query(name):
    walls, rng = track_file.load(name).walls, np.random.default_rng(3)
    lidar = among(walls, count=37, range=400.0)
    for x, y, heading in places(walls, rng, 60):
        expected = oracle(walls, lidar, x, y, heading)
        np.testing.assert_allclose(lidar.distances(x, y, heading), expected, atol=1e-6)


def test_the_first_of_24_rays_points_straight_ahead_and_the_next_15_degrees_clockwise():
    lidar = among(SQUARE)
    assert len(lidar.angles) == 24
    assert lidar.angles[0] == 0.0
    np.testing.assert_allclose(np.diff(lidar.angles), math.radians(15))


def test_distances_in_a_square_are_known_by_hand():
    scan = among(SQUARE, count=8, range=350.0).distances(40.0, 0.0, 0.0)
    # ahead, then clockwise: down right, down, down left, back, up left, up, up right
    diagonal = math.sqrt(2)
    expected = [60, 60 * diagonal, 100, 100 * diagonal, 140, 100 * diagonal, 100, 60 * diagonal]
    np.testing.assert_allclose(scan, expected)


@pytest.mark.parametrize("heading", np.linspace(-3, 3, 13))
def test_no_ray_slips_through_a_corner(heading):
    lidar = among(SQUARE, count=4, range=300.0)
    aim = math.atan2(100 - 7.3, 100 - 41.9)  # straight at a corner, whatever the rounding
    assert lidar.distances(41.9, 7.3, aim)[0] == pytest.approx(math.hypot(58.1, 92.7))
    assert lidar.distances(41.9, 7.3, heading).max() < 290


def test_a_single_ray_points_straight_ahead():
    assert among(SQUARE, count=1, field=1.0).angles.tolist() == [0.0]


def test_noise_has_the_standard_deviation_that_was_asked_for():
    lidar, rng = among(SQUARE, noise=5.0), np.random.default_rng(0)
    exact = lidar.distances(0.0, 0.0, 0.2)
    scans = np.array([lidar.measure(0.0, 0.0, 0.2, rng) for _ in range(400)])
    np.testing.assert_allclose(scans.mean(axis=0), exact, atol=1.0)
    assert (scans - exact).std() == pytest.approx(5.0, rel=0.05)


def test_a_dropout_returns_the_range():
    lidar, rng = among(SQUARE, dropout=0.25), np.random.default_rng(0)
    scans = np.array([lidar.measure(0.0, 0.0, 0.0, rng) for _ in range(400)])
    lost = scans == lidar.range
    assert lost.mean() == pytest.approx(0.25, abs=0.02)
    exact = np.broadcast_to(lidar.distances(0.0, 0.0, 0.0), scans.shape)
    np.testing.assert_array_equal(scans[~lost], exact[~lost])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "lidar.count: 0 is not a number from 1 to 1000"),
        ({"count": 2.5}, "lidar.count: 2.5 is not a whole number"),
        ({"count": 8, "field": 1.0}, "8 rays in less than a full circle .* choose 9"),
        ({"field": 7.0}, "lidar.field: 7.0 is not a number from 0 to 6.28319"),
        ({"range": "far"}, "lidar.range: 'far' is not a number"),
        ({"noise": -1.0}, "lidar.noise: -1.0"),
        ({"dropout": 1.1}, "lidar.dropout: 1.1 is not a number from 0 to 1"),
        ({"dropout": True}, "lidar.dropout: True"),
    ],
)
def test_invalid_lidar_options_are_refused(options, message):
    with pytest.raises(EnvError, match=message):
        LidarOptions(**options)
