import math

import numpy as np
import pytest

from spikedeploy.envs.hexapod.env import Pushes, PushTable, check, sample
from spikedeploy.runtime.errors import EnvError

TABLE = PushTable(kick=(0.1, 0.2), spin=0.5, interval=(10, 20))


def schedule(scale, seed=0, steps=500):
    rng = np.random.default_rng(seed)
    pushes = Pushes(TABLE, scale)
    pushes.reset(rng)
    found = ((step, pushes.due(step, rng)) for step in range(steps))
    return [(step, push) for step, push in found if push is not None]


def test_pushes_come_at_the_stated_intervals_and_strengths():
    found = schedule(1.0)
    gaps = np.diff([0, *(step for step, _ in found)])
    assert gaps.min() >= 10
    assert gaps.max() <= 20
    speeds = [math.hypot(*kick) for _, (kick, _) in found]
    assert min(speeds) >= 0.1
    assert max(speeds) <= 0.2


def test_scale_zero_keeps_the_schedule_and_removes_the_force():
    full, none = schedule(1.0), schedule(0.0)
    assert [step for step, _ in full] == [step for step, _ in none]
    assert all(push == ((0.0, 0.0), 0.0) for _, push in none)


def test_a_number_is_kept_and_a_pair_is_drawn_from():
    rng = np.random.default_rng(0)
    assert sample(0.7, rng) == 0.7
    drawn = [sample((0.5, 1.0), rng) for _ in range(200)]
    assert 0.5 <= min(drawn) < 0.55
    assert 0.95 < max(drawn) <= 1.0


@pytest.mark.parametrize("wrong", [-0.1, 3.0, (0.5, 0.2), (0.0, 9.0), math.nan, math.inf])
def test_an_option_out_of_range_is_refused_with_its_name_and_limits(wrong):
    with pytest.raises(EnvError, match=r"option payload: .*from 0 to 2"):
        check("payload", wrong, 0.0, 2.0)


@pytest.mark.parametrize("wrong", ["rough", None, (1.0,), (0.1, 0.2, 0.3), ("a", "b"), True])
def test_an_option_that_is_no_number_is_refused(wrong):
    with pytest.raises(EnvError, match="option terrain"):
        check("terrain", wrong, 0.0, 2.0)
