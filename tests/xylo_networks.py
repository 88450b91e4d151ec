"""Random graphs of the forms that Xylo can hold, and of some that it has to bend."""

from itertools import pairwise

import nir
import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from tests.networks import lif


def neurons(rng, size, kind):
    """CuBa-LIF or LIF neurons, each with time constants of its own at dt = 1 ms."""
    tau_mem = 1e-3 * 2 ** rng.uniform(0, 6, size)
    leak = rng.normal(size=size) * (kind == "leaking")
    if kind == "lif":
        return lif(size, 8e-3, 8.0, threshold=1.2)
    tau_syn = 1e-3 * 2 ** rng.uniform(0, 5, size)
    # what a few spikes add up to
    threshold = rng.uniform(0.5, 3, size) * tau_syn / 1e-3
    gains = {"r": tau_mem / 1e-3, "w_in": tau_syn / 1e-3}
    return nir.CubaLIF(
        tau_syn=tau_syn, tau_mem=tau_mem, v_leak=leak, v_threshold=threshold, **gains
    )


def network(rng, sizes, kinds, *, loops=(), biased=False, skip=False, delay=0):
    """A chain l1, l2 … where `loops` are recurrent, and skips go back and forth."""
    nodes = {"input": nir.Input(np.array(sizes[:1])), "output": nir.Output(np.array(sizes[-1:]))}
    edges, before = [], "input"

    def join(name, source, target, fan_in, size, gain=1.0):
        weight = gain * (rng.normal(size=(size, fan_in)) + 0.3) / fan_in**0.5
        bias = 0.05 * rng.normal(size=size) * biased
        nodes[name] = nir.Affine(weight, bias)
        edges.extend([(source, name), (name, target)])

    for k, (fan_in, size) in enumerate(pairwise(sizes), start=1):
        here = f"l{k}"
        nodes[here] = neurons(rng, size, kinds[k - 1])
        join(f"w{k}", before, here, fan_in, size)
        if k in loops:
            join(f"r{k}", here, here, size, size, gain=0.5)
        if skip and 1 < k < len(sizes) - 1:
            join(f"s{k}", "input", here, sizes[0], size)
            join(f"b{k}", here, "l1", size, sizes[1], gain=0.5)
        before = here
    edges.append((before, "output"))
    convention = Convention(1e-3, reset="subtract", spikes="many", delay=delay)
    return Artifact(nir.NIRGraph(nodes, edges), None, convention)


@st.composite
def random_networks(draw):
    """A graph for Xylo, of which no layer's weights, and no threshold, become 0."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sizes = draw(st.lists(st.sampled_from([1, 2, 5, 12]), min_size=3, max_size=5))
    hidden = len(sizes) - 2
    kinds = draw(st.tuples(*[st.sampled_from(["cuba", "leaking", "lif"])] * (hidden + 1)))
    found = network(
        rng,
        sizes,
        kinds,
        loops=draw(st.sets(st.integers(1, hidden))),
        biased=draw(st.booleans()),
        skip=draw(st.booleans()),
        delay=draw(st.sampled_from([0, 0, 1])),
    )
    try:
        compile_program(found, chip("xylo-a2"), limits=False)
    except RuleError:
        reject()
    return found


@st.composite
def random_cores(draw):
    """A program of raw registers: two currents, aliases, and sums that saturate everywhere."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    width, size, outputs = (draw(st.sampled_from([1, 3, 8])) for _ in range(3))
    shift = draw(st.sampled_from([0, 4, 8]))
    bias = draw(st.sampled_from([0, 100, 32767]))
    threshold = draw(st.sampled_from([50, 5000, 32767]))

    def synapses(source, fan_in, fan_out, delay, currents):
        shape = (currents, fan_in, fan_out)
        weight = rng.integers(-128, 128, shape) * (rng.random(shape) < 0.7) << shift
        return [Synapses(source, weight[k], delay, current=k) for k in range(currents)]

    def population(name, wires, n, currents):
        return Layer(
            name=name,
            synapses=tuple(wires),
            bias=np.zeros(n, np.int64),
            voltage_bias=rng.integers(-bias, bias + 1, n),
            threshold=rng.integers(1, threshold + 1, n),
            current_decay=rng.integers(0, 16, (currents, n)),
            membrane_decay=rng.integers(0, 16, n),
            scale=1.0,
            start=0,
            aliases=_aliases(rng, n) if name == "hidden" and draw(st.booleans()) else (),
        )

    wires = synapses("input", width, size, 0, 2) + synapses("hidden", size, size, 1, 2)
    hidden = population("hidden", wires, size, 2)
    output = population("output", synapses("hidden", size, outputs, 1, 1), outputs, 1)
    convention = Convention(1e-3, reset="subtract", spikes="many")
    layers = (hidden, output)
    return Program(chip("xylo-a2"), convention, "input", width, layers, "output", None), shift


def _aliases(rng, size):
    linked = rng.random((size, size)) < 0.3
    return tuple(tuple(int(m) for m in range(size) if linked[n, m] and m != n) for n in range(size))
