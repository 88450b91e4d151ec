"""Generated graphs on chips: windows, sums, delays, skips, loops, many inputs, readouts.

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
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.running_network import FloatMachine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import concatenate, split
from spikedeploy.runtime.graph.shapes import infer_shapes
from tests.networks import chain, ends, graph, lif

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


def readout(kind, shape):
    """Decays 1/2 and 3/4, a leak of 1/8 a timestep, and gain 1."""
    full = {v: np.full(shape, v) for v in (0.5, 2.0, 2e-3, 4e-3, 4.0, 1000.0)}
    if kind == "I":
        return nir.I(full[1000.0])
    if kind == "LI":
        return nir.LI(full[4e-3], full[4.0], full[0.5])
    return nir.CubaLI(full[2e-3], full[4e-3], full[4.0], full[0.5], w_in=full[2.0])


@st.composite
def ended(draw):
    """A generated network whose Outputs receive readouts, directly or over an Affine."""
    network = draw(networks())
    nodes, edges = dict(network.nodes), set(network.edges)
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    for end in ("output", "more"):
        kind = draw(st.sampled_from(["LI", "CubaLI", "I", "none"]))
        if end not in nodes or kind == "none":
            continue
        (before,) = [source for source, target in edges if target == end]
        shape = tuple(int(n) for n in nodes[end].output_type["output"])
        name = f"read {end}"
        nodes[name] = readout(kind, shape)
        edges = edges - {(before, end)} | {(before, name)}
        of_shape = tuple(int(n) for n in nodes["in"].output_type["output"])
        if of_shape == shape and draw(st.booleans()):
            edges.add(("in", name))
        if len(shape) == 1 and draw(st.booleans()):
            nodes[f"map {end}"] = nir.Affine(eighths(rng, (shape[0],) * 2), eighths(rng, shape))
            edges |= {(name, f"map {end}"), (f"map {end}", end)}
        else:
            edges.add((name, end))
    return nir.NIRGraph(nodes, draw(st.permutations(sorted(edges))), type_check=False)


def compiled(artifact, on, **options):
    """The program, or None where something but readouts is refused."""
    try:
        return compile_program(artifact, on, **options)
    except RuleError as error:
        said = ("begin late", "it receives several layers", "becomes 0", "without neurons between")
        assert any(each in str(error) for each in said)  # noqa: PT017
        return None


@settings(max_examples=32)
@given(ended(), st.integers(0, 1000), st.sampled_from([0, 1]), st.booleans(), st.booleans())
def test_generated_networks_equal_the_float_graph_on_chip_and_host(
    network, seed, delay, kept, on_host
):
    convention = Convention(1e-3, delay=delay, state="kept" if kept else "reset")
    artifact = Artifact(network, None, convention)
    on = chip("ideal", membrane_output="none" if on_host else "software")
    if (program := compiled(artifact, on)) is None:
        return
    reads = any(name.startswith("read ") for name in network.nodes)
    assert bool(program.host) == (on_host and reads)
    twin, rng = FloatGraph(artifact), np.random.default_rng(seed)
    machines = [Machine(program, 2, trace=True, backend=name) for name in ("numpy", "interpreter")]
    for _ in range(2):
        raster = (rng.random((2, TIMESTEPS, program.width)) < 0.4).astype(np.uint8)
        expected = twin.run(split(program.inputs, raster))
        for machine in machines:
            for name, found in split(program.outputs, machine.infer(raster)).items():
                wanted = expected["output" if len(program.outputs) == 1 else name]
                np.testing.assert_array_equal(found, wanted)
            for name, found in machine.recordings.items():
                if name in expected:
                    flat = expected[name].reshape(found.spikes.shape)
                    np.testing.assert_array_equal(found.spikes, flat)


@settings(max_examples=8)
@given(ended(), st.integers(0, 1000), st.sampled_from(["loihi1", "loihi1-nengo"]))
def test_generated_networks_on_loihi_equal_the_interpreter(network, seed, name):
    artifact = Artifact(network, None, Convention(1e-3))
    program = compiled(artifact, chip(name), clock="pipelined", limits=False)
    if program is None:
        return
    raster = np.random.default_rng(seed).random((2, TIMESTEPS, program.width)) < 0.4
    raster = raster.astype(np.uint8)
    expected = trace(program, raster)
    slow = Machine(program, 2, backend="interpreter")
    output = slow.infer(raster)
    for backend in ("numpy", "auto"):
        machine = Machine(program, 2, trace=True, backend=backend)
        np.testing.assert_array_equal(machine.infer(raster), output)
        for layer, found in machine.recordings.items():
            np.testing.assert_array_equal(found.membrane, expected[layer].membrane)
            np.testing.assert_array_equal(found.spikes, expected[layer].spikes)
        np.testing.assert_array_equal(machine.ledger.counts, slow.ledger.counts)


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


def test_maps_in_a_row_beyond_the_limit_of_their_matrix_are_refused_before_it_is_made():
    wide = nir.Conv2d(None, np.ones((8, 1, 3, 3)), 1, 1, 1, 1, np.zeros(8))
    shape = (8, 128, 128)
    cells = nir.IF(*(np.full(shape, v) for v in (1000.0, 1.0, 0.0)))
    ports = ends([1, 128, 128], shape)
    network = graph("input->c, c->l, l->output", **ports, c=wide, l=cells)
    compile_program(artifact(network), chip("ideal"))
    scale = nir.Scale(np.full(shape, 2.0))
    second = nir.Conv2d(None, np.ones((8, 1, 1, 1)), 1, 0, 1, 8, np.zeros(8))
    edges = "input->c, c->s, s->d, d->l, l->output"
    network = graph(edges, **ports, c=wide, s=scale, d=second, l=cells)
    with pytest.raises(RuleError, match=r"rule matrix: node .l.: .* between .*put neurons there"):
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


@pytest.mark.parametrize("kind", ["LI", "CubaLI", "I"])
def test_a_readout_of_several_dimensions_keeps_the_shape_of_its_output(kind):
    shape = (1, 4, 4)
    kernel = nir.Conv2d((4, 4), np.ones((1, 1, 3, 3)), 1, 1, 1, 1, np.zeros(1))
    nodes = {"input": nir.Input(np.array(shape)), "k": kernel, "r": readout(kind, shape)}
    nodes["output"] = nir.Output(np.array(shape))
    network = nir.NIRGraph(nodes, [("input", "k"), ("k", "r"), ("r", "output")], type_check=False)
    artifact = Artifact(network, None, Convention(1e-3))
    raster = np.random.default_rng(0).random((2, 5, 16)) < 0.3
    program = compile_program(artifact, chip("ideal"))
    found = Machine(program, 2).infer(raster.astype(np.uint8))
    wanted = FloatMachine(artifact).infer({"input": raster.reshape(2, 5, *shape).astype(np.uint8)})
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
