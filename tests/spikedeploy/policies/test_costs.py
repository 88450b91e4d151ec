"""What an inference costs, against counts made by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies import costs
from spikedeploy.policies.costs import Costs, _resetting, priced_by, spiking_costs
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import check as check_on
from spikedeploy.runtime.emulator.ledger import state_count
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.metrics.energy import ON_CHIP, EnergyEstimate, mac_energy
from spikedeploy.runtime.metrics.energy_tables import TABLES
from spikedeploy.runtime.metrics.neurobench import dense_operations
from tests import toy_stroll_env

OBSERVATIONS = np.random.default_rng(5).normal(size=(7, 3))


@pytest.fixture
def snn(tmp_path):
    return toy_stroll_env.snn(tmp_path / "snn.nir")


def played(observations):
    count = len(observations) - 1
    blank = np.zeros(count)
    return Rollout("x", 0, observations, np.zeros((count, 2)), blank, False, True, {})


def test_spikes_sparsity_and_operations_are_those_of_the_rasters(snn):
    artifact = load(snn)
    graph, timesteps = FloatGraph(artifact), artifact.codec.timesteps
    encoded = artifact.codec.encode(OBSERVATIONS)
    trace = graph.run(encoded)
    layers = [trace[name] for name in graph.spiking]
    player = NirController(str(snn), "float")
    player.reset(0)
    player.replay(OBSERVATIONS)
    found = spiking_costs(player.ledger, player.program, None)
    spikes = [layer.sum() / len(OBSERVATIONS) for layer in layers]
    neurons = sum(layer.shape[2] for layer in layers)
    inputs = encoded.sum() / len(OBSERVATIONS)
    # 30 inputs -> 16 -> 12 -> 20, all weights non-zero; the readout reads each of 20 once
    assert found.sops == pytest.approx(inputs * 16 + spikes[0] * 12 + spikes[1] * 20)
    assert found.effective_acs == pytest.approx(found.sops + spikes[2])
    assert found.effective_macs == 0
    assert found.spikes == pytest.approx(sum(spikes))
    assert found.input_spikes == pytest.approx(inputs)
    assert found.sparsity == pytest.approx(1 - sum(spikes) / (neurons * timesteps))
    assert found.bias_sops == timesteps * (16 + 12 + 20)
    dense = player.costs(played(OBSERVATIONS)).dense
    assert dense == timesteps * (30 * 16 + 16 * 12 + 12 * 20 + 20 * 2)


def test_the_ledger_begins_anew_with_each_episode(snn):
    player = NirController(str(snn), "loihi1")
    player.reset(0)
    player.replay(OBSERVATIONS)
    first = player.ledger
    player.reset(1)
    for observation in OBSERVATIONS[:3]:
        player.act(observation)
    assert (first.inferences, player.ledger.inferences) == (7, 3)
    assert 0 < player.ledger.total("sop") < first.total("sop")


def test_the_size_of_a_network_is_that_of_its_file_and_of_its_weights_on_the_chip(snn):
    player = NirController(str(snn), "loihi1")
    player.act(OBSERVATIONS[0])
    found = player.costs(played(OBSERVATIONS))
    weights, biases, readout = 30 * 16 + 16 * 12 + 12 * 20, 16 + 12 + 20, 20 * 2 + 2
    # on the chip one byte each; in the file four, and three constants of a layer, 4 bytes, and 12
    assert found.footprint_packed == weights + biases
    assert found.footprint == 4 * (weights + biases + readout) + 3 * (3 * 4 + 12)
    # the readout is block-diagonal: 20 of 40 are 0
    assert found.connection_sparsity == round(20 / (weights + 40), 4)


def test_a_chip_is_priced_by_its_own_tables_and_one_that_float_networks_share():
    assert priced_by(chip("loihi1")) == ("davies2018", "sanafe", "horowitz45-int8")
    assert priced_by(None) == priced_by(chip("ideal")) == ("horowitz45",)


def test_energy_per_inference_is_the_mean_of_single_inferences(snn):
    player = NirController(str(snn), "loihi1")

    def joules():
        return spiking_costs(player.ledger, player.program, player.chip).energy_j["sanafe"].value

    alone = []
    for observation in OBSERVATIONS:
        player.reset(0)
        player.act(observation)
        alone.append(joules())
    player.reset(0)
    player.replay(OBSERVATIONS)
    assert joules() == pytest.approx(np.mean(alone))


def test_a_float_network_costs_its_macs_of_which_zeros_can_be_skipped(tmp_path):
    player = OnnxController(toy_stroll_env.ann(tmp_path / "ann.onnx", hidden=(8,)))
    (hidden,) = player._session.run(["hidden1"], {"observation": OBSERVATIONS.astype("float32")})
    active = np.count_nonzero(hidden, axis=1).mean()
    assert 0 < active < 8
    assert player.effective_macs(OBSERVATIONS) == pytest.approx(3 * 8 + active * 2)
    found = player.costs(played(OBSERVATIONS))
    assert found.dense == 3 * 8 + 8 * 2
    assert found.energy_j["horowitz45"].value == mac_energy(40, TABLES["horowitz45"])
    int8 = found.energy_terms_j["horowitz45-int8"]
    # 40 products; 8 + 2 biases, each fetched and added; three observations read
    assert pytest.approx({k: 1e12 * v for k, v in int8.items()}) == {
        "operations": 40 * 1.55, "bias": 10 * 1.35, "encoder": 3 * 2.5,
    }  # fmt: skip
    assert found.total_j("horowitz45-int8") == sum(int8.values())
    skipping = found.energy_zero_skipping_j["horowitz45-int8"]
    assert skipping == pytest.approx(found.effective_macs * 1.55e-12)
    assert skipping < int8["operations"]
    assert found.energy_unknown["horowitz45-int8"] == ("activations",)
    assert found.energy_unknown["davies2018"] == ("operations", "activations")


def test_the_terms_of_a_policy_on_chip_add_up_to_its_energy_by_every_table(snn):
    player = NirController(str(snn), "loihi1")
    player.replay(OBSERVATIONS)
    found = player.costs(played(OBSERVATIONS))
    for name, table in TABLES.items():
        terms, unknown = found.energy_terms_j[name], found.energy_unknown[name]
        on_chip = sum(joules for term, joules in terms.items() if term in ON_CHIP)
        assert on_chip == pytest.approx(found.energy_j[name].value, rel=1e-12)
        assert not set(terms) & set(unknown)
        assert {*terms, *unknown, *table.included} == {*ON_CHIP, "encoder", "readout", "resets"}
        # Gaussians have no price; states begin at 0 in every inference, which tables of chips lack
        assert "encoder" in unknown
        assert ("resets" in unknown) == (name != "truenorth" and not name.startswith("horowitz45"))
        # the 20 output neurons have one weight each, two constants
        assert terms["readout"] == pytest.approx((found.effective_acs - found.sops + 2) * 1.35e-12)


def test_states_that_are_kept_are_not_reset(snn, tmp_path):
    artifact = load(snn)
    kept = replace(artifact, convention=replace(artifact.convention, state="kept"))
    save(kept, tmp_path / "kept.nir")
    resets = []
    for path in (snn, tmp_path / "kept.nir"):
        player = NirController(str(path), "loihi1")
        player.replay(OBSERVATIONS)
        terms = player.costs(played(OBSERVATIONS)).energy_terms_j
        resets += [terms[f"horowitz45-int8{more}"]["resets"] for more in ("", "-acc16", "-acc32")]
    # a current and a membrane of 16 + 12 + 20 neurons, 5 pJ a write of 32 bits, 2.5 of 16
    assert resets == pytest.approx([2 * 48 * 5e-12, 2 * 48 * 2.5e-12, 2 * 48 * 5e-12, 0, 0, 0])


def test_neurons_without_a_current_have_one_state_to_reset():
    player = NirController(str(zoo.resolve("hexapod/sparse")), "loihi1")
    hidden, readout = player.program.layers
    assert [state_count(each, player.program) for each in (hidden, readout)] == [2, 1]
    player.act(np.zeros(player.codec.encoder.observed))
    assert player.ledger.one_state == (readout.name,)
    begins_anew = replace(player.program.convention, state="reset")
    each_time = replace(player.program, convention=begins_anew)
    found = _resetting(each_time, TABLES["horowitz45-int8"])
    assert found == pytest.approx((2 * hidden.size + readout.size) * 5e-12)


ON_SEVERAL_CORES = (
    "hexapod/popsan.nir",
    "hexapod-command/popsan.nir",
    "hexapod-command/sparse.nir",
    "hexapod-command/sparse-gated.nir",
)
SHIPPED = [
    path for path in zoo.policies() if path.suffix == ".nir" and not load(path).trained_for
]  # on Loihi


@pytest.mark.parametrize("path", SHIPPED, ids=[zoo.name_in_reports(str(p)) for p in SHIPPED])
def test_shipped_policies_are_counted_as_neurobench_counts_their_file(path):
    player = NirController(
        str(path), "loihi1:clock=gated"
    )  # free, layers run on behind the last row
    player.act(np.zeros(player.codec.encoder.observed))
    found = player.costs(None)
    action = player.artifact.graph.nodes.get("action")  # an identity in all that have one
    dense = dense_operations(player.artifact.graph) - (action.weight.size if action else 0)
    assert found.dense == dense * player.codec.timesteps
    assert found.effective_macs == 0  # readouts hand membranes on, or add up spikes
    if max(player.cores.values()) > 1:
        # several cores take a message each: large layers, and one with decays of its own a neuron
        assert zoo.name_in_reports(str(path)) in ON_SEVERAL_CORES
        assert found.messages < found.messages_placed <= max(player.cores.values()) * found.messages
    else:
        assert zoo.name_in_reports(str(path)) not in ON_SEVERAL_CORES
        assert found.messages_placed == found.messages
    assert found.messages_placed_j["sanafe"] == pytest.approx(111e-12 * found.messages_placed)


def test_the_mapping_is_that_of_check():
    path = zoo.resolve("hexapod/popsan")
    found = check_on(load(path), chip("loihi1")).mapping
    cores = {each.name: each.cores for each in found.placements if each.kind == "neurons"}
    assert NirController(str(path), "loihi1").cores == cores
    assert NirController(str(path), "float").cores is None


def test_means_are_weighted_by_inferences_saturations_summed_and_unknown_terms_left_out():
    one = Costs(sops=10.0, saturations=1, energy_j={"a": EnergyEstimate(1.0, 0.5, 2.0)},
                energy_terms_j={"a": {"x": 1.0, "y": 0.0}}, energy_unknown={"a": ()})  # fmt: skip
    other = Costs(sops=40.0, saturations=2, energy_j={"a": EnergyEstimate(4.0, 2.0, math.inf)},
                  energy_terms_j={"a": {"x": 4.0}}, energy_unknown={"a": ("y",)})  # fmt: skip
    found = costs.mean([one, other], weights=[2, 1])
    assert found.sops == pytest.approx(20)
    assert found.energy_j == {"a": EnergyEstimate(2.0, 1.0, math.inf)}
    assert (found.saturations, found.spikes) == (3, None)
    assert found.energy_terms_j == {"a": {"x": pytest.approx(2.0)}}
    assert found.energy_unknown == {"a": ("y",)}
