"""NeuroBench's numbers of a convolutional network, where the extra `neurobench` is installed."""

from itertools import pairwise

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from tests.measuring import DT, IDEAL, measured, pruned
from tests.networks import lif
from tests.runtime.metrics.test_neurobench_peer import theirs, tool, torch_layer  # noqa: F401 - a fixture

pytestmark = pytest.mark.filterwarnings("ignore")


def network():
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


def test_a_convolutional_network_on_a_chip_has_neurobenchs_numbers(tool):  # noqa: F811
    import snntorch
    import torch
    from neurobench.models import SNNTorchModel

    artifact = network()
    nodes = artifact.graph.nodes
    options = {"init_hidden": True, "reset_mechanism": "zero", "reset_delay": False}

    class Twin(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.n1 = torch.nn.Conv2d(1, 3, 3, stride=2, padding=1)
            self.n1.weight.data = torch.as_tensor(nodes["n1"].weight)
            self.n1.bias.data = torch.as_tensor(nodes["n1"].bias)
            self.n2 = snntorch.Leaky(beta=0.9, threshold=0.7, **options)
            self.n3 = torch.nn.Flatten()
            self.n4 = torch_layer(nodes["n4"], artifact.convention, whole=False)
            self.n5 = snntorch.Leaky(beta=0.9, threshold=0.5, **options)

        def forward(self, x):
            for module in self.children():
                x = module(x)
            return x, None

        def reset(self):
            self.n2.reset_mem()
            self.n5.reset_mem()

    spikes = (np.random.default_rng(1).random((4, 16, 1, 6, 6)) < 0.3).astype(np.uint8)
    program = compile_program(artifact, IDEAL)
    found = measured(program, artifact.graph, spikes.reshape(4, 16, 36)).as_json()
    del found["Footprint_packed"]
    wanted = theirs(tool, SNNTorchModel(Twin()), spikes)
    assert found == wanted
    assert wanted["SynapticOperations"]["Effective_ACs"] > 500
