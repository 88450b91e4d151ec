"""NeuroBench's numbers against counts made by hand; test_neurobench_peer has NeuroBench itself."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.metrics.neurobench import (
    connection_sparsity,
    dense_operations,
    footprint,
    neurobench,
)
from spikedeploy.runtime.metrics.traffic import packed_bytes
from tests.measuring import DT, IDEAL, convolutions, measured, network, neurons_of, raster
from tests.networks import chain, lif, popsan


def test_two_neurons_are_counted_by_hand():
    # axon 0 reaches both neurons, axon 1 the second; both keep their membranes for ever
    weight = np.array([[1.0, 1.0], [0.0, 2.0]])
    neurons = nir.IF(np.full(2, 1 / DT), np.full(2, 2.5))
    file = Artifact(chain(nir.Linear(weight.T), neurons, width=2, act=2), None, Convention(DT))
    # membranes: (1, 1), (1, 3 -> spike), (1, 0), (2, 1)
    spikes = np.array([[[1, 0], [0, 1], [0, 0], [1, 0]]], np.uint8)
    found = measured(compile_program(file, IDEAL), file.graph, spikes)
    assert (
        found["SynapticOperations"]["Effective_ACs"],
        found["SynapticOperations"]["Effective_MACs"],
        found["SynapticOperations"]["Dense"],
    ) == (2 + 1 + 0 + 2, 0, 4 * 4)
    assert found["ActivationSparsity"] == 7 / 8
    assert found["ActivationSparsityByLayer"] == {"n2": 7 / 8}
    # both in the first timestep; the second when it spikes and is reset; both at last
    assert found["MembraneUpdates"] == 2 + 1 + 0 + 2
    assert found["NeuronOperations"]["Effective Neuron Ops"] == 4 * 5
    assert found["NeuronOperations"]["Neuron Dense Ops"] == 4 * 8
    assert found["ConnectionSparsity"] == 0.25
    assert found["ParameterCount"] == 4
    # four weights, beta and threshold in float32; a factor of 4 bytes and a kind of 8
    assert found["Footprint"] == 4 * 4 + 2 * 4 + 4 + 8


def test_inputs_that_are_no_spikes_make_their_timestep_one_of_macs():
    weight = np.ones((2, 3), np.int16)
    neurons = neurons_of(weight, threshold=1000)
    spikes = {"input": np.array([[[1, 0], [2, 1]]]), "n2": np.zeros((1, 2, 3), np.uint8)}
    file = chain(nir.Linear(weight.T), width=2, act=3)
    found = neurobench(file, neurons, spikes)
    assert (
        found["SynapticOperations"]["Effective_ACs"],
        found["SynapticOperations"]["Effective_MACs"],
    ) == (3, 6)
    assert found["MembraneUpdates"] is None
    assert found["NeuronOperations"]["Effective Neuron Ops"] is None


def test_a_network_of_bytes_is_a_quarter_of_one_of_floats():
    weight = np.array([[1, 0, -3], [0, 5, 6]], np.int8)
    floats = chain(nir.Linear(weight.astype(np.float32)), lif(2), width=3, act=2)
    whole = chain(nir.Linear(weight), lif(2), width=3, act=2)
    assert footprint(floats) - footprint(whole) == 6 * 3
    assert connection_sparsity(floats) == connection_sparsity(whole) == round(2 / 6, 4)


def test_dense_operations_count_zero_weights_and_no_padding():
    assert dense_operations(network().graph) == 20 * 16 + 16 * 12 + 12 * 3
    # four places of three taps, less one at each end
    assert dense_operations(nir.NIRGraph.from_list(convolutions()[0])) == 4 * 3 - 2
    bare = chain(lif(3), width=3, act=3)
    assert (connection_sparsity(bare), dense_operations(bare)) == (0, 0)


def test_packed_weights_take_the_bits_of_the_chip():
    weight = np.ones((10, 4), np.int16)
    assert packed_bytes(neurons_of(weight, threshold=9)) == 40
    assert packed_bytes(neurons_of(weight, threshold=9, weight_bits=4)) == 20
    assert packed_bytes(compile_program(network(biased=False), IDEAL)) == 4 * (20 * 16 + 16 * 12)


def test_spikes_of_a_loop_arrive_a_timestep_later():
    weight, loop = np.eye(2), np.array([[0.0, 1.0], [1.0, 1.0]])
    neurons = lif(2, tau=DT, r=1.0, threshold=0.5)
    neurons.v_reset = np.zeros(2)
    named = {"w": nir.Linear(weight), "n": neurons, "rec": nir.Linear(loop)}
    ends = {"input": nir.Input(np.array([2])), "output": nir.Output(np.array([2]))}
    edges = [("input", "w"), ("w", "n"), ("n", "rec"), ("rec", "n"), ("n", "output")]
    file = Artifact(nir.NIRGraph({**ends, **named}, edges), None, Convention(DT))
    found = measured(
        compile_program(file, IDEAL), file.graph, np.array([[[1, 0], [0, 0]]], np.uint8)
    )
    # the input's spike reaches 1 neuron; that neuron's spike 1 more; its spike comes too late
    assert found["SynapticOperations"]["Effective_ACs"] == 1 + 1


@pytest.mark.parametrize("name", ["ideal", "loihi1"])
def test_the_ledger_of_the_same_run_agrees(name):
    file = popsan()
    program = compile_program(file, chip(name), clock="gated")
    machine = Machine(program, 4, trace=True)
    spikes = raster(width=30)
    machine.infer(spikes)
    found, ledger = measured(program, file.graph, spikes), machine.ledger
    readout = machine.recordings[program.output].spikes.sum() / 4  # each has one presynaptic neuron
    assert found["SynapticOperations"]["Effective_ACs"] == ledger.per_inference("sop") + readout
    assert found["ActivationSparsity"] == ledger.sparsity
    # what changed had something to add up
    assert (
        0 < found["MembraneUpdates"] <= ledger.per_inference("neuron_update") + sum(ledger.neurons)
    )
