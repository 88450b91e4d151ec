"""Success on commands tells a policy with feedback from one without."""

import pytest

from spikedeploy.comparison.evaluation import run_policy

SEEDS = range(5_002, 5_003)


@pytest.mark.parametrize(("policy", "rate"), [("sac", 1.0), ("bilinear", 0.0)])
def test_a_gait_modulator_without_feedback_does_not_succeed_where_the_float_network_does(
    policy, rate
):
    (row,) = run_policy(f"hexapod-command/{policy}", None, None, SEEDS).as_json()
    assert row["falls"] == 0
    assert row["success_rate"] == rate
