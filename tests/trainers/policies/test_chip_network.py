"""Policies that are a network on a chip: the forward pass is the chip's, the gradient of floats."""

import copy
import json

import numpy as np
import pytest
import torch

from spikedeploy.exporters.parity import check as parity
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.runtime import SpikingController, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import axon_types
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import NetworkConfig
from spikedeploy.trainers.policies import build, from_config
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import check_policy
from spikedeploy.trainers.torch_network import Weights
from spikedeploy.trainers.train import train
from tests.trainers.test_resume import After

CHIPS = (
    "xylo-a2", "xylo-imu", "speck2f", "odin", "tinyodin", "truenorth", "spiker", "spinnaker2",
    "loihi1", "loihi2",
)  # fmt: skip


def policy(name, head="continuous", seed=0, **settings):
    torch.manual_seed(seed)
    config = NetworkConfig(chip=name, **{"hidden": (12, 9), "timesteps": 6, **settings})
    return from_config(config, 3, 2, head=head)


def matrices(student):
    return [node for node in student.network.nodes.values() if isinstance(node, Weights)]


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
    assert found.passed, [each.describe(name) for each in found.results if each.failed]
    compile_program(stated, chip(name))


def test_a_weight_that_was_changed_in_place_is_compiled_anew(name):
    student = policy(name)
    before = student.module.program()
    assert student.module.program() is before
    matrices(student)[0].layer.weight.data.mul_(-1)  # as fused optimisers do, uncounted
    assert student.module.program() is not before


def test_axons_of_odin_excite_or_inhibit():
    for weight, _ in map(Weights.numbers, matrices(policy("odin"))):
        up, down = (weight > 0).any(0), (weight < 0).any(0)
        assert not (up & down).any()
        assert up.any()
        assert down.any()


def test_a_neuron_of_truenorth_has_one_weight_for_each_of_four_types():
    for seed in range(5):
        student = policy("truenorth", hidden=(40, 40), seed=seed)
        for weight, _ in map(Weights.numbers, matrices(student)):
            assert all(len(np.unique(row[row != 0])) == 4 for row in weight.detach().numpy())
        for layer in student.module.program().layers:
            assert axon_types(layer.synapses[0].weight) == 4


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


def test_a_chip_that_runs_a_pipeline_is_trained_in_its_own_clock(tmp_path):
    name = "loihi1:clock=pipelined"
    student = policy(name, timesteps=12)
    path = to_nir(student, Provenance("", "for-chip"), tmp_path / "policy.nir")
    seen = np.random.default_rng(1).normal(0, 1, (40, 3))
    controller = SpikingController(load(path), chip(name))
    acted, double = controller.act_batch(seen), copy.deepcopy(student).double()
    with torch.no_grad():
        np.testing.assert_allclose(acted, double(torch.from_numpy(seen)).numpy(), atol=1e-12)
    free = policy("loihi1", timesteps=12)
    free.load_state_dict(student.state_dict())
    with torch.no_grad():
        assert (
            free(torch.from_numpy(seen).float()) != student(torch.from_numpy(seen).float())
        ).any()


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


# -- networks of the user

OWN = {
    "Net": "loihi1", "Recurrent": "loihi2", "integrators": "speck2f", "instance": "spinnaker2",
}  # fmt: skip


def own(name, chip_name="", head="continuous", **settings):
    torch.manual_seed(0)
    settings = {"network": f"tests.own_networks:{name}", "timesteps": 6, **settings}
    config = NetworkConfig(chip=chip_name or OWN.get(name, "ideal"), **settings)
    student = from_config(config, 3, 2, head=head)
    with torch.no_grad():
        for matrix in matrices(student):
            matrix.layer.weight.mul_(4)  # so that all layers spike
    return student


@pytest.mark.parametrize("head", ["continuous", "discrete"])
@pytest.mark.parametrize("name", OWN)
def test_a_network_of_the_user_is_what_its_exported_file_does(name, head, tmp_path):
    student = own(name, head=head)
    path = to_nir(student, Provenance("", "ppo-network"), tmp_path / "policy.nir")
    seen = np.random.default_rng(1).normal(0, 1, (40, 3))
    assert all(found.passed for found in parity(student, path, seen))
    acted = SpikingController(load(path), chip(OWN[name])).act_batch(seen)
    double = copy.deepcopy(student).double()
    with torch.no_grad():
        np.testing.assert_allclose(acted, double(torch.from_numpy(seen)).numpy(), atol=1e-12)


@pytest.mark.parametrize("name", OWN)
def test_a_checkpoint_needs_no_code_of_its_author(name):
    student = own(name)
    made = build(json.loads(json.dumps(student.spec())))
    made.load_state_dict(student.state_dict())
    seen = torch.randn(20, 3)
    with torch.no_grad():
        assert torch.equal(made(seen), student(seen))
    assert made.spec() == student.spec()


