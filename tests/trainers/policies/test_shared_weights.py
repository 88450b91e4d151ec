"""Copies of a network for the parts of a body: shared weights, whole matrices, the same numbers."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.trainers.config import DeltaSnnConfig
from spikedeploy.trainers.policies import (
    DeltaSnnPolicy,
    PrunedMlpPolicy,
    build,
)
from spikedeploy.trainers.policies.delta_policy import delta_artifact
from spikedeploy.trainers.policies.policy import SynapseGroup
from spikedeploy.trainers.policies.shared_weights import Copies, weights_between
from spikedeploy.trainers.sparse.pruning import prune
from spikedeploy.trainers.sparse.rounding import round_for_chip
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.student import DeltaStudent
from spikedeploy.trainers.sparse.walks import Walk, WalkPool

# two arms with two observations and an action each, and one that both read, mirrored
ARMS = Copies(inputs=[[0, 1, 4], [2, 3, 4]], signs=[[1, 1, 1], [1, 1, -1]], outputs=[[0], [1]])


def test_a_mirrored_observation_gives_the_other_arm_the_action() -> None:
    torch.manual_seed(0)
    policy = PrunedMlpPolicy(5, 2, (8, 6), copies=ARMS)
    torch.nn.init.normal_(policy.past.weight)
    seen = torch.randn(7, 5)
    mirrored = seen[:, [2, 3, 0, 1, 4]] * torch.tensor([1, 1, 1, 1, -1])
    assert torch.allclose(policy.scores(seen), policy.scores(mirrored).flip(1), atol=1e-6)


@pytest.mark.parametrize(("reads", "acts"), [(True, False), (False, False), (False, True)])
def test_blocks_drive_what_the_whole_matrix_does(reads: bool, acts: bool) -> None:
    widths = 5 if reads else 6, 2 if acts else 8
    shared = weights_between(ARMS, widths, lambda n, m: torch.randn(n, m), reads, acts)
    shared.mask[0, 1] = 0.0
    inputs = torch.randn(3, 4, widths[0])
    whole = shared.whole()
    assert whole.shape == (widths[1], widths[0])
    assert torch.allclose(shared.drive(inputs, shared()), inputs @ whole.T, atol=1e-6)
    assert torch.equal(shared.whole_mask, (whole != 0).float())
    assert torch.equal(shared.block(whole), shared())
    assert shared.drive(inputs[:, :0], shared()).shape == (3, 0, widths[1])


def test_a_shared_weight_counts_its_operations_in_every_copy() -> None:
    shared = weights_between(ARMS, (5, 8), lambda n, m: torch.ones(n, m), reads=True)
    rate = torch.tensor([1.0, 2.0, 3.0, 4.0, 0.5])
    group = SynapseGroup(shared, rate)
    # four neurons of each arm; the fifth observation goes to all eight
    assert float(group.operations) == 4 * 10 + 8 * 0.5
    assert group.uses[0].tolist() == [4.0, 6.0, 1.0]
    assert float((group.uses * shared.mask).sum()) == float(group.operations)


def test_pruning_takes_a_synapse_out_of_every_copy() -> None:
    torch.manual_seed(0)
    policy = PrunedMlpPolicy(5, 2, (), copies=ARMS)
    (matrix,) = policy.layers
    squares = {matrix: torch.ones_like(matrix.weight)}
    assert prune([SynapseGroup(matrix, torch.ones(5))], squares, 4.0) == 1
    assert int((matrix.whole() != 0).sum()) == 4


@pytest.mark.parametrize("kind", [DeltaSnnPolicy, PrunedMlpPolicy])
def test_a_policy_is_built_again_from_its_spec(kind: type) -> None:
    torch.manual_seed(0)
    hidden = {} if kind is DeltaSnnPolicy else {"hidden": (8,)}
    policy = kind(5, 2, copies=ARMS, **hidden)
    again = build(policy.spec())
    again.load_state_dict(policy.state_dict())
    seen = torch.randn(3, 5)
    assert torch.equal(again.scores(seen), policy.scores(seen))


DEEP = [{}, {"hidden": 4, "deep": 2}]


def spiking(**options: Any) -> DeltaSnnPolicy:
    """A policy of two arms whose neurons all spike now and then."""
    torch.manual_seed(1)
    shape = {"hidden": 6, "timesteps": 4, "integrated": True} | options
    policy = DeltaSnnPolicy(5, 2, DeltaSnnConfig(**shape), copies=ARMS)
    policy.step.fill_(0.25)
    torch.nn.init.normal_(policy.past.weight, std=0.3)
    torch.nn.init.constant_(policy.bias, 0.42)
    return policy


def walk(steps: int) -> NDArray[np.float64]:
    """Observations (S, 5) that drift."""
    return np.cumsum(0.1 * np.random.default_rng(0).standard_normal((steps, 5)), axis=0)


def replayed(policy: DeltaSnnPolicy, burn_in: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Means and hidden spikes of a burn-in, in which nothing is, and of the walk behind it."""
    pool = WalkPool([Walk(walk(12).astype(np.float32), np.zeros((12, 2), np.float32))])
    config = SparseConfig.model_validate(
        {"algorithm": "sparse", "recipe": "", "env": {"name": "hexapod"}, "seed": 0,
         "policy": {"kind": "delta-snn"}}
    )  # fmt: skip
    found = DeltaStudent(policy, config)
    found.prepare(pool)
    windows = pool.windows(np.array([0]), np.array([-burn_in]), 12 + burn_in)
    means, (spikes,) = found.replay(windows, burn_in)
    return means, spikes


