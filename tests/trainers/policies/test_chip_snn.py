"""A policy in the integers of a chip: the forward pass is the chip's, the gradient of floats."""

import copy

import numpy as np
import pytest
import torch

from spikedeploy.exporters.parity import check as parity
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.runtime import SpikingController, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import axon_types
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import ChipSnnConfig
from spikedeploy.trainers.policies import ChipSnnPolicy, from_config
from spikedeploy.trainers.policies.chip_snn import _computes, _SpikesOfChip, trace_layers
from spikedeploy.trainers.policies.neurons import surrogate
from spikedeploy.trainers.train import train

CHIPS = (
    "xylo-a2", "xylo-imu", "speck2f", "odin", "tinyodin", "truenorth", "spiker", "spinnaker2",
    "loihi1", "loihi2",
)  # fmt: skip


def policy(name, head="continuous", seed=0, **settings):
    torch.manual_seed(seed)
    return ChipSnnPolicy(3, 2, name, head=head, **{"hidden": (12, 9), "timesteps": 6, **settings})


@pytest.fixture(params=CHIPS)
def name(request):
    return request.param


@pytest.mark.parametrize("head", ["continuous", "discrete"])
def test_the_forward_pass_is_what_the_exported_file_does_on_the_chip(name, head, tmp_path):
    student = policy(name, head)
    path = to_nir(student, Provenance("", "for-chip"), tmp_path / "policy.nir")
    seen = np.random.default_rng(1).normal(0, 1, (40, 3))
    assert all(found.passed for found in parity(student, path, seen))
    controller = SpikingController(load(path), chip(name), trace=True)
    acted, double = controller.act_batch(seen), copy.deepcopy(student).double()
    with torch.no_grad():
        np.testing.assert_allclose(acted, double(torch.from_numpy(seen)).numpy(), atol=1e-12)
    assert controller.ledger.total("spike_out") > 0


def test_the_spikes_that_gradients_flow_through_are_those_of_the_chip(name):
    student = policy(name)
    raster = student.encode(torch.randn(16, 3))
    with torch.no_grad():
        found = student.spikes(raster)
    for one, other in zip(found, student.spikes(raster), strict=True):
        assert torch.equal(one, other)
        assert other.requires_grad


@pytest.mark.parametrize("name", ["odin", "tinyodin"])
def test_the_compiled_loops_equal_the_interpreter(name):
    pytest.importorskip("numba")
    for seed in range(3):
        program = policy(name, seed=seed, hidden=(12,), timesteps=9, limit=0.9).program()
        raster = np.random.default_rng(seed).integers(0, 2, (20, 9, program.width), np.uint8)
        fast, slow = trace_layers(program, raster), trace(program, raster)
        for layer in program.layers:
            np.testing.assert_array_equal(fast[layer.name].spikes, slow[layer.name].spikes)
            np.testing.assert_array_equal(fast[layer.name].membrane, slow[layer.name].membrane)
        assert fast["lif2"].spikes.max() > 1  # several in a timestep
    assert not _computes(policy("spiker").program())


def test_every_weight_and_every_field_of_the_code_has_a_gradient(name):
    student = policy(name, hidden=(16,))
    student(torch.randn(64, 3)).square().sum().backward()
    for key, parameter in student.named_parameters():
        # the latent weights of a crossbar decide over connections, its types over their sizes
        assert parameter.grad is not None, key
        assert parameter.grad.abs().sum() > 0, key


def test_the_file_keeps_the_design_rules_of_its_chip(name, tmp_path):
    stated = load(to_nir(policy(name), Provenance(""), tmp_path / "policy.nir"))
    found = check(stated, chip(name))
    assert found.passed, [each.describe(name) for each in found.rulings if each.failed]
    compile_program(stated, chip(name))


def test_a_weight_that_was_changed_in_place_is_compiled_anew(name):
    student = policy(name)
    before = student.program()
    assert student.program() is before
    student.layers[0].get_parameter("weight").data.mul_(-1)  # as fused optimisers do, uncounted
    assert student.program() is not before


def test_axons_of_odin_excite_or_inhibit():
    for weight in policy("odin").weights():
        up, down = (weight > 0).any(0), (weight < 0).any(0)
        assert not (up & down).any()
        assert up.any()
        assert down.any()


