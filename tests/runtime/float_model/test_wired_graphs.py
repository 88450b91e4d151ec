"""Generated graphs on the ideal chip: windows, sums, delays, skips, loops, many inputs.

Weights and decays are small fractions of powers of 2, so that every sum is exact in any order.
"""

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import count, trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import concatenate, split
from spikedeploy.runtime.graph.shapes import infer_shapes
from tests.networks import chain, graph, lif

TIMESTEPS = 8
KINDS = ("conv", "grouped", "sum", "avg", "scale", "delay", "affine", "conv1d", "flatten")


def eighths(rng, shape):
    return rng.integers(-8, 9, shape) / 8


def neurons(kind, shape):
    """Spiking nodes of decays 1/2 and 3/4, and gain 1."""
    full = {v: np.full(shape, v) for v in (0.0, 0.5, 1.0, 2.0, 2e-3, 4e-3, 4.0, 1000.0)}
    if kind == "if":
        return nir.IF(full[1000.0], full[1.0], full[0.0])
    if kind == "lif":
        return nir.LIF(full[4e-3], full[4.0], full[0.0], full[0.5], full[0.0])
    return nir.CubaLIF(
        full[2e-3], full[4e-3], full[4.0], full[0.0], full[1.0], full[0.0], w_in=full[2.0]
    )


def linear(kind, shape, rng):
    """A node without spikes that takes this shape, or None where there is none."""
    if kind == "scale":
        return nir.Scale(eighths(rng, shape))
    if kind == "delay":
        return nir.Delay(1e-3 * rng.integers(rng.integers(0, 2), 4, shape))
    if kind == "affine":
        weight = eighths(rng, (*shape[:-1], 3, shape[-1]))
        return nir.Affine(weight, eighths(rng, weight.shape[:-1]))
    if kind == "flatten":
        return nir.Flatten({"input": np.array(shape)}, 0, -1)
    if len(shape) == 2 and kind == "conv1d":
        return nir.Conv1d(None, eighths(rng, (2, shape[0], 2)), 1, 1, 1, 1, eighths(rng, 2))
    if len(shape) != 3:
        return None
    if kind == "conv":
        weight = eighths(rng, (2, shape[0], 3, 3))
        stride = int(rng.integers(1, 3))
        return nir.Conv2d(None, weight, stride, 1, 1, 1, eighths(rng, 2))
    if kind == "grouped":
        weight = eighths(rng, (2 * shape[0], 1, 1, 2))
        return nir.Conv2d(None, weight, 1, "same", 1, shape[0], eighths(rng, 2 * shape[0]))
    if kind in ("sum", "avg") and min(shape[1:]) > 1:
        make = nir.SumPool2d if kind == "sum" else nir.AvgPool2d
        two = np.array([2, 2])
        return make(two, two, np.array([0, 0]))
    return None


def puts(nodes, edges, name):
    """The shape that the last node puts out."""
    ends = {"end": nir.Output(None)}
    sketch = nir.NIRGraph({**nodes, **ends}, [*edges, (name, "end")], type_check=False)
    infer_shapes(sketch)
    return tuple(int(n) for n in nodes[name].output_type["output"])


