import numpy as np
import pytest
import torch
from pydantic import ValidationError
from torch.nn.functional import conv2d

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.trainers.config import VisionConfig, VisionSnnConfig
from spikedeploy.trainers.policies import SpikingVisionPolicy, build, from_config
from spikedeploy.trainers.policies.policy import PrunedKernel, SynapseGroup
from spikedeploy.trainers.policies.vision import vision_artifact
from spikedeploy.trainers.sparse.student import operations, prune

SHAPE = (2, 6, 10)
SIZE = 120
SMALL = {"shape": SHAPE, "channels": (3, 4), "kernels": (3, 3), "strides": (2, 2)}
GRID = {"shape": SHAPE, "channels": (), "kernels": (), "strides": (), "pool": (2, 2)}

POLICIES = [
    VisionConfig(**SMALL, hidden=(7,), gru=5),
    VisionConfig(**GRID, hidden=(6,), gru=0, traces=(0.5, 0.9)),
    VisionSnnConfig(**SMALL, hidden=9, memory=4),
    VisionSnnConfig(**SMALL, hidden=9, most=2, clock="gated", recurrent=False),
    VisionSnnConfig(
        **SMALL, hidden=9, recurrent=False, skip=False, most=3, clock="gated", neuron="if"
    ),
]


def counts(batch, steps, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.poisson(torch.full((batch, steps, SIZE), 0.4), generator=generator)


def made(config):
    torch.manual_seed(1)
    policy = from_config(config, SIZE, 7, head="discrete").double().requires_grad_(False)
    policy.normalise(counts(4, 12).double())
    return policy


@pytest.mark.parametrize("config", POLICIES, ids=lambda c: c.kind)
def test_control_steps_one_by_one_equal_a_window(config):
    policy, seen = made(config), counts(3, 15, seed=2).double()
    state = policy.rest(3)
    steps = [policy.advance(row, state)[0] for row in seen.unbind(1)]
    window = policy.unrolled(seen, policy.weights(), policy.rest(3))
    torch.testing.assert_close(torch.stack(steps, 1), window.mean)
    assert window.mean.std() > 0.01


@pytest.mark.parametrize("config", POLICIES, ids=lambda c: c.kind)
def test_a_policy_is_built_again_from_its_spec(config):
    policy, seen = made(config), counts(2, 5).double()
    copy = build(policy.spec()).double().requires_grad_(False)
    copy.load_state_dict(policy.state_dict())
    again, first = (p.unrolled(seen, p.weights(), p.rest(2)).mean for p in (copy, policy))
    torch.testing.assert_close(again, first, rtol=0, atol=0)


@pytest.mark.parametrize(("recurrent", "memory"), [(False, 0), (True, 4)])
def test_the_spiking_network_is_its_equations(recurrent, memory):
    policy = made(VisionSnnConfig(**SMALL, hidden=9, recurrent=recurrent, memory=memory))
    seen = counts(1, 12, seed=3).double()
    got = policy.unrolled(seen, policy.weights(), policy.rest(1))
    w = {name: weight.numpy() for name, weight in policy.weights().items()}
    decay = {name: policy.decay(name).numpy() for name in policy.decays}
    kernels = [torch.from_numpy(w[name]) for name in ("conv1", "conv2")]
    grids = [policy.matrix(name).target for name in ("conv1", "conv2")]
    x, sent = np.zeros(SIZE), [np.zeros(grid) for grid in grids]
    v, i, h, sent_h = [np.zeros(grid) for grid in grids], np.zeros(9), np.zeros(9), np.zeros(9)
    y, alpha = np.zeros(7), np.zeros(9)
    if memory:
        alpha[-memory:] = decay["current"]
    for t, row in enumerate(seen[0].numpy()):
        before, sent_h_before = [x.reshape(SHAPE), *sent], sent_h
        for k, kernel in enumerate(kernels):
            drive = conv2d(torch.from_numpy(before[k])[None], kernel, stride=2, padding=1)[0]
            v[k] = decay[f"conv{k + 1}"][:, None, None] * v[k] + drive.numpy()
            sent[k] = (v[k] > 1).astype(float)
            v[k] = v[k] * (1 - sent[k])
        i = alpha * i + w["hidden"] @ before[2].ravel()
        if recurrent:
            i = i + w["back"] @ sent_h_before
        h = decay["hidden"] * h + i
        sent_h = (h > 1).astype(float)
        h = h * (1 - sent_h)
        y = decay["out"] * y + w["out"] @ sent_h_before + w["past"] @ before[2].ravel()
        x = (row >= 1).astype(float)
        np.testing.assert_allclose(got.mean[0, t], y + policy.biases["out"].numpy(), atol=1e-12)


@pytest.mark.parametrize("config", POLICIES[2:], ids=["memory", "gated", "if"])
def test_a_file_chooses_as_the_policy_does(config):
    policy, seen = made(config), counts(3, 25, seed=4).double()
    if config.neuron == "lif":
        policy.biases["hidden"].uniform_(-0.1, 0.2)
    policy.matrix("out").weight.normal_()
    window = policy.unrolled(seen, policy.weights(), policy.rest(3)).mean
    place = chip("ideal") if config.neuron == "lif" else None  # which has no such neurons
    controller = SpikingController(vision_artifact(policy), place, ledger="none")
    controller.reset(0)
    chosen = np.stack([controller.act_batch(row) for row in seen.numpy().swapaxes(0, 1)], 1)
    assert chosen.tolist() == window.argmax(-1).tolist()
    assert len(set(chosen.ravel())) > 2


def test_a_policy_of_integrators_is_one_that_speck_takes_event_by_event():
    policy = made(POLICIES[4])
    for target in ("speck2f", "speck2f:queue=on"):
        assert compile_program(vision_artifact(policy), chip(target)).layers


def test_memory_is_part_of_the_hidden_layer_and_needs_a_leak():
    with pytest.raises(ValidationError, match="at most 8 can"):
        VisionSnnConfig(hidden=8, memory=9)
    with pytest.raises(ValidationError, match="at most 0 can"):
        VisionSnnConfig(hidden=8, memory=2, recurrent=False, neuron="if")
    with pytest.raises(ValidationError, match="have no recurrence"):
        VisionSnnConfig(hidden=8, neuron="if")


def synapses_of(kernel, activity):
    """Operations of each weight, counted one input at a time."""
    found = np.zeros(kernel.mask.shape)
    _, rows, columns = kernel.target
    for c, y, x in np.argwhere(activity):
        for row in range(rows):
            for column in range(columns):
                at = y - row * kernel.stride + kernel.padding
                left = x - column * kernel.stride + kernel.padding
                if 0 <= at < found.shape[2] and 0 <= left < found.shape[3]:
                    found[:, c, at, left] += activity[c, y, x]
    return found * kernel.mask.numpy()


@pytest.mark.parametrize(("size", "stride"), [(3, 1), (3, 2), (5, 2), (5, 3), (1, 2)])
def test_operations_of_a_kernel_are_those_of_its_synapses(size, stride):
    torch.manual_seed(0)
    kernel = PrunedKernel((2, 7, 9), 3, size, stride)
    kernel.mask.bernoulli_(0.6)
    activity = torch.rand(2, 7, 9)
    each = synapses_of(kernel, activity.numpy())
    group = SynapseGroup(kernel, activity.flatten())
    np.testing.assert_allclose((group.uses * kernel.mask).numpy(), each, rtol=1e-5)
    np.testing.assert_allclose(float(group.operations), each.sum(), rtol=1e-5)


def test_pruning_ranks_kernels_and_matrices_by_operations_together():
    policy = made(VisionConfig(**SMALL, hidden=(7,), gru=5)).float()
    done = policy.unrolled(counts(4, 12), policy.weights(), policy.rest(4))
    rates = [(each != 0).float().mean(0) for each in done.inputs]
    pairs = zip(policy.synapses, rates, strict=True)
    groups = [SynapseGroup(policy.matrix(name), rate) for name, rate in pairs]
    squares = {group.matrix: torch.rand_like(group.matrix.weight) for group in groups}
    target = 0.4 * operations(groups)
    prune(groups, squares, target)
    most = max(float(group.uses.max()) for group in groups)
    assert target - most <= operations(groups) <= target
    pruned = [float(1 - group.matrix.mask.mean()) for group in groups]
    assert sum(share > 0 for share in pruned) > 3
    # for equal worth, a weight of a kernel that many inputs meet goes first
    assert pruned[0] > pruned[-1]


@pytest.mark.parametrize("skip", [True, False])
def test_a_pipelined_policy_acts_as_many_steps_late_as_it_has_layers(skip):
    policy = SpikingVisionPolicy(
        1024, 7, channels=(2, 2), kernels=(3, 3), strides=(4, 2), hidden=4, skip=skip
    )
    if skip:
        torch.nn.init.normal_(policy.matrix("past").weight)
    program = compile_program(vision_artifact(policy), chip("loihi1"))
    # two convolutions, the hidden layer, and the readout, which may hear the convolutions as well
    assert program.control_steps_late(1) == ((3, 4) if skip else (4, 4))
