"""Small networks that several tests build; `popsan` has the layout that the exporter writes."""

from dataclasses import replace
from itertools import pairwise

import nir
import numpy as np

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.codec.codec import Codec, DeltaEncoder, Normaliser, PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.metadata import Provenance

ORIGIN = Provenance(
    "spikedeploy/Hexapod-v0", "smoke", seed=3, steps=7, created="2026-01-01T00:00:00Z"
)


def cuba(size, alpha=0.9, beta=0.8, dt=1e-3, threshold=0.5, dtype=np.float64):
    """CuBa-LIF neurons whose gains are 1 at dt."""
    tau_syn, tau_mem = dt / (1 - alpha), dt / (1 - beta)
    values = (tau_syn, tau_mem, tau_mem / dt, 0.0, threshold)
    full = [np.full(size, value, dtype) for value in values]
    w_in = np.full(size, tau_syn / dt, dtype)
    return nir.CubaLIF(*full, v_reset=np.zeros(size, dtype), w_in=w_in)


def lif(size, tau=0.01, r=10.0, threshold=1.0, v_leak=0.0):
    return nir.LIF(*(np.full(size, float(v)) for v in (tau, r, v_leak, threshold)))


def ends(takes=2, puts=2):
    """The Input and the Output of these shapes."""
    shapes = np.atleast_1d(takes), np.atleast_1d(puts)
    return {"input": nir.Input(shapes[0]), "output": nir.Output(shapes[1])}


def alone(node, takes, puts):
    """input -> n -> output, without nir's own checks, which refuse what it infers wrongly."""
    edges = [("input", "n"), ("n", "output")]
    return nir.NIRGraph({**ends(takes, puts), "n": node}, edges, type_check=False)


def graph(edges, **nodes):
    """A graph from "a->b, b->c" and its nodes."""
    pairs = [tuple(edge.strip().split("->")) for edge in edges.split(",")]
    return nir.NIRGraph(nodes, pairs)


def chain(*nodes, width, act):
    """input -> n1 -> n2 ... -> output."""
    named = {f"n{i}": node for i, node in enumerate(nodes, start=1)}
    names = ["input", *named, "output"]
    return nir.NIRGraph({**ends(width, act), **named}, list(pairwise(names)))


def codec(obs, populations=10, timesteps=5, squash="tanh"):
    rng = np.random.default_rng(obs)
    centres = np.tile(np.linspace(-3, 3, populations), (obs, 1))
    widths = np.full((obs, populations), 0.15**0.5)
    normaliser = Normaliser(rng.normal(size=obs), rng.uniform(0.5, 2, obs), 5.0)
    return Codec(normaliser, PopulationEncoder(centres, widths), timesteps, squash)


def crowd(axons=600, threshold=100.0, size=1):
    """Neurons that so many axons drive with the largest weight, which one timestep overflows."""
    neurons = cuba(size, alpha=0.0, beta=0.75, threshold=threshold)
    network = chain(nir.Linear(np.ones((size, axons))), neurons, width=axons, act=size)
    return Artifact(network, None, Convention(1e-3))


def popsan(obs=3, act=2, hidden=(16, 12), populations=10, seed=0, dt=1e-3):
    """A spiking policy with random weights."""
    rng = np.random.default_rng(seed)
    sizes = [obs * populations, *hidden, act * populations]
    nodes = []
    for fan_in, size in pairwise(sizes):
        weight = 2 * rng.normal(size=(size, fan_in)) / fan_in**0.5
        nodes += [nir.Affine(weight, 0.1 * rng.normal(size=size)), cuba(size, dt=dt)]
    readout = np.kron(np.eye(act), rng.normal(size=(1, populations)))
    nodes.append(nir.Affine(readout, rng.normal(size=act)))
    network = chain(*nodes, width=sizes[0], act=act)
    return Artifact(network, codec(obs, populations), Convention(dt), ORIGIN)


def spiking_mlp(obs=6, act=4, hidden=(32, 24), timesteps=16, beta=0.9, squash="argmax", seed=0):
    """A spiking multilayer perceptron of LIF neurons on a rate code, with random weights."""
    rng = np.random.default_rng(seed)
    dt, tau = 1e-3, 1e-3 / (1 - beta)
    nodes = []
    for fan_in, size in pairwise((obs, *hidden)):
        weight = 2 * rng.normal(size=(size, fan_in)) / fan_in**0.5
        neurons = lif(size, tau, tau / dt, threshold=0.7)
        neurons.v_reset = np.zeros(size)
        nodes += [nir.Affine(weight, 0.1 * rng.normal(size=size)), neurons]
    nodes.append(nir.Affine(rng.normal(size=(act, hidden[-1])), 0.1 * rng.normal(size=act)))
    network = chain(*nodes, width=obs, act=act)
    code = RateEncoder(np.full(obs, -1.0), np.ones(obs))
    identity = Normaliser(np.zeros(obs), np.ones(obs), 1.0)
    return Artifact(network, Codec(identity, code, timesteps, squash), Convention(dt), ORIGIN)


def event_driven(obs=3, act=2, hidden=8, code="unary", timesteps=1, seed=0, dt=1e-3):
    """A layer of CuBa-LIF neurons on a delta code, states kept, with random weights."""
    rng = np.random.default_rng(seed)
    encoder = DeltaEncoder(np.append(np.full(obs - 1, 0.2), np.inf), most=2, code=code)
    neurons = cuba(hidden, alpha=4095 / 4096, beta=0.6, dt=dt, threshold=1.0)
    nodes = [
        nir.Affine(0.3 * rng.normal(size=(hidden, encoder.width)), np.full(hidden, 1e-4)),
        neurons,
        nir.Affine(rng.normal(size=(act, hidden)), 0.1 * rng.normal(size=act)),
    ]
    normaliser = Normaliser(rng.normal(size=obs), rng.uniform(0.5, 2, obs), 5.0)
    network = chain(*nodes, width=encoder.width, act=act)
    convention = Convention(dt).with_options({"state": "kept"})
    return Artifact(network, Codec(normaliser, encoder, timesteps), convention, ORIGIN)


def with_last(artifact, timesteps=3):
    """The policy with several timesteps in a control step, and its action that of the last."""
    return replace(artifact, codec=replace(artifact.codec, timesteps=timesteps, score="last"))


def unit_lif(*shape, tau=4e-3, gain=4.0):
    """Neurons of any shape with a gain of 1 at dt = 1 ms."""
    return nir.LIF(*(np.full(shape, v) for v in (tau, gain, 0.0, 1.0, 0.0)))


def named_chain(takes, puts, **nodes):
    """Input of a shape -> nodes by their names -> output, which nir does not check."""
    names = ["input", *nodes, "output"]
    return nir.NIRGraph({**ends(takes, puts), **nodes}, list(pairwise(names)), type_check=False)
