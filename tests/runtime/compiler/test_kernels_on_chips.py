"""Convolutions as kernels against the matrices that impulses find, on every chip, bit for bit."""

import math
import tracemalloc
from itertools import pairwise
from unittest import mock

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.chips.layer import LayerState
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler import synapses
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.graph import shapes
from tests.networks import ends

DT = 1e-3
# chips whose neurons always leak
LEAKY = ("spiker", "xylo-a2", "xylo-a3", "xylo-imu")


def neurons(name, shape):
    """Neurons that the chip has, with a threshold that a few weights reach."""
    zero, gain, threshold = (np.full(shape, float(v)) for v in (0, 8, 0.7))
    if name in LEAKY:
        return nir.LIF(np.full(shape, 8e-3), gain, zero, threshold, zero)
    return nir.IF(np.full(shape, 1000.0), threshold, zero)


def pool(kind, size, stride=None, padding=(0, 0)):
    return kind(np.array(size), np.array(stride or size), np.array(padding))


def puts(node, shape):
    """Shape that a convolution or pool puts out."""
    window = shapes.window_of("", node)
    features = len(node.weight) if hasattr(node, "weight") else shape[0]
    return features, *window.positions(shape[1:])


@st.composite
def maps(draw, shape):
    """One map of what has this shape, and scales and a pool before or behind it."""
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    axes, found = len(shape) - 1, []
    small = min(shape[1:])
    if axes == 2 and small >= 4 and draw(st.booleans()):
        kind = draw(st.sampled_from([nir.SumPool2d, nir.AvgPool2d]))
        found.append(pool(kind, draw(st.sampled_from([(2, 2), (2, 1)]))))
        shape = puts(found[-1], shape)
    if draw(st.booleans()):
        scale = rng.choice([0.5, 1.25], shape[0]).reshape(-1, *(1 for _ in shape[1:]))
        found.append(nir.Scale(np.broadcast_to(scale, shape).copy()))
    kernel = [draw(st.integers(1, min(3, extent))) for extent in shape[1:]]
    groups = draw(st.sampled_from([1, shape[0]]))
    weight = rng.normal(size=(groups * draw(st.integers(1, 3)), shape[0] // groups, *kernel))
    stride = [draw(st.integers(1, 2)) for _ in kernel]
    padding = [draw(st.integers(0, 2)) for _ in kernel]
    dilation = [1 if extent < 5 else draw(st.integers(1, 2)) for extent in shape[1:]]
    bias = rng.normal(size=len(weight)) / 8 * draw(st.sampled_from([0, 1]))
    if axes == 1:
        (s,), (p,), (d,) = stride, padding, dilation
        node = nir.Conv1d(shape[1], weight, s, p, d, groups, bias)
    else:
        node = nir.Conv2d(
            shape[1:], weight, tuple(stride), tuple(padding), tuple(dilation), groups, bias
        )
    return [*found, node], puts(node, shape)


@st.composite
def layers(draw):
    """Shape of the input, then of each layer of neurons the maps before it and its shape."""
    shape = draw(st.sampled_from([(2, 8, 7), (1, 6, 6), (4, 9), (3, 5, 8)]))
    found, start = [], shape
    for _ in range(draw(st.integers(1, 2))):
        nodes, shape = draw(maps(shape))
        found.append((nodes, shape))
    if len(shape) == 3 and min(shape[1:]) >= 2 and draw(st.booleans()):
        nodes = [pool(nir.SumPool2d, (2, 2), (1, 1))] if draw(st.booleans()) else []
        nodes = nodes or [pool(nir.SumPool2d, (2, 2))]
        shape = puts(nodes[0], shape)
        found.append((nodes, shape))
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    before = []
    if len(shape) == 3 and min(shape[1:]) >= 2 and draw(st.booleans()):
        before = [pool(nir.AvgPool2d, (2, 2))]
        shape = puts(before[0], shape)
    flat = nir.Flatten({"input": np.array(shape)}, 0, -1)
    last = nir.Affine(rng.normal(size=(5, math.prod(shape))), np.zeros(5))
    return start, [*found, ([*before, flat, last], (5,))]


def network(name, start, found):
    """Input of a shape, then maps and the neurons of a shape behind them, and so on."""
    nodes = [node for maps, shape in found for node in (*maps, neurons(name, shape))]
    named = {f"n{k}": node for k, node in enumerate(nodes)}
    edges = list(pairwise(["input", *named, "output"]))
    graph = nir.NIRGraph({**ends(start, found[-1][1]), **named}, edges, type_check=False)
    reset = "subtract" if "subtract" in chip(name).resets else chip(name).resets[0]
    return Artifact(graph, None, Convention(DT, reset))


def by_impulses(artifact, on, **options):
    with mock.patch.object(synapses, "weights_of", return_value=None):
        return compile_program(artifact, on, **options)


@pytest.mark.parametrize("name", CHIPS)
@settings(max_examples=6)
@given(layers(), st.integers(0, 99), st.sampled_from([0.05, 0.5]))
def test_kernels_equal_the_matrices_that_impulses_find(name, drawn, seed, density):
    start, found = drawn
    artifact, on = network(name, start, found), chip(name)
    try:
        wanted = by_impulses(artifact, on, limits=False)
    except RuleError:  # of the chip, whichever way
        with pytest.raises(RuleError):
            compile_program(artifact, on, limits=False)
        return
    program = compile_program(artifact, on, limits=False)
    if not name.startswith("xylo"):
        assert program.layers[0].synapses[0].window is not None
    for ours, theirs in zip(program.dense().layers, wanted.layers, strict=True):
        for field in ("bias", "voltage_bias", "threshold", "current_decay", "membrane_decay"):
            np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
        np.testing.assert_array_equal(ours.scale, theirs.scale)
        for one, other in zip(ours.synapses, theirs.synapses, strict=True):
            np.testing.assert_array_equal(one.weight, other.weight)
            assert one.weight.dtype == other.weight.dtype
            assert one.delay == other.delay
    for one, other in zip(program.layers, wanted.layers, strict=True):
        for ours, theirs in zip(one.synapses, other.synapses, strict=True):
            np.testing.assert_array_equal(ours.fan_out, theirs.fan_out)
    raster = (np.random.default_rng(seed).random((2, 4, math.prod(start))) < density).astype(
        np.uint8
    )
    for backend in ("interpreter", "numpy"):
        machines = [Machine(each, 2, "each", True, backend) for each in (program, wanted)]
        for machine in machines:
            machine.infer(raster)
        for layer in program.layers:
            ours, theirs = (machine.recordings[layer.name] for machine in machines)
            np.testing.assert_array_equal(ours.spikes, theirs.spikes)
            if on.arithmetic.is_rounded:
                np.testing.assert_array_equal(ours.membrane, theirs.membrane)
            else:
                np.testing.assert_allclose(ours.membrane, theirs.membrane, atol=1e-12)
        np.testing.assert_array_equal(*(machine.ledger.counts for machine in machines))


def gesture(name, size=128):
    """Convolutions of 8, 16 and, behind a pool, 16 maps, and 11 neurons behind another."""
    return deep(name, size, [(8, 2, None), (16, 1, None), (16, 1, 2)], 4)


def for_speck(name, size=128):
    """Four convolutions, the later three behind pools, and 11 neurons: five cores of Speck."""
    return deep(name, size, [(8, 2, None), (16, 1, 2), (16, 1, 2), (16, 1, 2)], None)


def deep(name, size, convolutions, pooled):
    """Convolutions by 3 x 3 of two maps: features, stride, pool before; a linear map behind one."""
    rng, found, shape = np.random.default_rng(0), [], (2, size, size)
    for features, stride, before in convolutions:
        maps = [pool(nir.SumPool2d, (before, before))] if before else []
        shape = puts(maps[0], shape) if maps else shape
        weight = rng.normal(size=(features, shape[0], 3, 3))
        maps.append(nir.Conv2d(shape[1:], weight, stride, 1, 1, 1, np.zeros(features)))
        shape = puts(maps[-1], shape)
        found.append((maps, shape))
    last = [pool(nir.SumPool2d, (pooled, pooled))] if pooled else []
    shape = puts(last[0], shape) if last else shape
    flat = nir.Flatten({"input": np.array(shape)}, 0, -1)
    linear = nir.Linear(rng.normal(size=(11, math.prod(shape))))
    return network(name, (2, size, size), [*found, ([*last, flat, linear], (11,))])


@pytest.mark.parametrize(("name", "make"), [("speck2f", for_speck), ("int", gesture)])
def test_a_network_of_128_by_128_takes_no_more_than_four_times_its_weights_and_states(make, name):
    artifact, on = make(name), chip(name)
    tracemalloc.start()
    program = compile_program(artifact, on)
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 300e6
    states = [vars(LayerState.zero(layer, 1)).values() for layer in program.layers]
    own = sum(values.nbytes for state in states for values in state)
    own += sum(s.weight.nbytes for layer in program.layers for s in layer.synapses)
    assert held + own <= 4 * own
    raster = (np.random.default_rng(0).random((1, 2, 2 * 128 * 128)) < 0.01).astype(np.uint8)
    machine = Machine(program, 1)
    machine.infer(raster)
    assert machine.ledger.total("sop") > 10_000


FIRST, SECOND = (
    nir.Conv2d((128, 128), np.ones((8, n, 3, 3)), 1, 1, 1, 1, np.zeros(8)) for n in (2, 8)
)
CELLS = neurons("int", (8, 128, 128))


@pytest.mark.parametrize(
    ("inputs", "nodes", "reason"),
    [
        ("ab", [FIRST, CELLS], "a row of several Inputs needs them as a matrix"),
        ("a", [FIRST, CELLS, SECOND], "an Output behind maps, 'output', needs them as a matrix"),
        ("a", [FIRST, SECOND, CELLS], "Two maps without neurons between them"),
    ],
)
def test_maps_that_need_a_matrix_are_refused_with_what_needs_it(inputs, nodes, reason):
    found = {f"n{k}": node for k, node in enumerate(nodes)}
    edges = [*((name, "n0") for name in inputs), *pairwise([*found, "output"])]
    found |= {name: nir.Input(np.array((2, 128, 128))) for name in inputs}
    found["output"] = nir.Output(np.array((8, 128, 128)))
    graph = nir.NIRGraph(found, edges, type_check=False)
    with pytest.raises(RuleError, match=reason):
        compile_program(Artifact(graph, None, Convention(DT)), chip("int"))


def test_neurons_of_a_channel_share_a_scale():
    artifact, on = gesture("loihi1", 16), chip("loihi1")
    program = compile_program(artifact, on, Quantisation(granularity="channel"))
    layer = program.layers[0]
    channels = np.reshape(layer.scale, (8, -1))
    assert (channels == channels[:, :1]).all()
    assert len(np.unique(layer.scale)) == 8
    largest = np.abs(layer.synapses[0].weight).max(axis=(1, 2, 3))
    assert (largest >= on.arithmetic.weight_max - on.arithmetic.weight_step).all()
