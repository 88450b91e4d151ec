"""NeuroBench's numbers, against counts made by hand, and against NeuroBench where it is installed.

The extra `neurobench` installs it.
"""

import importlib.metadata

import nir
import numpy as np
import pytest

from runtime.artifact import Artifact
from runtime.chip import chip
from runtime.compile import compile
from runtime.convention import Convention
from runtime.machine import Machine
from runtime.memory import packed_bytes
from runtime.neurobench import connection_sparsity, dense, footprint, neurobench, parameter_count
from runtime.program import Program, Synapses
from tests.networks import chain, cuba, lif
from tests.programs import layer

pytestmark = pytest.mark.filterwarnings("ignore")
DT = 1e-3
IDEAL = chip("ideal")


def pruned(rng, size, fan_in):
    """Weights of which a third are 0, as float32 holds them."""
    weight = 2 * rng.normal(size=(size, fan_in)) / fan_in**0.5
    return np.where(rng.random(weight.shape) < 0.33, 0, weight).astype(np.float32)


def network(reset="zero", biased=True, seed=0):
    """20 -> 16 LIF -> 12 CuBa-LIF -> 3."""
    rng = np.random.default_rng(seed)
    # snnTorch spikes once where a membrane reached two thresholds and lost one: these never do
    subtract = reset == "subtract"
    leaky = lif(16, tau=DT / 0.1, r=10.0, threshold=6.0 if subtract else 0.5)
    threshold = 12.0 if subtract else 1.5
    current_based = cuba(12, alpha=0.5, beta=0.75, dt=DT, threshold=threshold)
    leaky.v_reset = np.zeros(16)
    maps = [pruned(rng, 16, 20), pruned(rng, 12, 16), pruned(rng, 3, 12)]
    maps = [np.abs(weight) for weight in maps] if subtract else maps
    if biased:
        biases = [0.1 * rng.normal(size=len(weight)).astype(np.float32) for weight in maps]
        nodes = [nir.Affine(*each) for each in zip(maps, biases, strict=True)]
    else:
        nodes = [nir.Linear(weight) for weight in maps]
    whole = chain(nodes[0], leaky, nodes[1], current_based, nodes[2], width=20, act=3)
    return Artifact(whole, None, Convention(DT, reset=reset))


def raster(batch=4, timesteps=16, width=20, rate=0.3):
    rng = np.random.default_rng(1)
    return (rng.random((batch, timesteps, width)) < rate).astype(np.uint8)


def measured(program, graph, spikes):
    """Our numbers of one batch of inferences."""
    machine = Machine(program, len(spikes), trace=True)
    machine.infer(spikes)
    seen = machine.recordings
    return neurobench(
        graph,
        program,
        {program.input: spikes, **{name: rows.spikes for name, rows in seen.items()}},
        {name: rows.membrane for name, rows in seen.items()},
    )


def test_two_neurons_are_counted_by_hand():
    # axon 0 reaches both neurons, axon 1 the second; both keep their membranes for ever
    weight = np.array([[1.0, 1.0], [0.0, 2.0]])
    neurons = nir.IF(np.full(2, 1 / DT), np.full(2, 2.5))
    file = Artifact(chain(nir.Linear(weight.T), neurons, width=2, act=2), None, Convention(DT))
    # membranes: (1, 1), (1, 3 -> spike), (1, 0), (2, 1)
    spikes = np.array([[[1, 0], [0, 1], [0, 0], [1, 0]]], np.uint8)
    found = measured(compile(file, IDEAL), file.graph, spikes)
    assert (found.effective_acs, found.effective_macs, found.dense) == (2 + 1 + 0 + 2, 0, 4 * 4)
    assert found.activation_sparsity == 7 / 8
    assert found.activation_sparsity_by_layer == {"n2": 7 / 8}
    # both in the first timestep; the second when it spikes and is reset; both at last
    assert found.membrane_updates == 2 + 1 + 0 + 2
    assert found.effective_neuron_ops == 4 * 5
    assert found.neuron_dense_ops == 4 * 8
    assert found.connection_sparsity == 0.25
    assert found.parameter_count == 4
    # four weights, beta and threshold in float32; a factor of 4 bytes and a kind of 8
    assert found.footprint == 4 * 4 + 2 * 4 + 4 + 8