@pytest.mark.parametrize("options", DEEP)
def test_a_window_gives_what_its_control_steps_give_one_by_one(options: dict[str, Any]) -> None:
    policy = spiking(**options)
    means, spikes = replayed(policy, 2)
    state = policy.rest(1)
    with torch.no_grad():
        for t, seen in enumerate(walk(12)):
            mean, _, sent = policy.advance(torch.from_numpy(seen[None]).float(), state)
            assert torch.allclose(mean, means[:, 2 + t], atol=1e-4)
            assert torch.equal(sent.sum(1), spikes[:, 2 + t])
    assert int(spikes.detach().sum((0, 1)).count_nonzero()) == policy.hidden


@pytest.mark.parametrize("timesteps", [1, 2, 3, 5])
@pytest.mark.parametrize("options", [{}, {"hidden": 4, "deep": 2}, {"hidden": 4}])
def test_a_window_without_memory_gives_what_single_steps_give(
    timesteps: int, options: dict[str, Any]
) -> None:
    policy = spiking(timesteps=timesteps, memoryless=True, **options)
    torch.nn.init.constant_(policy.bias, 0.95)
    # what a chip cannot forget of a timestep is left out in training
    policy.set_decays(torch.full_like(policy.beta, 1e-9), torch.full_like(policy.gamma, 1e-9))
    means, spikes = replayed(policy, 2)
    state, last = policy.rest(1), []
    with torch.no_grad():
        for t, seen in enumerate(walk(12)):
            mean, _, sent = policy.advance(torch.from_numpy(seen[None]).float(), state)
            assert torch.allclose(mean, means[:, 2 + t], atol=1e-4)
            last.append(sent)
    every = torch.cat([torch.zeros_like(last[0][0, :1]), torch.cat(last, 1)[0]])
    # of a control step those spikes that its action reads: the last but one
    assert torch.equal(spikes[0, 2:], timesteps * every[timesteps - 1 : -1 : timesteps])
    assert bool(spikes.any())


@pytest.mark.parametrize("options", DEEP)
def test_deep_neurons_read_the_others_of_their_copy_alone(
    options: dict[str, Any],
) -> None:
    policy = spiking(**options)
    deep = policy.deep_neurons
    assert int(deep.sum()) == 2 * options.get("deep", 0)
    assert ("back.weight" in policy.state_dict()) == bool(options)  # as earlier versions wrote it
    if options:
        assert deep.view(2, 6).tolist() == 2 * [4 * [False] + 2 * [True]]
        assert not policy.into.whole_mask[deep].any()
        back = policy.back.whole_mask
        assert not back[~deep].any()
        assert bool(back[deep][:, ~deep].any(1).all())
        assert not back[deep][:, deep].any()
        assert not back[:6, 6:].any()
        assert not back[6:, :6].any()


@pytest.mark.parametrize("options", DEEP)
def test_a_file_computes_what_training_does_with_the_numbers_of_the_chip(
    options: dict[str, Any],
) -> None:
    deployed = round_for_chip(spiking(**options), chip("loihi1"))
    assert isinstance(deployed, DeltaSnnPolicy)
    assert deployed.copies == ARMS
    twin, precise = SpikingController(delta_artifact(deployed)), deepcopy(deployed).double()
    state = precise.rest(1)
    with torch.no_grad():
        for seen in walk(40):
            mean, *_ = precise.advance(torch.from_numpy(seen[None]), state)
            assert np.allclose(torch.tanh(mean).numpy()[0], twin.act(seen), atol=1e-9)


@pytest.mark.parametrize("options", DEEP[1:])
@pytest.mark.parametrize("lost", ["back", "into", "both"])
def test_deep_neurons_that_lost_their_synapses_go_on_by_their_bias(
    options: dict[str, Any], lost: str
) -> None:
    policy = spiking(**options)
    with torch.no_grad():
        if lost != "into":
            policy.back.mask.zero_()
        if lost != "back":
            policy.into.mask.zero_()
            policy.bias[~policy.deep_neurons] = -1.0
    precise = deepcopy(round_for_chip(policy, chip("loihi1"))).double()
    assert isinstance(precise, DeltaSnnPolicy)
    twin, state = SpikingController(delta_artifact(precise)), precise.rest(1)
    with torch.no_grad():
        for seen in walk(20):
            mean, _, sent = precise.advance(torch.from_numpy(seen[None]), state)
            assert np.allclose(torch.tanh(mean).numpy()[0], twin.act(seen), atol=1e-9)
    assert bool(sent[..., precise.deep_neurons].any())


@pytest.mark.parametrize("reads", [True, False])
def test_the_fan_out_of_shared_weights_is_that_of_the_whole_matrix(reads: bool) -> None:
    widths = (5, 8) if reads else (8, 2)
    shared = weights_between(ARMS, widths, torch.randn, reads=reads, acts=not reads)
    shared.mask[:, ::2] = 0.0
    assert torch.equal(shared.fan_out, shared.whole_mask.sum(0))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"deep": 4, "hidden": 0}, "none to read"),
        ({"deep": 4, "clock": "gated"}, "clock=pipelined"),
    ],
)
def test_deep_neurons_that_read_nothing_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DeltaSnnConfig.model_validate(settings)
