"""Networks that end in neurons without a threshold, with and without skips from the input."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from tests.networks import cuba, graph, lif

DT = 1e-3
INPUTS, HIDDEN, ACTIONS = 12, 8, 3
SLOW = 4095 / 4096
KINDS = ("none", "same", "second", "two layers", "only", "only LI", "only I")


def li(*decays):
    """LI neurons with these decay factors and gains of 1."""
    tau = DT / (1 - np.array(decays))
    return nir.LI(tau=tau, r=tau / DT, v_leak=np.zeros(len(tau)))


def cubali(size, current=SLOW, membrane=0.5):
    synaptic, leaky = DT / (1 - current), DT / (1 - membrane)
    full = [np.full(size, value) for value in (synaptic, leaky, leaky / DT, 0.0)]
    return nir.CubaLI(*full, w_in=np.full(size, synaptic / DT))


def integrators(size):
    return nir.I(np.full(size, 1 / DT))


def linear(rng, size, inputs, scale=0.5):
    """Weights of which four in ten are zero."""
    weight = scale * rng.normal(size=(size, inputs))
    weight[rng.random(weight.shape) < 0.4] = 0
    return nir.Linear(weight)


def spiking(kind):
    if kind == "CubaLIF":
        return cuba(HIDDEN, SLOW, 0.6, threshold=1.0)
    if kind == "IF":
        return nir.IF(np.full(HIDDEN, 1 / DT), np.ones(HIDDEN), np.zeros(HIDDEN))
    neurons = lif(HIDDEN, 2e-3, 2.0)
    neurons.v_reset = np.zeros(HIDDEN)
    return neurons


def network(kind, state="kept", reset="zero", neurons="CubaLIF", seed=0):
    """A policy of T timesteps with the skip of that kind, and random weights.

    kind: "none"; from the input to the "same" readout, or to a "second" one; a readout of "two
        layers"; or the input alone on CubaLI, LI or I, without a neuron that spikes.
    neurons: kind of the hidden neurons: CubaLIF, LIF or IF.
    """
    rng = np.random.default_rng(seed)
    decays = rng.uniform(0.5, 0.7, ACTIONS)
    nodes = {
        "input": nir.Input(np.array([INPUTS])),
        "output": nir.Output(np.array([ACTIONS])),
        "affine": nir.Affine(np.eye(ACTIONS), rng.normal(size=ACTIONS)),
        "skip": linear(rng, ACTIONS, INPUTS),
    }
    edges = "affine->output"
    if not kind.startswith("only"):
        edges += ",input->w1,w1->hidden,hidden->w2,w2->readout,readout->affine"
        nodes |= {"w1": linear(rng, HIDDEN, INPUTS), "w2": linear(rng, ACTIONS, HIDDEN)}
        nodes |= {"hidden": spiking(neurons), "readout": li(*decays)}
    if kind == "same":
        edges += ",input->skip,skip->readout"
    elif kind == "two layers":
        edges += ",hidden->w3,w3->more,more->w4,w4->readout"
        nodes |= {"w3": linear(rng, HIDDEN, HIDDEN), "more": spiking(neurons)}
        nodes["w4"] = linear(rng, ACTIONS, HIDDEN)
    elif kind != "none":
        edges += ",input->skip,skip->fast,fast->affine"
        only = {"only LI": li(*[SLOW] * ACTIONS), "only I": integrators(ACTIONS)}
        nodes["fast"] = only.get(kind) or cubali(ACTIONS)
    used = {name for edge in edges.split(",") for name in edge.split("->")}
    nodes = {name: node for name, node in nodes.items() if name in used}
    return Artifact(graph(edges, **nodes), None, Convention(DT, reset, state=state))


def events(batch=3, timesteps=25, seed=1, rate=0.1):
    """(B, T, M) spikes."""
    rng = np.random.default_rng(seed)
    return (rng.random((batch, timesteps, INPUTS)) < rate).astype(np.uint8)
