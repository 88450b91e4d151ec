"""Policies of the experiments: batches earn what episodes earn alone, and are counted."""

import numpy as np
import pytest
import torch

from lab.experiments import chips, policies
from lab.experiments.policies import InEightBits, OnChip, in_bits, play
from spikedeploy import zoo
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.trainers.sparse.walks import Stateless
from tests.delta_policies import pruned_mlp


def test_episodes_side_by_side_earn_what_they_earn_alone():
    balance = Stateless(lambda seen: (seen[:, 2] + seen[:, 3] > 0).astype(int))
    together, counts = play("CartPole-v1", balance, 2)
    assert counts == {}
    assert play("CartPole-v1", balance, 1)[0] == together[:1]
    assert min(together) > 50


def test_what_robots_do_after_their_end_does_not_count():
    name, lengths = "chips/CartPole-v1/odin", (3, 1)
    seen = np.random.default_rng(0).normal(size=(3, 2, 4))
    policy = OnChip(zoo.path(name), "odin")
    policy.reset(2)
    for rows in seen:
        policy.act_batch(rows)
    found = policy.counts(lengths)
    alone = SpikingController(policy.artifact, chip("odin"), ledger="total")
    alone.act_batch(np.concatenate([seen[:, 0], seen[:1, 1]]))
    for event, count in (("sop", "sops"), ("neuron_update", "updates"), ("spike_out", "spikes")):
        assert found[count] == pytest.approx(alone.ledger.per_inference(event))


def test_shares_are_of_the_way_from_random_actions_where_the_teacher_earns_less_than_nothing():
    share = policies.share_of_teacher([[-110.0, -120.0]], [-100.0, -110.0], [-1100.0, -1110.0])
    assert share.mean == pytest.approx(0.99)
    assert policies.share_of_teacher([[5.0]], [10.0], [1.0]).mean == 0.5


def test_random_and_idle_actions_fit_the_environment():
    seen = np.zeros((3, 3))
    assert set(policies.at_random("CartPole-v1").act_batch(seen)) <= {0, 1}
    assert policies.at_random("Pendulum-v1").act_batch(seen).shape == (3, 1)
    assert not policies.idle("Pendulum-v1").act_batch(seen).any()


def test_multiplications_of_a_pruned_network_are_counted():
    network = OnnxController(zoo.path("hexapod/mlp-8"))
    policy = InEightBits.__new__(InEightBits)
    policy._network = network
    seen = np.random.default_rng(0).normal(size=(2, 2, 77))
    policy.reset(2)
    for rows in seen:
        policy.act_batch(rows)
    wanted = network.effective_macs(np.stack([seen[0, 0], seen[1, 0], seen[0, 1]]))
    assert policy.counts((2, 1)) == {"sops": pytest.approx(wanted)}


def test_the_page_of_chips_names_those_without_a_policy():
    counts = dict.fromkeys(("inputs", "neurons", "timesteps", "sops", "spikes", "updates"), 12.3)
    scores = {"teacher": [-100.0, -110.0], "random": [-1100.0, -1110.0], "odin": [-110.0, -120.0]}
    rows = [
        {"task": "Pendulum-v1", "chip": name, "scores": found, **counts}
        for name, found in scores.items()
    ]
    page = chips.EXPERIMENT.page(rows)
    assert "| `odin` | 99.0% [99.0%, 99.0%] ✓ |" in page
    assert "| `spiker` | not trained |" in page
    assert "| Pendulum-v1 | `odin` | -115.0" in page
    assert "`loihi1-nengo`" in page


def test_a_policy_whose_card_is_missing_or_of_another_is_trained_again(tmp_path, monkeypatch):
    monkeypatch.setattr(zoo, "FOLDER", tmp_path)
    file = chips.policy_file("CartPole-v1", "odin")
    file.parent.mkdir(parents=True)
    assert not chips.is_shipped(file)
    file.write_bytes(b"policy")
    assert not chips.is_shipped(file)
    for digest in (zoo.sha256(file), "0" * 64):
        file.with_suffix(".json").write_text(f'{{"sha256": "{digest}"}}')
        assert chips.is_shipped(file) == (digest == zoo.sha256(file))


def test_weights_in_few_bits_fill_their_range_and_zeros_cost_nothing():
    policy = pruned_mlp(3, 1, hidden=(), left=1.0)
    policy.matrices[0].weight.data = torch.tensor([[1.0, -0.5, 0.1]])
    rounded = in_bits(policy, 2)  # -1, 0, 1
    assert rounded.matrices[0]().tolist() == [[1.0, -0.0, 0.0]]
    assert rounded.matrices[0].fan_out.tolist() == [1.0, 0.0, 0.0]
    policy.matrices[0].weight.data = torch.tensor([[7.0, -3.4, 0.2]])
    policy.matrices[0].mask.fill_(1.0)
    assert in_bits(policy, 4).matrices[0]().tolist() == [[7.0, -3.0, 0.0]]