def test_inputs_that_are_no_spikes_make_their_timestep_one_of_macs():
    weight = np.ones((2, 3), np.int16)
    neurons = neurons_of(weight, threshold=1000)
    spikes = {"input": np.array([[[1, 0], [2, 1]]]), "n2": np.zeros((1, 2, 3), np.uint8)}
    file = chain(nir.Linear(weight.T), width=2, act=3)
    found = neurobench(file, neurons, spikes)
    assert (found.effective_acs, found.effective_macs) == (3, 6)
    assert found.membrane_updates is None
    assert found.as_json()["NeuronOperations"]["Effective Neuron Ops"] is None


def neurons_of(weight, threshold, **options):
    """One layer of integers on Loihi, which forgets no membrane."""
    chosen = chip("loihi1", **options)
    synapses = (Synapses("input", weight, delay=1),)
    kept = {"decays": (4095, 0), "threshold": threshold << 6, "start": 1}
    neurons = layer(chosen.fixed, "n2", weight.T, synapses, **kept)
    return Program(chosen, Convention(DT), "input", len(weight), (neurons,), "n2", None)


def test_a_network_of_bytes_is_a_quarter_of_one_of_floats():
    weight = np.array([[1, 0, -3], [0, 5, 6]], np.int8)
    floats = chain(nir.Linear(weight.astype(np.float32)), lif(2), width=3, act=2)
    whole = chain(nir.Linear(weight), lif(2), width=3, act=2)
    assert footprint(floats) - footprint(whole) == 6 * 3
    assert parameter_count(floats) == parameter_count(whole) == 6
    assert connection_sparsity(floats) == connection_sparsity(whole) == round(2 / 6, 4)


def test_packed_weights_take_the_bits_of_the_chip():
    weight = np.ones((10, 4), np.int16)
    assert packed_bytes(neurons_of(weight, threshold=9)) == 40
    assert packed_bytes(neurons_of(weight, threshold=9, weight_bits=4)) == 20
    assert packed_bytes(compile(network(biased=False), IDEAL)) == 4 * (20 * 16 + 16 * 12)


def test_a_loop_hears_its_spikes_a_timestep_later():
    weight, loop = np.eye(2), np.array([[0.0, 1.0], [1.0, 1.0]])
    neurons = lif(2, tau=DT, r=1.0, threshold=0.5)
    neurons.v_reset = np.zeros(2)
    named = {"w": nir.Linear(weight), "n": neurons, "rec": nir.Linear(loop)}
    ends = {"input": nir.Input(np.array([2])), "output": nir.Output(np.array([2]))}
    edges = [("input", "w"), ("w", "n"), ("n", "rec"), ("rec", "n"), ("n", "output")]
    file = Artifact(nir.NIRGraph({**ends, **named}, edges), None, Convention(DT))
    found = measured(compile(file, IDEAL), file.graph, np.array([[[1, 0], [0, 0]]], np.uint8))
    # the input's spike reaches 1 neuron; that neuron's spike 1 more; its spike comes too late
    assert found.effective_acs == 1 + 1


# -- against NeuroBench ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tool():
    return pytest.importorskip(
        "neurobench.benchmarks", reason="the extra `neurobench` is not installed"
    )


def torch_twin(artifact, whole=False):
    """The network in snnTorch; with `whole` its weights are bytes, which can only be counted."""
    import torch
    from neurobench.models import SNNTorchModel

    class Twin(torch.nn.Module):
        def __init__(self):
            super().__init__()
            nodes = [node for name, node in artifact.graph.nodes.items() if name[0] == "n"]
            for index, node in enumerate(nodes, start=1):
                self.add_module(f"n{index}", torch_layer(node, artifact.convention, whole))

        def forward(self, x):
            for module in self.children():
                x = module(x)
            return x, None

        def reset(self):
            for module in self.children():
                if hasattr(module, "reset_mem"):
                    module.reset_mem()

    return SNNTorchModel(Twin())


def torch_layer(node, convention, whole):
    import snntorch
    import torch

    options = {
        "reset_mechanism": convention.reset,
        "reset_delay": False,
        "init_hidden": True,
    }
    if isinstance(node, (nir.LIF, nir.IF)):
        beta = float(1 - convention.dt / node.tau[0]) if isinstance(node, nir.LIF) else 1.0
        return snntorch.Leaky(beta=beta, threshold=float(node.v_threshold[0]), **options)
    if isinstance(node, nir.CubaLIF):
        decays = [float(1 - convention.dt / tau[0]) for tau in (node.tau_syn, node.tau_mem)]
        return snntorch.Synaptic(*decays, threshold=float(node.v_threshold[0]), **options)
    biased = isinstance(node, nir.Affine)
    linear = torch.nn.Linear(*node.weight.T.shape, bias=biased)
    dtype = torch.int8 if whole else torch.float32
    held = torch.as_tensor(np.ascontiguousarray(node.weight)).to(dtype)
    linear.weight = torch.nn.Parameter(held, requires_grad=False)
    if biased:
        linear.bias = torch.nn.Parameter(torch.as_tensor(node.bias), requires_grad=False)
    return linear


