import numpy as np
import pytest
import torch

from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.trainers.policies.delta import delta_artifact, live_neurons
from spikedeploy.trainers.policies.pruned_mlp import PrunedWeight, SynapseGroup
from spikedeploy.trainers.sparse.student import DeltaStudent, operations, prune, remove_neuron
from tests.delta_policies import delta_policy, followed, walk
from tests.trainers.sparse.toy import settings


def group(weight, rate):
    return SynapseGroup(PrunedWeight(torch.tensor(weight)), torch.tensor(rate))


def squares(*groups, value=1.0):
    return {each.matrix: torch.full_like(each.matrix.weight, value) for each in groups}


def test_the_cheapest_synapse_goes_first():
    # w^2 / rate: 4/2 and 1/1 onto neuron 0, 9/2 and 0.25/1 onto neuron 1; together 6 operations
    one = group([[2.0, 1.0], [3.0, 0.5]], [2.0, 1.0])
    order = []
    for target in (5.0, 4.0, 2.0):
        assert prune([one], squares(one), target) == 1
        order.append(one.matrix.mask.tolist())
    assert order == [
        [[1, 1], [1, 0]],  # worth 0.25
        [[1, 0], [1, 0]],  # 1
        [[0, 0], [1, 0]],  # 2
    ]


def test_all_kinds_of_synapses_are_ranked_together_and_by_their_curvature():
    one, other = group([[1.0, 1.0]], [1.0, 1.0]), group([[0.9]], [1.0])
    found = {one.matrix: torch.tensor([[1.0, 0.01]]), other.matrix: torch.tensor([[0.25]])}
    # sqrt(v): worth 1 and 0.1, and 0.81 x 0.5
    prune([one, other], found, 2.0)
    assert (one.matrix.mask.tolist(), other.matrix.mask.tolist()) == ([[1, 0]], [[1]])
    prune([one, other], found, 1.0)
    assert (one.matrix.mask.tolist(), other.matrix.mask.tolist()) == ([[1, 0]], [[0]])


def test_the_curvature_is_the_root_of_the_second_moment():
    # w^2 sqrt(v): 1 x 0.1 and 0.09 x 1; w^2 v would be 0.01 and 0.09
    one = group([[1.0, 0.3]], [1.0, 1.0])
    prune([one], {one.matrix: torch.tensor([[0.01, 1.0]])}, 1.0)
    assert one.matrix.mask.tolist() == [[1, 0]]


def test_a_removed_neuron_is_one_that_brings_little_for_all_that_it_costs():
    # gain 2, 0.2, 2 over cost 1 + 2 + 1, so shares 0.5, 0.05 and 0.5: above a tenth of the mean
    into, out = group([[1.0], [0.1**0.5], [1.0]], [1.0]), group([[1.0, 0.1**0.5, 1.0]], [2.0] * 3)
    assert remove_neuron(into, out, squares(into, out), 1.0) == 0
    # many outgoing operations make the same neuron too dear: share 0.2 / 62, mean about 0.33
    out = SynapseGroup(out.matrix, torch.tensor([2.0, 60.0, 2.0]))
    assert remove_neuron(into, out, squares(into, out), 1.0) == 1
    assert out.matrix.mask.tolist() == [[1, 0, 1]]


def test_pruning_reaches_its_goal_and_takes_out_no_more():
    torch.manual_seed(0)
    groups = [group(torch.randn(20, 30).tolist(), torch.rand(30).tolist()) for _ in range(2)]
    dense = operations(groups)
    for goal in (0.5 * dense, 0.1 * dense, 1.0):
        prune(groups, squares(*groups), goal)
        assert goal - 1 <= operations(groups) <= goal
    assert prune(groups, squares(*groups), dense) == 0
    prune(groups, squares(*groups), 0.0)
    assert operations(groups) == 0
    assert prune(groups, squares(*groups), -1.0) == 0


