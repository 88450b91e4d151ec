"""Drift, diagnosis and measures of networks with readout layers."""

import numpy as np
import pytest

from spikedeploy.emulation.raster_emulation import measure_inference
from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.running_network import run_network
from tests.readouts import ACTIONS, HIDDEN, KINDS, events, network


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["loihi1", "ideal", "spinnaker2", "loihi1:membrane_output=none"])
def test_drift_compares_membranes_of_readouts(kind, name):
    if kind.startswith("only") and "none" in name:
        pytest.skip("nothing is left for the chip")
    if kind in ("same", "two layers") and name == "spinnaker2":
        pytest.skip("its delays are too short for the skip")
    found = drift(network(kind), chip(name), events())
    names = {"fast", "readout"} & set(network(kind).graph.nodes)
    assert {each.name for each in found.readouts} == (set() if "none" in name else names)
    assert not {layer.name for layer in found.layers} & names
    assert not {finding.layer for finding in found.findings} & names
    if name == "ideal":
        assert found.output.largest < 1e-12
        assert all(each.rms < 1e-12 and each.filled is None for each in found.readouts)
    if name == "loihi1":
        assert all(0 < each.filled < 0.5 for each in found.readouts)
        assert found.as_json()["readouts"]


def test_drift_tells_what_recorded_inputs_fill_and_what_overflows():
    raster = np.zeros((1, 400, 12), np.uint8)
    weight = compile_program(network("only"), chip("loihi1")).layers[0].synapses[0].weight
    raster[:, :, np.abs(weight.astype(int)).max(axis=1).argmax()] = 1
    (few,) = drift(network("only"), chip("loihi1"), raster[:, :60]).readouts
    (many,) = drift(network("only"), chip("loihi1"), raster).readouts
    assert few.saturations == 0
    assert many.saturations > 0
    assert many.filled >= 0.99


@pytest.mark.parametrize("name", [None, "loihi1", "loihi1:membrane_output=none"])
def test_neurobench_takes_membranes_for_graded_and_readouts_for_no_spiking_layer(name):
    artifact = network("same", state="reset")
    gated = {"clock": "gated"} if name else {}
    # a matrix of two weights behind the readout, in place of the identity
    artifact.graph.nodes["affine"].weight[:] = [[0, 2, 0], [0, 0, 0], [0, 0, 3]]
    # free, layers run on behind their windows, and ledgers count that too
    network_ = run_network(artifact, chip(name) if name else None, trace=True, **gated)
    network_.infer(events())
    found = measure_inference(artifact, network_, events(), network_.ledger)
    spikes = network_.spikes["hidden"]
    assert found.neurobench["ActivationSparsityByLayer"].keys() == {"hidden"}
    assert found.neurobench["ActivationSparsity"] == 1 - spikes.mean()
    # membranes that are still 0 take part in no operation
    assert 0 < found.neurobench["SynapticOperations"]["Effective_MACs"] <= 2 * 25
    assert found.neurobench["SynapticOperations"]["Effective_ACs"] > 0
    assert network_.ledger.sparsity == pytest.approx(1 - spikes.sum() / (HIDDEN * 75))
    assert bool(found.host) == (name is not None and "none" in name)
    if found.host:
        assert found.host["multiplications"] == 75 * ACTIONS