@st.composite
def networks(draw):
    """A chain from one or two Inputs, with skips, loops, delays, and one or two Outputs."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    shape = draw(st.sampled_from([(1, 4, 4), (2, 5, 3), (2, 4), (3,)]))
    nodes, edges, shapes = {"in": nir.Input(np.array(shape))}, set(), {"in": shape}
    if draw(st.booleans()):
        nodes["also"], shapes["also"] = nir.Input(np.array(shape)), shape
    last, spiking = "in", []
    kinds = draw(st.lists(st.sampled_from([*KINDS, "if", "lif", "cuba"]), min_size=1, max_size=6))
    for i, kind in enumerate([*kinds, "lif"]):
        name, takes = f"{'zyxwvuts'[i]}{i}", shapes[last]
        spikes = kind in ("if", "lif", "cuba")
        node = neurons(kind, takes) if spikes else linear(kind, takes, rng)
        if node is None:
            continue
        equal = [other for other, puts_out in shapes.items() if puts_out == takes and other != last]
        extra = draw(st.sets(st.sampled_from(equal), max_size=2)) if equal else set()
        if "also" in nodes and not any(s == "also" for s, _ in edges) and takes == shape:
            extra.add("also")
        nodes[name] = node
        edges |= {(source, name) for source in {last, *extra}}
        shapes[name] = puts(nodes, sorted(edges), name)
        last, spiking = name, [*spiking, *([name] if spikes else [])]
    first = draw(st.sampled_from(spiking))
    if shapes[first] == shapes[last] and draw(st.booleans()):
        nodes["back"] = draw(
            st.sampled_from(
                [nir.Scale(eighths(rng, shapes[first])), nir.Delay(np.full(shapes[first], 2e-3))]
            )
        )
        edges |= {(last, "back"), ("back", first)}
    nodes["output"] = nir.Output(np.array(shapes[last]))
    edges.add((last, "output"))
    if draw(st.booleans()):
        nodes["flat"] = nir.Flatten({"input": np.array(shapes[first])}, 0, -1)
        nodes["more"] = nir.Output(np.array([int(np.prod(shapes[first]))]))
        edges |= {(first, "flat"), ("flat", "more")}
    return nir.NIRGraph(nodes, draw(st.permutations(sorted(edges))), type_check=False)


@settings(max_examples=150, deadline=None)
@given(networks(), st.integers(0, 1000), st.sampled_from([0, 1]), st.booleans())
def test_a_generated_network_on_the_ideal_chip_equals_the_float_graph(network, seed, delay, kept):
    convention = Convention(1e-3, delay=delay, state="kept" if kept else "reset")
    artifact = Artifact(network, None, convention)
    try:
        program = compile_program(artifact, chip("ideal"))
    except RuleError as error:
        # a bias before a delay, and several layers read late while states are kept
        assert "begin late" in str(error) or "it receives several layers" in str(error)  # noqa: PT017
        return
    twin, machine = FloatGraph(artifact), Machine(program, 2, trace=True)
    rng = np.random.default_rng(seed)
    for inference in range(2):
        raster = (rng.random((2, TIMESTEPS, program.width)) < 0.4).astype(np.uint8)
        expected = twin.run(split(program.inputs, raster))
        output = machine.infer(raster)
        for name, found in machine.recordings.items():
            flat = expected[name].reshape(found.spikes.shape)
            np.testing.assert_array_equal(found.spikes, flat)
            if inference == 0:
                np.testing.assert_array_equal(trace(program, raster)[name].spikes, flat)
        for name, found in split(program.outputs, output).items():
            wanted = expected["output" if len(program.outputs) == 1 else name]
            np.testing.assert_array_equal(found, wanted)


@settings(max_examples=60, deadline=None)
@given(networks(), st.integers(0, 1000), st.sampled_from(["loihi1", "loihi1-nengo"]))
def test_a_generated_network_on_a_chip_equals_the_interpreter(network, seed, name):
    try:
        asked = Artifact(network, None, Convention(1e-3))
        program = compile_program(asked, chip(name), clock="pipelined", limits=False)
    except RuleError as error:
        # weights may vanish beside a threshold, which is no matter of wiring
        assert "begin late" in str(error) or "layer" in str(error)  # noqa: PT017
        return
    rng = np.random.default_rng(seed)
    raster = (rng.random((2, TIMESTEPS, program.width)) < 0.4).astype(np.uint8)
    expected = trace(program, raster)
    # compiled where Numba is installed and knows the chip's registers
    for backend in ("numpy", "auto"):
        machine = Machine(program, 2, trace=True, backend=backend)
        machine.infer(raster)
        for layer, found in machine.recordings.items():
            np.testing.assert_array_equal(found.membrane, expected[layer].membrane)
            np.testing.assert_array_equal(found.spikes, expected[layer].spikes)
        counted = count(
            program,
            {program.input: raster, **{layer: t.spikes for layer, t in expected.items()}},
            expected,
        )
        np.testing.assert_array_equal(machine.ledger.counts, counted)


def ends(shape, act):
    return {"input": nir.Input(np.array(shape)), "output": nir.Output(np.array(act))}


def artifact(network):
    return Artifact(network, None, Convention(1e-3))


def test_a_convolution_and_a_pool_become_one_matrix():
    # x convolved with (1, 10), then sums of pairs: each sums three inputs by (1, 11, 10)
    conv = nir.Conv2d(None, np.array([[[[1.0, 10.0]]]]), 1, 0, 1, 1, np.array([0.5]))
    pool = nir.SumPool2d(np.array([1, 2]), np.array([1, 2]), np.array([0, 0]))
    flat = nir.Flatten({"input": np.array([1, 1, 2])}, 0, -1)
    nodes = {"c": conv, "p": pool, "f": flat, "l": lif(2, 4e-3, 4.0), **ends([1, 1, 5], [2])}
    edges = [("input", "c"), ("c", "p"), ("p", "f"), ("f", "l"), ("l", "output")]
    network = nir.NIRGraph(nodes, edges, type_check=False)
    (layer,) = compile_program(artifact(network), chip("ideal")).layers
    wanted = [[1, 0], [11, 0], [10, 1], [0, 11], [0, 10]]
    np.testing.assert_array_equal(layer.synapses[0].weight, wanted)
    assert layer.bias.tolist() == [1.0, 1.0]


def test_a_delay_becomes_the_delay_of_its_synapses():
    network = chain(nir.Delay(np.array([0.0, 3e-3])), lif(2, 4e-3, 4.0), width=2, act=2)
    program = compile_program(artifact(network), chip("loihi1"))
    (layer,) = program.layers
    # loihi1 takes one timestep for any synapse, which the layer's start makes up for
    assert layer.start == 1
    assert [(s.delay, s.fan_out.tolist()) for s in layer.synapses] == [(1, [1, 0]), (4, [0, 1])]


def test_a_delay_longer_than_the_chip_has_is_refused():
    network = chain(nir.Delay(np.full(2, 0.1)), lif(2, 4e-3, 4.0), width=2, act=2)
    with pytest.raises(
        RuleError, match="rule delay: node 'n1' has 100 timesteps; loihi1 has at most 63"
    ):
        compile_program(artifact(network), chip("loihi1"))


def test_a_bias_before_a_delay_is_refused():
    bias = nir.Affine(np.eye(2), np.ones(2))
    nodes = (bias, nir.Delay(np.full(2, 1e-3)), lif(2, 4e-3, 4.0))
    with pytest.raises(RuleError, match="node 'n3': a bias reaches it through a delay of 1"):
        compile_program(artifact(chain(*nodes, width=2, act=2)), chip("ideal"))


def test_a_loop_without_neurons_is_refused_on_a_chip():
    edges = "input->a, a->d, d->a, a->l, l->output"
    nodes = {"a": nir.Linear(np.eye(2)), "d": nir.Delay(np.full(2, 1e-3)), "l": lif(2)}
    with pytest.raises(RuleError, match="nodes a, d: a loop without a spiking node"):
        compile_program(artifact(graph(edges, **ends([2], [2]), **nodes)), chip("ideal"))


def test_matrices_beyond_the_limit_are_refused_before_they_are_made():
    wide = nir.Conv2d(None, np.ones((8, 1, 3, 3)), 1, 1, 1, 1, np.zeros(8))
    shape = (8, 128, 128)
    cells = nir.IF(*(np.full(shape, v) for v in (1000.0, 1.0, 0.0)))
    network = graph("input->c, c->l, l->output", **ends([1, 128, 128], shape), c=wide, l=cells)
    with pytest.raises(RuleError, match=r"node 'l': as one matrix .* 17179869184 bytes by here"):
        compile_program(artifact(network), chip("ideal"))


def test_inputs_lie_side_by_side_in_the_order_of_their_names():
    edges = "b->lb, a->la, la->lif, lb->lif, lif->output"
    nodes = {"a": nir.Input(np.array([2])), "b": nir.Input(np.array([1, 2]))}
    weights = {"la": nir.Linear(np.array([[1.0, 2.0]])), "lb": nir.Linear(np.array([[[3.0, 4.0]]]))}
    flat = nir.Flatten({"input": np.array([1, 1])}, 0, -1)
    network = graph(
        edges.replace("lb->lif", "lb->f, f->lif"),
        output=nir.Output(np.array([1])), lif=lif(1, 4e-3, 4.0), f=flat, **nodes, **weights,
    )  # fmt: skip
    program = compile_program(artifact(network), chip("ideal"))
    assert program.input == "a, b"
    assert program.layers[0].synapses[0].weight.ravel().tolist() == [1, 2, 3, 4]
    rasters = {"b": np.array([[[[0, 1]]]]), "a": np.array([[[1, 0]]])}
    assert concatenate(program.inputs, rasters).tolist() == [[[1, 0, 0, 1]]]


def test_an_output_may_read_several_layers():
    edges = "input->a, a->b, a->twice, twice->output, b->output"
    nodes = {
        "a": lif(1, 4e-3, 4.0, 0.5),
        "b": lif(1, 4e-3, 4.0, 0.5),
        "twice": nir.Scale(2 * np.ones(1)),
    }
    program = compile_program(artifact(graph(edges, **ends([1], [1]), **nodes)), chip("ideal"))
    machine = Machine(program, trace=True)
    # both spike at once: 2 of a and 1 of b
    assert machine.infer(np.array([[[1], [0]]], np.uint8)).ravel().tolist() == [3, 0]
    assert program.to_host == {"a", "b"}
    # what a alone goes through; b comes as it is
    assert [(of, weight.tolist()) for of, weight in program.readouts] == [("a", [[2.0]])]
    assert machine.ledger.by_layer("message") == {"a": 2, "b": 2}
