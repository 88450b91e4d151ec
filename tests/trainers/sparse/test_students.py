import numpy as np
import pytest
import torch

from spikedeploy.trainers.sparse.pool import Walk, WalkPool
from spikedeploy.trainers.sparse.sparse import SparseLearner
from spikedeploy.trainers.sparse.student import imitation, operations, student
from tests.delta_policies import delta_policy, followed, pruned_mlp, walk
from tests.trainers.sparse.toy import settings

WHOLE = {"window": 42, "burn_in": 2, "first_windows": 1.0, "batch": 3}


def walks(label=None, count=1):
    pool = WalkPool()
    for seed in range(count):
        observation = walk(40, seed=seed).astype(np.float32)
        wanted = np.tanh(observation[:, :2]) if label is None else label
        pool.add([Walk(observation, wanted.astype(np.float32))])
    return pool


@pytest.mark.parametrize("shape", [{}, {"code": "unary"}, {"hidden": 0}, {"skip": False}])
def test_a_whole_walk_is_followed_as_by_single_steps(shape):
    policy, pool = delta_policy(**shape), walks()
    mean, _, spikes = followed(policy, pool.walks[0].observation)
    pool.walks[0] = Walk(pool.walks[0].observation, np.tanh(mean).astype(np.float32))
    found = student(policy, settings(**WHOLE))
    found.prepare(pool)
    error, hidden = found.loss(pool, np.random.default_rng(0))
    assert float(error) < 1e-10  # the label is what it does
    expected = (spikes.mean(0) * policy.out.fan_out.numpy()).sum()
    assert float(hidden) == pytest.approx(expected, rel=1e-5)


def test_rounded_weights_are_what_the_loss_sees_and_gradients_pass_through():
    policy, pool = delta_policy(hidden=0), walks()
    policy.requires_grad_(True)
    found = student(policy, settings(**WHOLE))
    found.prepare(pool)
    plain, _ = found.loss(pool, np.random.default_rng(0))
    found.offsets = {"past": torch.full_like(policy.past.weight, 0.1)}
    moved, _ = found.loss(pool, np.random.default_rng(0))
    assert float(plain.detach()) != float(moved.detach())
    moved.backward()
    assert policy.past.weight.grad.abs().sum() > 0


def test_discrete_actions_are_imitated_by_their_logits():
    policy = delta_policy(head="discrete")
    label = torch.tensor([[2.0, 0.0]])
    losses = [
        float(imitation(torch.tensor([mean]), label, policy, 2.0)) for mean in ([4.0, 0], [0.0, 4])
    ]
    share = 1 / (1 + np.exp(-4.0))
    # the cross-entropy with softmax(2 x logits) is lowest where both are equal
    assert losses[0] == pytest.approx(-share * np.log(share) - (1 - share) * np.log(1 - share))
    assert losses[1] > losses[0] + 3


@pytest.mark.parametrize("policy", [delta_policy(left=1.0), pruned_mlp(left=1.0)])
def test_a_student_learns_and_is_pruned(policy):
    policy.requires_grad_(True)
    config = settings(batch=16, window=12, burn_in=2)
    learner, pool = SparseLearner(config, student(policy, config)), walks(count=4)
    learner.student.prepare(pool)
    rng = np.random.default_rng(0)
    learner.prune(5.0)  # nothing is known yet of what matters
    assert operations(learner.student.synapses()) > 20
    errors = [learner.update(pool, rng, 1e-2, dense=True) for _ in range(60)]
    assert np.mean(errors[-10:]) < 0.6 * np.mean(errors[:10])
    before = learner.student.neurons
    learner.prune(5.0)
    assert operations(learner.student.synapses()) <= 5
    assert learner.student.neurons <= before


@pytest.mark.parametrize("make", [delta_policy, pruned_mlp])
def test_a_student_goes_on_from_its_tensors(make):
    pool, config = walks(count=3), settings(batch=16)
    learners = [SparseLearner(config, student(make(seed=s), config)) for s in (0, 1)]
    for each in learners:
        each.student.policy.requires_grad_(True)
        each.student.prepare(pool)
    rngs = [np.random.default_rng(seed) for seed in (0, 1)]
    for learner, rng in zip(learners, rngs, strict=True):
        learner.update(pool, rng, 1e-3, dense=False)
    one, other = learners
    policy = {f"policy.{n}": t.clone() for n, t in one.student.policy.state_dict().items()}
    saved = {name: tensor.clone() for name, tensor in one.tensors().items()}
    other.load({**policy, **saved})
    other.student.prepare(pool)
    for learner in learners:
        learner.update(pool, np.random.default_rng(2), 1e-3, dense=False)
        learner.prune(6.0)
    expected, found = (each.student.policy.state_dict() for each in learners)
    assert all(torch.equal(expected[name], found[name]) for name in expected)


def test_operations_of_a_float_student_are_its_effective_macs():
    policy, pool = pruned_mlp(), walks(count=3)
    found = student(policy, settings(batch=100, window=12, burn_in=2))
    rng = np.random.default_rng(0)
    for _ in range(300):
        found.loss(pool, rng)
    seen, _ = pool.states(rng, 5000, 0.0, 1)
    _, inputs = policy.activations(seen)
    fan_outs = [layer.fan_out for layer in policy.layers]
    macs = sum((x != 0).float().mean(0) @ f for x, f in zip(inputs, fan_outs, strict=True))
    expected = float(macs + policy.past.mask.sum())
    assert operations(found.synapses()) == pytest.approx(expected, rel=0.02)
