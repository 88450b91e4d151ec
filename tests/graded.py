"""Networks with sigma-delta neurons."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.graph.discretisation import SigmaDelta
from tests.networks import graph

DT = 1e-3


def integrators(size):
    return nir.I(np.full(size, 1 / DT))


def one_neuron():
    """input (2) -> weights 1 and -1/2 -> a sigma-delta neuron -> readout that adds up; its trace:

    bias 1/4, threshold 1/2, each graded spike weighs 1/2
    t  input  sigma    a     a/threshold - q    k    q   readout
    0  1 0     1      5/4      5/2               3    3    3/2
    1  0 0     1      5/4     -1/2               0    3    3/2
    2  0 1     1/2    3/4     -3/2              -2    1    1/2
    3  0 1     0      1/4     -1/2               0    1    1/2
    4  0 1    -1/2    0       -1                -1    0    0
    """
    network = graph(
        "input->fc1, fc1->sd1, sd1->fc2, fc2->readout, readout->output",
        input=nir.Input(np.array([2])),
        fc1=nir.Linear(np.array([[1.0, -0.5]])),
        sd1=integrators(1),
        fc2=nir.Linear(np.array([[0.5]])),
        readout=integrators(1),
        output=nir.Output(np.array([1])),
    )
    neurons = {"sd1": SigmaDelta(np.array([0.5]), np.array([0.25]))}
    return Artifact(network, None, Convention(DT, state="kept"), sigma_delta=neurons)


INPUT = np.array([[[1, 0], [0, 0], [0, 1], [0, 1], [0, 1]]], np.uint8)
SIGMA = [1.0, 1.0, 0.5, 0.0, -0.5]
GRADED = [3, 0, -2, 0, -1]
OUTPUT = [1.5, 1.5, 0.5, 0.5, 0.0]


def delta_network(inputs=12, hidden=(10,), actions=3, skip=True, seed=0, state="kept"):
    """Layers of sigma-delta neurons, a skip connection, and an integrating readout."""
    rng = np.random.default_rng(seed)
    nodes = {"input": nir.Input(np.array([inputs])), "output": nir.Output(np.array([actions]))}
    edges, before, width, neurons = [], "input", inputs, {}
    theta = np.ones(inputs)
    for number, size in enumerate(hidden, start=1):
        nodes[f"fc{number}"] = nir.Linear(0.5 * rng.normal(size=(size, width)) * theta)
        nodes[f"sd{number}"] = integrators(size)
        theta = rng.uniform(0.2, 0.6, size)
        neurons[f"sd{number}"] = SigmaDelta(theta, rng.normal(size=size) * 0.3)
        edges += [f"{before}->fc{number}", f"fc{number}->sd{number}"]
        before, width = f"sd{number}", size
    nodes["out"] = nir.Linear(rng.normal(size=(actions, width)) * theta)
    nodes["readout"] = integrators(actions)
    edges += [f"{before}->out", "out->readout", "readout->output"]
    if skip:
        nodes["skip"] = nir.Linear(0.5 * rng.normal(size=(actions, inputs)))
        edges += ["input->skip", "skip->readout"]
    convention = Convention(DT, state=state)
    return Artifact(graph(", ".join(edges), **nodes), None, convention, sigma_delta=neurons)


def rasters(batch=3, timesteps=40, inputs=12, seed=1):
    """Input spikes (B, T, M), one in ten."""
    rng = np.random.default_rng(seed)
    return (rng.random((batch, timesteps, inputs)) < 0.1).astype(np.uint8)
