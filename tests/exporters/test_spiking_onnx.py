"""A spiking policy as one step in ONNX: equal to the float twin, with states in and out."""

import json
from dataclasses import replace
from itertools import product

import nir
import numpy as np
import onnx
import onnxruntime
import pytest
from typer.testing import CliRunner

from spikedeploy.cli import app
from spikedeploy.exporters.spiking_onnx import KIND, LEVELS_STATE, checks, spiking_to_onnx
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ArtifactError, ConfigError, RuleError
from spikedeploy.trainers.onnx_session import NEXT
from spikedeploy.zoo import path as shipped
from tests import networks
from tests.delta_policies import walk

STEPS = 200


def observations(artifact, steps=STEPS, seed=0):
    """Successive observations (S, obs) that wander through the range of the normaliser."""
    normaliser = artifact.codec.normaliser
    return walk(steps, len(normaliser.mean), seed) * normaliser.std + normaliser.mean


def with_convention(artifact, **options):
    return replace(artifact, convention=artifact.convention.with_options(options))


def passed(artifact, folder, seen=None):
    """What the checks say of the file of a policy."""
    path = spiking_to_onnx(artifact, folder / "p.onnx")
    found = checks(artifact, path, observations(artifact) if seen is None else seen)
    return all(each.passed for each in found), [each.detail for each in found]


@pytest.mark.parametrize(
    "name", ["hexapod/sparse", "hexapod/popsan", "kart-steer/snn", "kart-steer/sparse"]
)
def test_shipped_policies_act_as_their_float_twins(name, tmp_path):
    artifact = load(shipped(name))
    equal, said = passed(artifact, tmp_path)
    assert equal, said
    seen = observations(artifact)
    twin = SpikingController(artifact)
    assert np.ptp([twin.act(row) for row in seen], axis=0).max() > 0.1  # they do act


POLICIES = {
    "population": networks.popsan(),
    "rate": networks.spiking_mlp(),
    "unary": networks.event_driven(code="unary", timesteps=3),
    "one-hot": networks.event_driven(code="one-hot"),
    "last": networks.with_last(networks.event_driven()),
}


CASES = [("unary", *each) for each in product(("zero", "subtract"), ("reset", "kept"), (0, 1))]
CASES += [(name, "subtract", state, 1) for name in POLICIES for state in ("reset", "kept")]


@pytest.mark.parametrize(("name", "reset", "state", "delay"), CASES)
def test_codes_resets_states_and_delays_are_those_of_the_float_twin(
    name, reset, state, delay, tmp_path
):
    artifact = with_convention(POLICIES[name], reset=reset, state=state, delay=delay)
    equal, said = passed(artifact, tmp_path, observations(artifact, 40))
    assert equal, said


def test_a_loop_hears_the_spikes_of_the_timestep_before(tmp_path):
    plain, rng = networks.event_driven(timesteps=2), np.random.default_rng(1)
    nodes = dict(plain.graph.nodes)
    nodes["back"] = nir.Affine(rng.normal(size=(8, 8)), np.zeros(8))
    looped = nir.NIRGraph(nodes, [*plain.graph.edges, ("n2", "back"), ("back", "n2")])
    artifact = replace(plain, graph=looped)
    path = spiking_to_onnx(artifact, tmp_path / "p.onnx")
    assert "n2.spikes-1" in [each.name for each in onnx.load(path).graph.input]
    (found,) = checks(artifact, path, observations(artifact, 40))
    assert found.passed, found.detail
    (found,) = checks(plain, path, observations(artifact, 40))  # the network without the loop
    assert not found.passed


def test_neurons_that_spike_when_the_threshold_is_reached(tmp_path):
    artifact = with_convention(networks.popsan(), spikes="reached", reset="zero")
    assert passed(artifact, tmp_path, observations(artifact, 20))[0]


def test_the_states_have_names_and_widths_and_begin_at_zero(tmp_path):
    artifact = networks.event_driven(hidden=8)
    path = spiking_to_onnx(artifact, tmp_path / "p.onnx")
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    first, *states = session.get_inputs()
    action, *left = session.get_outputs()
    assert (first.name, first.type, action.name) == ("observation", "tensor(double)", "action")
    assert [each.name for each in left] == [NEXT + each.name for each in states]
    said = session.get_modelmeta().custom_metadata_map
    assert json.loads(said["states"]) == {each.name: each.shape[1] for each in states}
    assert (said["kind"], said["timesteps"], said["head"]) == (KIND, "1", "continuous")
    assert states[0].name == LEVELS_STATE
    seen = observations(artifact, 1)
    zeros = {each.name: np.zeros((1, each.shape[1])) for each in states}
    found = session.run(["action"], {"observation": seen, **zeros})[0][0]
    np.testing.assert_allclose(found, SpikingController(artifact).act(seen[0]), atol=1e-12)


def test_several_robots_at_once_have_states_of_their_own(tmp_path):
    artifact = networks.event_driven()
    path = spiking_to_onnx(artifact, tmp_path / "p.onnx")
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    seen = [observations(artifact, 20, seed) for seed in (1, 2)]
    states = {each.name: np.zeros((2, each.shape[1])) for each in session.get_inputs()[1:]}
    twins = [SpikingController(artifact) for _ in seen]
    for rows in zip(*seen, strict=True):
        found, *left = session.run(None, {"observation": np.stack(rows), **states})
        states = dict(zip(states, left, strict=True))
        expected = [twin.act(row) for twin, row in zip(twins, rows, strict=True)]
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_policy_that_forgets_has_no_states_no_loop_and_the_same_bytes(tmp_path):
    path = spiking_to_onnx(networks.popsan(), tmp_path / "p.onnx")
    model, first = onnx.load(path), path.read_bytes()
    assert [each.name for each in model.graph.input] == ["observation"]
    assert not {"Loop", "Scan", "If"} & {node.op_type for node in model.graph.node}
    assert spiking_to_onnx(networks.popsan(), path).read_bytes() == first


def test_what_onnx_cannot_express_is_refused_with_the_reason(tmp_path):
    drawn = networks.spiking_mlp()
    encoder = replace(drawn.codec.encoder, mode="bernoulli")
    assert isinstance(encoder, RateEncoder)
    codec = Codec(drawn.codec.normaliser, encoder, drawn.codec.timesteps, drawn.codec.squash)
    with pytest.raises(ConfigError, match="draws random bytes"):
        spiking_to_onnx(replace(drawn, codec=codec), tmp_path / "p.onnx")
    delayed = with_convention(networks.popsan(), reset="subtract-delayed")
    with pytest.raises(RuleError, match="rule reset"):
        spiking_to_onnx(delayed, tmp_path / "p")
    with pytest.raises(ConfigError, match="no codec"):
        spiking_to_onnx(replace(networks.popsan(), codec=None), tmp_path / "p.onnx")
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_a_step_and_run_says_what_it_is(tmp_path):
    words = ["export", "kart-steer/sparse", "--to", "onnx", "--observations", "50"]
    step = tmp_path / "step.onnx"
    done = CliRunner().invoke(app, [*words, "-o", str(step)])
    assert (done.exit_code, "float twin = ONNX Runtime" in done.stdout) == (0, True), done.output
    with pytest.raises(ArtifactError, match="one step of a spiking policy"):
        OnnxController(step)
    assert CliRunner().invoke(app, [*words, "-o", str(step)]).exit_code == 0  # its own file
    assert isinstance(CliRunner().invoke(app, words).exception, ConfigError)  # without -o
