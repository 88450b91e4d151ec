import numpy as np
import torch

from spikedeploy.trainers.sparse.pool import Walk, WalkPool
from spikedeploy.trainers.sparse.student import DeltaStudent, binary_columns, retuned
from tests.delta_policies import delta_policy
from tests.trainers.sparse.toy import settings


def linear(weights, moves):
    """A linear policy with these weights, and a pool whose observations move so far a step."""
    policy = delta_policy(obs=len(moves), act=1, hidden=0, left=1.0)
    policy.normalizer.mean.zero_()
    policy.normalizer.std.fill_(1.0)
    policy.past.weight.copy_(torch.tensor([weights]))
    policy.action_bias.zero_()
    policy.step.fill_(0.5)
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 1.0], (400, len(moves)))
    rows = np.zeros_like(signs)
    for t in range(1, len(rows)):
        rows[t] = 0.95 * rows[t - 1] + signs[t] * moves
    pool = WalkPool()
    pool.add([Walk(rows.astype(np.float32), np.zeros((400, 1), np.float32))])
    student = DeltaStudent(policy, settings())
    student.prepare(pool)
    return policy, pool


def tuned(weights, moves, binary=None, **changes):
    policy, pool = linear(weights, moves)
    which = np.zeros(len(moves), bool) if binary is None else np.array(binary)
    return retuned(policy, pool, which, settings(**changes))


def test_steps_are_cube_roots_of_cost_over_sensitivity():
    found = tuned([0.01, 0.08, 0.01], [0.1, 0.1, 0.8])
    # H ~ w^2: 64 times; E|dx|: 8 times as much
    np.testing.assert_allclose(found[1] / found[0], 64 ** (-1 / 3), rtol=0.05)
    np.testing.assert_allclose(found[2] / found[0], 8 ** (1 / 3), rtol=0.05)
    np.testing.assert_allclose(np.prod(found) ** (1 / 3), 0.5, rtol=1e-6)


def test_steps_minimise_the_error_for_the_same_operations():
    weights, moves = np.array([0.01, 0.08, 0.01]), np.array([0.1, 0.1, 0.8])
    best = tuned(weights.tolist(), moves.tolist())

    def error(step):  # at equal operations, F = 1
        return (step**2 / 12 * weights**2).sum()

    def operations(step):
        return (moves / step).sum()

    for seed in range(20):
        other = best * np.exp(0.2 * np.random.default_rng(seed).normal(size=3))
        other *= operations(other) / operations(best)
        assert error(best) < 1.02 * error(other)


def test_binary_and_unread_observations_keep_their_steps():
    found = tuned([0.1, 0.1, 0.0], [0.1, 0.1, 0.1], binary=[False, True, False])
    np.testing.assert_allclose(found, [0.5, 0.5, 0.5])
    found = tuned([0.1, 0.1, 0.0], [0.1, 0.1, 0.1], binary=[False, True, False], step=0.8)
    np.testing.assert_allclose(found, [0.8, 0.5, 0.5])


def test_steps_stay_within_limits():
    found = tuned([1e-6, 0.1], [1.0, 1e-3])
    assert found[0] == 4.0
    assert found[1] == 0.1


def test_observations_with_two_values_are_binary():
    seen = np.random.default_rng(0).normal(size=(50, 4))
    seen[:, 1] = seen[:, 1] > 0
    seen[:, 2] = 3.0
    seen[:, 3] = np.sign(seen[:, 3])
    assert binary_columns(seen).tolist() == [False, True, False, True]


def test_a_force_that_is_nearly_always_zero_is_not_binary():
    seen = np.zeros((60, 4))
    seen[7, 0] = 0.4  # once: an outlier
    seen[::20, 1] = 1e-9  # a swing that is noise
    seen[::20, 2] = 1.0
    seen[:30, 3] = 1.0
    assert binary_columns(seen).tolist() == [False, False, True, True]


def test_values_that_the_sample_lacks_count(monkeypatch):
    monkeypatch.setattr("spikedeploy.trainers.sparse.student._SAMPLE", 10)
    seen = (np.arange(40.0) % 3 == 0)[:, None].astype(float)  # every fourth is looked at
    assert binary_columns(seen).tolist() == [True]
    seen[1] = 0.5
    assert binary_columns(seen).tolist() == [False]
