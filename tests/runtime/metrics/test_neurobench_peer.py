"""Our figures of NeuroBench's metrics against NeuroBench itself, where it is installed."""

from itertools import pairwise

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from tests.measuring import (
    DT,
    IDEAL,
    measured,
    network,
    neurons_of,
    pruned,
    raster,
)
from tests.networks import chain, lif

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def tool():
    return pytest.importorskip(
        "neurobench.benchmarks",
        reason="NeuroBench is not installed; ./spike test --peers compares with it",
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
        beta = float(1 - convention.dt / node.tau.flat[0]) if isinstance(node, nir.LIF) else 1.0
        return snntorch.Leaky(beta=beta, threshold=float(node.v_threshold.flat[0]), **options)
    if isinstance(node, nir.CubaLIF):
        decays = [float(1 - convention.dt / tau[0]) for tau in (node.tau_syn, node.tau_mem)]
        return snntorch.Synaptic(*decays, threshold=float(node.v_threshold[0]), **options)
    if isinstance(node, nir.Flatten):
        return torch.nn.Flatten()
    biased = not isinstance(node, nir.Linear)
    if isinstance(node, nir.Conv2d):
        channels, *kernel = node.weight.shape[1:]
        made = torch.nn.Conv2d(channels, len(node.weight), kernel, node.stride, node.padding)
    else:
        made = torch.nn.Linear(*node.weight.T.shape, bias=biased)
    dtype = torch.int8 if whole else torch.float32
    held = torch.as_tensor(np.ascontiguousarray(node.weight)).to(dtype)
    made.weight = torch.nn.Parameter(held, requires_grad=False)
    if biased:
        made.bias = torch.nn.Parameter(torch.as_tensor(node.bias), requires_grad=False)
    return made


def theirs(tool, model, spikes):
    """Every metric of NeuroBench 2.3.0, one batch at a time."""
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


@pytest.mark.parametrize("reset", ["zero", "subtract"])
@pytest.mark.parametrize("biased", [True, False])
def test_every_number_of_neurobench_is_reproduced_exactly(tool, reset, biased):
    artifact = network(reset, biased)
    found = measured(compile_program(artifact, IDEAL), artifact.graph, raster())
    assert found.pop("Footprint_packed") > 0
    wanted = theirs(tool, torch_twin(artifact), raster())
    assert found == wanted
    # and there is something to count
    assert 0.3 < wanted["ActivationSparsity"] < 0.98
    assert wanted["SynapticOperations"]["Effective_ACs"] > 500
    assert wanted["ConnectionSparsity"] > 0.2


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
    found = measured(program, graph, raster())
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


def convolutional():
    """1 x 6 x 6 -> convolution to 3 x 3 x 3 LIF -> 5 LIF."""
    rng = np.random.default_rng(0)
    kernel = rng.normal(size=(3, 1, 3, 3)) * (rng.random((3, 1, 3, 3)) < 0.8)
    convolution = nir.Conv2d(
        (6, 6), kernel.astype(np.float32), (2, 2), (1, 1), (1, 1), 1, np.zeros(3, np.float32)
    )
    maps = nir.LIF(*(np.full((3, 3, 3), value) for value in (DT / 0.1, 10.0, 0.0, 0.7)))
    last = lif(5, tau=DT / 0.1, r=10.0, threshold=0.5)
    maps.v_reset, last.v_reset = np.zeros((3, 3, 3)), np.zeros(5)
    nodes = {
        "input": nir.Input(np.array([1, 6, 6])),
        "n1": convolution,
        "n2": maps,
        "n3": nir.Flatten({"input": np.array([3, 3, 3])}, 0, -1),
        "n4": nir.Linear(pruned(rng, 5, 27)),
        "n5": last,
        "output": nir.Output(np.array([5])),
    }
    return Artifact(nir.NIRGraph(nodes, list(pairwise(nodes))), None, Convention(DT))


def test_a_convolutional_network_on_a_chip_has_neurobenchs_numbers(tool):
    artifact = convolutional()
    spikes = (np.random.default_rng(1).random((4, 16, 1, 6, 6)) < 0.3).astype(np.uint8)
    program = compile_program(artifact, IDEAL)
    found = measured(program, artifact.graph, spikes.reshape(4, 16, 36))
    del found["Footprint_packed"]
    wanted = theirs(tool, torch_twin(artifact), spikes)
    assert found == wanted
    assert wanted["SynapticOperations"]["Effective_ACs"] > 500