def test_a_neuron_of_truenorth_has_one_weight_for_each_of_four_types():
    for seed in range(5):
        student = policy("truenorth", hidden=(40, 40), seed=seed)
        for weight in student.weights():
            assert all(len(np.unique(row[row != 0])) == 4 for row in weight.detach().numpy())
        for layer in student.program().layers:
            assert axon_types(layer.synapses[0].weight) == 4


@pytest.mark.parametrize("subtracts", [True, False])
@pytest.mark.parametrize(("alpha", "beta"), [(0.0, 1.0), (0.5, 0.75)])
def test_the_gradient_is_that_of_the_difference_equations(subtracts, alpha, beta):
    torch.manual_seed(0)
    drive = torch.randn(7, 5, 4, dtype=torch.float64).mul_(0.7).requires_grad_(True)
    derivative = surrogate("atan")
    upstream = torch.randn(7, 5, 4, dtype=torch.float64)
    spikes, membranes = [], []
    current = after = torch.zeros(5, 4, dtype=torch.float64)
    for x in drive:
        current = alpha * current + x
        v = beta * after + current
        spike = _Spike.apply(v, derivative)
        held = spike.detach()
        after = v - held if subtracts else v * (1 - held)
        spikes.append(spike)
        membranes.append(v.detach())
    (torch.stack(spikes) * upstream).sum().backward()
    expected, drive.grad = drive.grad, None
    told = torch.stack(membranes), torch.stack(spikes).detach()
    found = _SpikesOfChip.apply(drive, *told, (alpha, beta, False, subtracts), derivative)
    (found * upstream).sum().backward()
    torch.testing.assert_close(drive.grad, expected)


class _Spike(torch.autograd.Function):
    """One above the threshold of 1, with the surrogate as derivative."""

    @staticmethod
    def forward(ctx, membrane, derivative):
        ctx.save_for_backward(membrane)
        ctx.derivative = derivative
        return (membrane > 1).to(membrane.dtype)

    @staticmethod
    def backward(ctx, upstream):
        (membrane,) = ctx.saved_tensors
        return ctx.derivative(membrane - 1) * upstream, None


@pytest.mark.parametrize("name", ["odin", "xylo-a2", "truenorth"])
def test_it_learns_which_way_to_turn_within_few_updates(name):
    student = policy(name, "discrete", hidden=(16,))
    seen = torch.randn(400, 3)
    wanted = (seen[:, 0] > seen[:, 1]).long()
    optimiser = torch.optim.Adam(student.parameters(), 1e-2)
    for _ in range(40):
        error = torch.nn.functional.cross_entropy(student.scores(seen), wanted)
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
    with torch.no_grad():
        assert (student(seen) == wanted).float().mean() > 0.8


def test_a_chip_with_too_few_inputs_is_refused_in_a_sentence():
    with pytest.raises(ConfigError, match=r"xylo-a2 has 16 inputs, too few for .* 28 observations"):
        from_config(ChipSnnConfig(chip="xylo-a2"), 28, 4)
    assert from_config(ChipSnnConfig(chip="xylo-a2", coding="regular"), 16, 4).target.name
    with pytest.raises(ConfigError, match="name it, as in --for xylo-a2"):
        from_config(ChipSnnConfig(), 4, 2)


def test_a_chip_that_runs_a_pipeline_is_refused_in_a_sentence():
    with pytest.raises(ConfigError, match=r"loihi1:clock=pipelined: .* Leave the clock out"):
        from_config(ChipSnnConfig(chip="loihi1:clock=pipelined"), 4, 2)
    assert from_config(ChipSnnConfig(chip="loihi1:clock=free"), 4, 2).target.clock == "free"


def test_the_recipe_trains_a_run_that_is_validated_on_the_chip(tmp_path):
    settings = [
        'policy.chip="tinyodin"', 'teacher="tests.own_teachers:level_logits"', "policy.hidden=[6]",
        "iterations=2", "states=40", "updates=8", "batch=8", "validation.every=4",
        "validation.episodes=2", "log_every=2", "checkpoint_every=4", "env.count=2",
    ]  # fmt: skip
    run = train(
        "for-chip", env="tests.own_env:Levels", overrides=settings, runs=tmp_path, quiet=True
    )
    assert (run / "checkpoints" / "best.json").is_file()