def theirs(tool, model, spikes):
    """Everything that NeuroBench 2.3.0 can say of it, one batch at a time."""
    import torch
    from neurobench.metrics.static import ConnectionSparsity, Footprint, ParameterCount
    from neurobench.metrics.workload import (
        ActivationSparsity,
        ActivationSparsityByLayer,
        MembraneUpdates,
        NeuronOperations,
        SynapticOperations,
    )
    from torch.utils.data import DataLoader, TensorDataset

    data = TensorDataset(torch.as_tensor(spikes, dtype=torch.float32), torch.zeros(len(spikes)))
    still = [ParameterCount, Footprint, ConnectionSparsity]
    moving = [
        ActivationSparsity,
        ActivationSparsityByLayer,
        MembraneUpdates,
        NeuronOperations,
        SynapticOperations,
    ]
    loader = DataLoader(data, batch_size=len(spikes))
    return tool.Benchmark(model, loader, [], [], [still, moving]).run(quiet=True)


def test_the_extra_installs_the_release_that_is_named(tool):
    assert importlib.metadata.version("neurobench").startswith("2.3.")


@pytest.mark.parametrize("reset", ["zero", "subtract"])
@pytest.mark.parametrize("biased", [True, False])
def test_every_number_of_neurobench_is_reproduced_exactly(tool, reset, biased):
    artifact = network(reset, biased)
    found = measured(compile(artifact, IDEAL), artifact.graph, raster()).as_json()
    assert found.pop("Footprint_packed") > 0
    wanted = theirs(tool, torch_twin(artifact), raster())
    assert found == wanted
    # and there is something to count
    assert 0.3 < wanted["ActivationSparsity"] < 0.98
    assert wanted["SynapticOperations"]["Effective_ACs"] > 500
    assert wanted["ConnectionSparsity"] > 0.2


@pytest.mark.parametrize("timesteps", [1, 5, 40])
def test_every_number_is_reproduced_for_any_number_of_timesteps(tool, timesteps):
    artifact = network(seed=timesteps)
    spikes = raster(3, timesteps)
    found = measured(compile(artifact, IDEAL), artifact.graph, spikes).as_json()
    del found["Footprint_packed"]
    assert found == theirs(tool, torch_twin(artifact), spikes)


def whole_network():
    """Whole weights of which some are 0, neurons that forget nothing: exact in floats and ints."""
    rng = np.random.default_rng(3)
    weight = rng.integers(-40, 90, (12, 20)) * (rng.random((12, 20)) < 0.7)
    neurons = nir.IF(np.full(12, 1 / DT), np.full(12, 150.0))
    return weight.astype(np.int8), neurons


def test_the_numbers_of_bytes_on_a_chip_are_those_of_neurobench(tool):
    weight, neurons = whole_network()
    graph = chain(nir.Linear(weight), neurons, width=20, act=12)
    file = Artifact(graph, None, Convention(DT))
    program = neurons_of(weight.T.astype(np.int16), threshold=150)
    found = measured(program, graph, raster()).as_json()
    assert found["Footprint_packed"] == 20 * 12
    # bytes cannot be multiplied by torch: they are counted as bytes, and run as floats
    counted = theirs(tool, torch_twin(file), raster())
    still = static(torch_twin(file, whole=True))
    assert {**found, **still} == found
    assert {name: found[name] for name in counted if name not in still} == {
        name: value for name, value in counted.items() if name not in still
    }
    assert counted["Footprint"] - still["Footprint"] == 3 * 20 * 12


def static(model):
    from neurobench.metrics.static import ConnectionSparsity, Footprint, ParameterCount

    return {
        kind.__name__: kind()(model) for kind in (ConnectionSparsity, Footprint, ParameterCount)
    }


def test_dense_counts_zero_weights_too():
    assert dense(compile(network(), IDEAL)) == 20 * 16 + 16 * 12 + 12 * 3
