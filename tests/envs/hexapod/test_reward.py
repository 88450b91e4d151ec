import numpy as np
import pytest

from spikedeploy.envs.hexapod.env import command_terms, course_terms, kernel, regularisers
from spikedeploy.envs.hexapod.robot import Motion

STILL = Motion(
    position=(0.0, 0.0, 0.1),
    gravity=(0.0, 0.0, -1.0),
    heading=0.0,
    velocity=(0.0, 0.0, 0.0),
    body_velocity=(0.0, 0.0, 0.0),
    angular_velocity=(0.0, 0.0, 0.0),
    joints=np.zeros(18),
    joint_velocity=np.zeros(18),
    load=np.zeros(6),
    contact=np.zeros(6, bool),
    slip=0.0,
    power=0.0,
    mean_power=0.0,
)


def test_the_kernel_by_hand():
    # 1 at no error, 0 at one width, then a quarter as steep: -1/4 at two widths, -1 from five on
    assert kernel(0.0, 0.3) == 1.0
    assert kernel(0.15, 0.3) == pytest.approx(0.5)
    assert kernel(-0.3, 0.3) == pytest.approx(0.0)
    assert kernel(0.6, 0.3) == pytest.approx(-0.25)
    assert kernel(-1.5, 0.3) == pytest.approx(-1.0)
    assert kernel(9.0, 0.3) == -1.0


def test_the_course_pays_four_a_step_at_most():
    assert sum(course_terms(0.40, 0.0, 0.0).values()) == pytest.approx(4.0)


@pytest.mark.parametrize(("speed", "paid"), [(0.0, 0.0), (0.2, 1.5), (0.6, 1.5), (2.0, -3.0)])
def test_too_fast_is_paid_like_too_slow(speed, paid):
    assert course_terms(speed, 0.0, 0.0)["speed"] == pytest.approx(paid)


def test_leaving_the_course_costs_half_a_point_at_most_each_way():
    terms = course_terms(0.4, -0.2, 7.0)
    assert terms["heading"] == pytest.approx(-0.1)
    assert terms["lateral"] == pytest.approx(-0.5)


def test_commands_pay_five_and_a_half_a_step_at_most():
    assert sum(command_terms(0.0, 0.0, 0.0).values()) == pytest.approx(5.5)
    terms = command_terms(0.06, -0.15, -0.2)
    assert list(terms.values()) == pytest.approx([1.0, 1.25, 1.0, -0.1])


def test_every_regulariser_by_hand():
    moving = STILL._replace(
        gravity=(0.1, -0.2, -0.97),
        velocity=(0.4, 0.0, -0.3),
        angular_velocity=(1.0, 2.0, 9.0),
        slip=0.1,
        power=8.0,
        mean_power=99.0,
    )
    terms = regularisers(moving, 0.07, 0.09, np.full(18, 0.5), 0.02)
    assert terms == pytest.approx(
        {
            "tilt": -2.0 * 0.05,
            "jerk": -0.02 * 18 * 0.25,
            "power": -0.2,
            "bounce": -0.15,
            "slip": -0.05,
            "wobble": -0.1,
            "crouch": -0.1,
        }
    )
