"""Generated graphs with branches, sums, skips and loops, against a plain reference."""

from functools import cache

import nir
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.order import order
from tests.networks import cuba, ends, lif

TIMESTEPS = 7


def node(kind, rng):
    """A node of two numbers in and out."""
    return {
        "affine": lambda: nir.Affine(rng.normal(size=(2, 2)), rng.normal(size=2)),
        "linear": lambda: nir.Linear(rng.normal(size=(2, 2))),
        "scale": lambda: nir.Scale(rng.normal(size=2)),
        "threshold": lambda: nir.Threshold(rng.normal(size=2)),
        "delay": lambda: nir.Delay(1e-3 * rng.integers(0, 4, 2)),
        "lif": lambda: lif(2, tau=4e-3, r=4.0),
        "cuba": lambda: cuba(2, alpha=0.5, beta=0.75),
        "i": lambda: nir.I(np.full(2, 500.0)),
    }[kind]()


@st.composite
def graphs(draw):
    """A graph from an input to an output: every node has an earlier source, some a later one."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    kinds = draw(
        st.lists(
            st.sampled_from(
                ["affine", "linear", "scale", "threshold", "delay", "lif", "cuba", "i"]
            ),
            min_size=1,
            max_size=7,
        )
    )
    # names in no order
    names = [f"{c}{i}" for i, c in enumerate(draw(st.permutations("abcdefg"))[: len(kinds)])]
    nodes = {name: node(kind, rng) for name, kind in zip(names, kinds, strict=True)}
    line = ["input", *names]
    edges = {(line[draw(st.integers(0, i))], name) for i, name in enumerate(names)}
    for _ in range(draw(st.integers(0, 5))):
        i = draw(st.integers(0, len(names) - 1))
        edges.add((line[draw(st.integers(0, i))], names[i]))
    presynaptic = {source for source, _ in edges}
    edges |= {(name, "output") for name in line if name not in presynaptic}
    spiking = [i for i, kind in enumerate(kinds) if kind in ("lif", "cuba")]
    for back in range(draw(st.integers(0, 2)) if spiking else 0):
        i, j = sorted(draw(st.tuples(*[st.sampled_from(spiking)] * 2)))
        nodes[f"w{back}"] = nir.Linear(rng.normal(size=(2, 2)))
        edges |= {(names[j], f"w{back}"), (f"w{back}", names[i])}
    return nir.NIRGraph(
        {**nodes, **ends(2, 2)}, draw(st.permutations(sorted(edges))), type_check=False
    )


def walked(network, late, x):
    """The output (T, 2) of x (T, 2), by asking every node what it puts out at which timestep."""
    state = {name: np.zeros((2, 2)) for name in network.nodes}

    @cache
    def arrives(name, t):
        if name == "input":
            return x[t]
        edges = sorted(edge for edge in network.edges if edge[1] == name)
        times = [t - 1 if edge in late else t for edge in edges]
        return sum(
            (puts(source, s) for (source, _), s in zip(edges, times, strict=True)), np.zeros(2)
        )

    @cache
    def puts(name, t):
        if t < 0:
            return np.zeros(2)
        this = network.nodes[name]
        if isinstance(this, nir.Delay):
            steps = np.rint(this.delay / 1e-3).astype(int)
            return np.array(
                [arrives(name, t - d)[i] if t >= d else 0.0 for i, d in enumerate(steps)]
            )
        if isinstance(this, (nir.LIF, nir.CubaLIF, nir.I)) and t:
            puts(name, t - 1)
        return computed(this, arrives(name, t), state[name])

    return np.array([puts("output", t) for t in range(TIMESTEPS)])


def computed(this, x, state):
    """One timestep of a node; state holds current and membrane."""
    match this:
        case nir.Affine():
            return this.weight @ x + this.bias
        case nir.Linear():
            return this.weight @ x
        case nir.Scale():
            return this.scale * x
        case nir.Threshold():
            return (x > this.threshold).astype(float)
        case nir.I():
            state[1] += 0.5 * x
            return state[1].copy()
        case nir.LIF():
            state[1] = 0.75 * state[1] + x
        case nir.CubaLIF():
            state[0] = 0.5 * state[0] + x
            state[1] = 0.75 * state[1] + state[0]
        case _:
            return x
    spikes = state[1] > this.v_threshold
    state[1][spikes] = 0
    return spikes.astype(float)


def late_edges(network):
    """Edges that close a loop; those into a Delay are no matter of order but of its own delay."""
    waiting = {
        name
        for name, this in network.nodes.items()
        if isinstance(this, nir.Delay) and (this.delay > 0).all()
    }
    into = {edge for edge in network.edges if edge[1] in waiting}
    return order(network, into).late - into


@settings(max_examples=80)
@given(graphs(), st.integers(0, 1000))
def test_a_generated_graph_equals_the_walk(network, seed):
    x = np.random.default_rng(seed).normal(size=(TIMESTEPS, 2))
    wanted = walked(network, late_edges(network), x)
    found = FloatGraph(Artifact(network, None, Convention(1e-3))).run(x[None])["output"]
    np.testing.assert_allclose(found[0], wanted, rtol=1e-9, atol=1e-9)


@settings(max_examples=24)
@given(graphs(), st.integers(0, 1000), st.sampled_from([0, 1]))
def test_a_generated_graph_in_parts_equals_the_whole(network, seed, delay):
    x = np.random.default_rng(seed).normal(size=(3, TIMESTEPS, 2))
    convention = Convention(1e-3, state="kept", delay=delay)
    whole = FloatGraph(Artifact(network, None, convention)).run(x)["output"]
    running = FloatGraph(Artifact(network, None, convention))
    parts = [running.run(part)["output"] for part in np.split(x, [1, 4], axis=1)]
    np.testing.assert_allclose(np.concatenate(parts, axis=1), whole, rtol=1e-9, atol=1e-9)