def test_what_the_user_does_not_train_stays_as_it_is():
    student = own("Net")
    names = {name for name, _ in student.network.named_parameters()}
    assert len(names) == 4  # snnTorch's beta and threshold are buffers unless they are learnt
    again = build(student.spec())
    assert {name for name, _ in again.network.named_parameters()} == names


def test_a_file_with_a_codec_is_gone_on_from(tmp_path):
    student = own("Net", "loihi1", "discrete")
    path = to_nir(student, Provenance("", "ppo-network"), tmp_path / "policy.nir")
    config = NetworkConfig(network=str(path), chip="loihi1")
    further = from_config(config, 3, 2, head="discrete")
    assert further.started
    seen = torch.randn(50, 3)
    with torch.no_grad():
        torch.testing.assert_close(further.scores(seen), student.scores(seen))
    with pytest.raises(ConfigError, match="takes 3 observations and gives 2 actions"):
        from_config(config, 4, 2, head="discrete")


NETWORKS = "tests.own_networks:"


@pytest.mark.parametrize(
    ("settings", "observations", "message"),
    [
        ({}, 3, "--for xylo-a2"),
        ({"chip": "xylo-a2"}, 28, "has 16 inputs, too few for .* 28 observations"),
        ({"network": f"{NETWORKS}Missing"}, 3, "has no 'Missing'"),
        ({"network": f"{NETWORKS}Greedy"}, 3, "asks for inputs, actions, hidden"),
        (
            {"network": f"{NETWORKS}broken"},
            3,
            "making it failed with TypeError: .* It was given 24",
        ),
        ({"network": f"{NETWORKS}nothing"}, 3, "makes Tensor, and no torch.nn.Module"),
        ({"network": "nowhere.nir"}, 3, "there is no network"),
        ({"network": f"{NETWORKS}instance"}, 5, "takes 24 inputs, and the code of 5 observations"),
        ({"network": f"{NETWORKS}Net", "chip": "speck2f"}, 3, "speck2f has no leak"),
        ({"network": f"{NETWORKS}instance", "hidden": (64,), "beta": 0.5}, 3, "hidden, beta: "),
    ],
)
def test_what_makes_no_policy_is_refused(settings, observations, message):
    with pytest.raises((SpikedeployError, ValueError), match=message):
        from_config(NetworkConfig(**settings), observations, 2)


@pytest.mark.parametrize("recipe", ["ppo-network", "distill-network"])
def test_a_training_that_was_stopped_goes_on_to_the_same_bits(recipe, tmp_path):
    settings = [
        'policy.network="tests.own_networks:Net"', 'policy.chip="loihi1"', "env.count=2",
        "validation.every=16", "validation.episodes=1", "checkpoint_every=16",
    ]  # fmt: skip
    if recipe == "ppo-network":
        settings += ["horizon=16", "minibatch=16", "epochs=1"]
        length = "steps"
    else:
        settings += [
            'teacher="tests.own_teachers:level_logits"', "iterations=2", "states=32", "batch=8",
            "log_every=8",
        ]  # fmt: skip
        length = "updates"
    env = "tests.own_env:Levels"
    whole = train(
        recipe, env=env, overrides=[*settings, f"{length}=64"], runs=tmp_path / "a", quiet=True
    )
    part = train(
        recipe, env=env, overrides=[*settings, f"{length}=64"], runs=tmp_path / "b", quiet=True,
        interrupt=After(1),
    )  # fmt: skip
    assert RunFolder(part).load("last")[0]["share"] < 1
    train(recipe, resume=part, runs=tmp_path / "b", quiet=True)
    for name in ("last", "best"):
        (_, one), (_, other) = (RunFolder(run).load(name) for run in (whole, part))
        assert one.keys() == other.keys()
        assert all(torch.equal(one[key].nan_to_num(), other[key].nan_to_num()) for key in one)


def test_a_network_that_resets_otherwise_is_no_network_to_be_resumed(tmp_path):
    (student, other) = (
        from_config(NetworkConfig(network=f"tests.own_networks:{name}", chip="spinnaker2"), 3, 2)
        for name in ("Net", "Subtracts")
    )
    assert student.spec()["network"] == other.spec()["network"]
    check_policy(tmp_path, student.spec(), student)
    with pytest.raises(ConfigError, match="keeps its network"):
        check_policy(tmp_path, student.spec(), other)


def test_layers_that_share_a_matrix_have_one_each_and_it_is_said(capsys):
    student = from_config(NetworkConfig(network="tests.own_networks:Tied", chip="loihi1"), 3, 2)
    assert "layers fc1 and fc2 share weights" in capsys.readouterr().err
    first, second = matrices(student)
    assert torch.equal(first.layer.weight, second.layer.weight)
    assert first.layer.weight is not second.layer.weight
