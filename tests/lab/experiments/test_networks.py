import numpy as np
import pytest
import torch

from lab.experiments.costs import ACC16, INT8, terms
from lab.experiments.networks import DeltaNetwork
from spikedeploy.runtime.metrics.energy import ACCESS, ADDITION, reading_energy
from spikedeploy.runtime.metrics.energy_tables import TABLES
from spikedeploy.trainers.sparse.pool import Walk
from tests.delta_policies import pruned_mlp, walk


def walked(controller, walks):
    """Actions (L, B, act) of robots, of which the shorter walks stay at their end."""
    controller.reset(len(walks))
    length = max(map(len, walks))
    held = [np.concatenate([w, np.repeat(w[-1:], length - len(w), 0)]) for w in walks]
    return np.stack([controller.act_batch(seen) for seen in np.stack(held, 1)])


def test_a_delta_network_that_sends_every_change_is_the_network():
    policy, walks = pruned_mlp(), [walk(12, seed=1), walk(7, seed=2)]
    found = walked(DeltaNetwork(policy, 0.0), walks)
    with torch.no_grad():
        whole = policy(torch.from_numpy(walks[0]).float())
    np.testing.assert_allclose(found[:, 0], whole, atol=1e-6)


def test_what_did_not_change_enough_is_not_sent_and_not_counted():
    policy = pruned_mlp(hidden=(), obs=3, act=2, left=1.0)  # linear: three inputs, two outputs
    policy.normalizer.std.fill_(1.0)
    first = np.array([0.5, 0.0, 0.0])  # two are 0, as is what was sent in the beginning
    seen = np.stack([first, first, first + np.array([0.2, 0.05, 0.0])])
    running = DeltaNetwork(policy, 0.1)
    actions = walked(running, [seen, seen[:2]])
    assert np.array_equal(actions[0], actions[1])
    with torch.no_grad():
        last = policy(torch.tensor([[0.7, 0.0, 0.0]]))[0]
    np.testing.assert_allclose(actions[2, 0], last, atol=1e-6)
    walks = [Walk(w.astype(np.float32), w[:, :2].astype(np.float32)) for w in (seen, seen[:2])]
    counts = running.counts(walks)
    # of five control steps two begin and one changes; the third of the second robot is not there
    assert counts["operations"] == pytest.approx(3 * 2 / 5)
    assert counts["compared"] == pytest.approx(3 * 2 / 5)
    assert counts["sent"] == pytest.approx(3 / 5)
    assert counts["observations"] == 3
    each = terms(counts, INT8)
    sums = 1.2 * (2 * ADDITION + 3 * ACCESS) + 0.6 * (ADDITION + ACCESS)
    assert each["updates"] == pytest.approx(sums)
    assert each["encoder"] == pytest.approx(reading_energy(3) + 3 * (2 * ADDITION + ACCESS))
    assert terms(counts, ACC16)["operations"] > 1.5 * 1.2 * TABLES[ACC16].joules["mac"]


def test_hidden_units_and_the_path_past_them_are_counted_too():
    policy = pruned_mlp(obs=2, act=1, hidden=(2,), left=1.0)
    policy.normalizer.std.fill_(1.0)
    with torch.no_grad():
        policy.matrices[0].weight.copy_(torch.tensor([[1.0, 0.0], [0.0, 1.0]]))
        policy.matrices[0].mask.copy_(policy.matrices[0].weight)  # an input of each hidden unit
        policy.matrices[1].mask.copy_(torch.tensor([[1.0, 0.0]]))  # the second sends to nobody
        policy.biases[0].zero_()
    running = DeltaNetwork(policy, 0.1)
    seen = np.array([[0.5, 0.0], [0.5, 0.9], [0.5, 0.9]])
    walked(running, [seen])
    counts = running.counts([Walk(seen.astype(np.float32), seen[:, :1].astype(np.float32))])
    # the first input: to a unit, to the action, and the unit's change to the action; then the
    # second input likewise, whose unit sends to nobody; then nothing
    assert counts["operations"] == pytest.approx((3 + 2) / 3)
    assert counts["compared"] == pytest.approx((2 + 2) / 3)  # a unit and the action each time
    assert counts["sent"] == pytest.approx((2 + 2) / 3)
