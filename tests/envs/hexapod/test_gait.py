import math

import numpy as np

from spikedeploy.envs.hexapod.robot import LEGS, Gait


def at(phase):
    gait = Gait()
    gait.reset(phase)
    return gait.command().reshape(len(LEGS), 3)


def test_the_two_tripods_do_the_same_half_a_cycle_apart():
    first = [LEGS.index(leg) for leg in ("RF", "RR", "LM")]
    second = [LEGS.index(leg) for leg in ("RM", "LF", "LR")]
    for phase in np.linspace(0.0, math.tau, 17):
        now, later = at(phase), at(phase + math.pi)
        np.testing.assert_allclose(now[first], later[second], atol=1e-12)
        np.testing.assert_allclose(now[first], np.broadcast_to(now[first[0]], (3, 3)), atol=1e-12)


def test_a_quarter_cycle_by_hand():
    # phase pi/2: sine 1, cosine 0; RF is at the top of its swing, RM in the middle of its stance
    command = at(math.pi / 2)
    np.testing.assert_allclose(command[LEGS.index("RF")], [0.0, 0.45, 0.20], atol=1e-12)
    np.testing.assert_allclose(command[LEGS.index("RM")], [0.0, 0.0, 0.0], atol=1e-12)


def test_a_foot_is_lifted_only_while_it_swings_forward():
    step = 1e-4
    for phase in np.linspace(0.01, math.tau - 0.01, 50):
        coxa_speed = at(phase + step)[:, 0] - at(phase)[:, 0]
        np.testing.assert_array_equal(at(phase)[:, 1] > 0.0, coxa_speed > 0.0)
