"""A script of h5py and NumPy, written from docs/evidence.md, counts what the toolchain counts."""

import ast
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies.costs import spiking_costs
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.trainers.policies.delta_policy import delta_codec
from tests.delta_policies import delta_policy
from tests.graded import delta_network
from tests.networks import chain, cuba, event_driven
from tests.paths import ROOT

SCRIPT = ROOT / "tests/project/recount.py"
STEPS = 60
SPARSE = [name for name in zoo.names() if name.endswith("/sparse")]


def recounted(policy, rollout, folder):
    """What the script writes, run where nothing of ours is on the path."""
    words = [sys.executable, "-I", SCRIPT, policy, rollout, folder / "recount.npz"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with np.load(folder / "recount.npz") as found:
        return dict(found)


def acted(artifact, path, observed, seen=None):
    """The float twin on observations, or a random walk of them, which it writes as a rollout."""
    rng = np.random.default_rng(3)
    if seen is None:
        seen = rng.normal(0, 1.0, (STEPS + 1, observed)).cumsum(axis=0)
    seen = artifact.codec.normaliser.mean + artifact.codec.normaliser.std * seen
    controller = SpikingController(artifact)
    controller.reset(0)
    actions, spikes = [], []
    for row in seen[:-1]:
        actions.append(controller.act(row))
        seen_spikes = controller.network.spikes.items()
        spikes.append({name: np.count_nonzero(rows) for name, rows in seen_spikes})
    none = np.zeros(STEPS)
    Rollout("test", 0, seen, np.stack(actions), none, False, True, {"success": none}).save(path)
    return controller, np.stack(actions), spikes


def check(path, tmp_path, seen=None):
    """The script on a file finds the spikes, SOPs and actions of the float twin."""
    artifact = load(path)
    played = acted(artifact, tmp_path / "walk.npz", artifact.codec.encoder.observed, seen)
    controller, actions, spikes = played
    found = recounted(path, tmp_path / "walk.npz", tmp_path)
    np.testing.assert_allclose(found["action"], actions, rtol=0, atol=1e-9)
    assert len(np.unique(actions, axis=0)) > 1
    for name in spikes[0]:
        np.testing.assert_array_equal(found[f"spikes/{name}"], [each[name] for each in spikes])
        assert found[f"spikes/{name}"].any()
    return found, controller


def check_operations(found, ledger):
    sops = ledger.counts[:, :, EVENTS.index("sop")]
    for index, layer in enumerate(ledger.layers):
        np.testing.assert_array_equal(found[f"sops/{layer}"], sops[:, index])
    assert sops.sum(axis=0).all()


def test_the_script_uses_h5py_and_numpy_alone():
    tree = ast.parse(SCRIPT.read_text("utf-8"))
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    imported = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    assert imported == {"sys", "h5py", "numpy"}


@pytest.mark.parametrize("name", ["hexapod/popsan", "kart-grid/snn", *SPARSE])
def test_a_shipped_policy_is_recounted(name, tmp_path):
    found, controller = check(zoo.resolve(name), tmp_path)
    check_operations(found, controller.ledger)


@pytest.mark.parametrize("code", ["unary", "one-hot"])
@pytest.mark.parametrize("timesteps", [1, 3])
def test_a_delta_code_with_kept_states_is_recounted(code, timesteps, tmp_path):
    path = tmp_path / "event.nir"
    save(event_driven(code=code, timesteps=timesteps), path)
    found, controller = check(path, tmp_path)
    check_operations(found, controller.ledger)
    assert 0 < found["spikes/input"].mean() < 6 * timesteps


@pytest.mark.parametrize(("reset", "integrator"), [("subtract", "euler"), ("zero", "exponential")])
def test_another_convention_is_recounted(reset, integrator, tmp_path):
    policy = event_driven()
    convention = replace(policy.convention, reset=reset, integrator=integrator)
    neurons = replace(cuba(8, alpha=0.5, beta=0.6), v_reset=np.full(8, 0.05))
    nodes = policy.graph.nodes
    network = chain(nodes["n1"], neurons, nodes["n3"], width=policy.codec.encoder.width, act=2)
    save(replace(policy, graph=network, convention=convention), tmp_path / "p.nir")
    check(tmp_path / "p.nir", tmp_path)


def test_a_delta_network_is_recounted(tmp_path):
    path = tmp_path / "graded.nir"
    network, codec = delta_network(inputs=30, hidden=(8,), actions=2), delta_codec(delta_policy())
    gated = replace(network.convention, clock="gated")  # as the script computes
    save(replace(network, codec=codec, convention=gated), path)
    found, controller = check(path, tmp_path)
    check_operations(found, controller.ledger)
    assert 0 < found["spikes/sd1"].mean() < 8
    ledger, program = controller.ledger, controller.network.program
    costs = spiking_costs(ledger, program, None)
    # what the host reads are membranes, through the identity of `action`, which computes nothing
    assert costs.effective_macs == ledger.per_inference("graded_sop")
    assert costs.effective_acs + costs.effective_macs == pytest.approx(costs.sops)


def test_a_policy_of_convolutions_is_recounted(tmp_path):
    path = ROOT / "examples/kart_eye/policies/snn.nir"
    seen = np.random.default_rng(4).poisson(0.3, (STEPS + 1, 1024)).astype(float)
    found, controller = check(path, tmp_path, seen)
    check_operations(found, controller.ledger)