def test_what_was_taken_out_never_comes_back():
    torch.manual_seed(0)
    one = group(torch.randn(6, 8).tolist(), torch.rand(8).tolist())
    optimizer = torch.optim.Adam(one.matrix.parameters(), lr=0.1)
    before = one.matrix.mask.clone()
    for goal in (20.0, 12.0, 12.0, 15.0, 4.0):
        one.matrix().square().sum().backward()
        optimizer.step()
        prune([one], {one.matrix: optimizer.state[one.matrix.weight]["exp_avg_sq"]}, goal)
        assert not ((one.matrix.mask > 0) & (before == 0)).any()
        assert not one.matrix()[one.matrix.mask == 0].any()
        before = one.matrix.mask.clone()


def test_a_neuron_goes_when_its_update_costs_more_than_it_brings():
    # neuron 1 hardly matters, neuron 2 has no outgoing synapses
    weights = [[1.0, 1.0], [0.2, 0.1], [1.0, 1.0]], [[1.0, 0.1, 0.0]]
    into, out = group(weights[0], [1.0, 1.0]), group(weights[1], [0.5, 0.5, 0.5])
    out.matrix.mask[0, 2] = 0.0
    worths = squares(into, out)
    assert remove_neuron(into, out, worths, 0.0) == 0  # updates are free
    assert into.matrix.mask.tolist() == [[1, 1], [1, 1], [0, 0]]
    assert remove_neuron(into, out, worths, 10.0) == 1
    assert into.matrix.mask.tolist() == [[1, 1], [0, 0], [0, 0]]
    assert out.matrix.mask.tolist() == [[1, 0, 0]]
    assert remove_neuron(into, out, worths, 10.0) == 0  # the last one stays


def test_equal_neurons_stay():
    into, out = group([[1.0]] * 3, [1.0]), group([[1.0] * 3], [0.5] * 3)
    assert remove_neuron(into, out, squares(into, out), 10.0) == 0


@pytest.mark.parametrize("code", ["one-hot", "unary"])
@pytest.mark.parametrize("shape", [{}, {"hidden": 0}, {"skip": False}])
def test_operations_are_those_that_a_chip_counts(code, shape, tmp_path):
    policy = delta_policy(code=code, **shape).double()
    policy.into.mask[~live_neurons(policy)] = 0.0  # as pruning does
    observation = walk(200)
    _, events, hidden = followed(policy, observation)
    spikes = np.abs(events) if code == "unary" else events != 0
    student = DeltaStudent(policy, settings("stroll-sparse"))
    student._event_rate = torch.from_numpy(spikes.mean(0)).float()
    student.hidden_rate = torch.from_numpy(hidden.mean(0)).float()
    save(delta_artifact(policy), tmp_path / "policy.nir")
    artifact = load(tmp_path / "policy.nir")
    controller = SpikingController(artifact, chip("ideal"))
    for row in observation:
        controller.act(row)
    counted = controller.ledger.per_inference("sop")
    assert counted == pytest.approx(operations(student.synapses()), rel=1e-5)
    assert counted == pytest.approx(_recounted(artifact, observation), rel=1e-9)
    assert counted > 1


def _recounted(artifact, observation):
    """Spikes times non-zero weights, by hand from the nodes of the file."""
    nodes = artifact.graph.nodes
    raster = artifact.codec.encode_episode(observation)[:, 0].astype(float)
    found = sum(
        (raster @ (nodes[name].weight != 0).sum(0)).sum()
        for name in ("fc1", "skip")
        if name in nodes
    )
    if "fc2" in nodes:
        arriving = np.concatenate([0 * raster[:1], raster[:-1]])  # a control step late
        found += _emitted(artifact, arriving) @ (nodes["fc2"].weight != 0).sum(0)
    return found / len(observation)


def _emitted(artifact, raster):
    """Spikes of each hidden neuron, by the equations of the file."""
    nodes, dt = artifact.graph.nodes, artifact.convention.dt
    neuron = nodes["lif1"]
    current, membrane, total = 0.0, 0.0, 0.0
    for row in raster:
        current = (1 - dt / neuron.tau_syn) * current + nodes["fc1"].weight @ row
        beta = 1 - dt / neuron.tau_mem
        membrane = beta * membrane + current + (1 - beta) * neuron.v_leak
        spikes = membrane > neuron.v_threshold
        membrane, total = np.where(spikes, 0.0, membrane), total + spikes
    return total
