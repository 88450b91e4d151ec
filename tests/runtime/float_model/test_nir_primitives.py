"""Every primitive of NIR that is no neuron, against torch or a trace worked by hand."""

import nir
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional

from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import alone, lif


def network(graph, dtype=np.float64, **convention):
    return FloatGraph(Artifact(graph, None, Convention(1e-3, **convention)), dtype)


def ran(node, x):
    """The output of a node (B, T, *N); its shape is asked of whoever checks it."""
    wanted = node_shape(node, x.shape[2:])
    return network(alone(node, x.shape[2:], wanted)).run(x)["output"]


def node_shape(node, shape):
    """The shape by torch's own arithmetic."""
    return reference(node, np.zeros((1, 1, *shape))).shape[2:]


def reference(node, x):
    """The same node as torch computes it."""
    rows = torch.from_numpy(np.ascontiguousarray(x.reshape(-1, *x.shape[2:])))
    if isinstance(node, nir.AvgPool2d):
        y = functional.avg_pool2d(rows, *pool_options(node))
    elif isinstance(node, nir.SumPool2d):
        y = functional.avg_pool2d(rows, *pool_options(node), divisor_override=1)
    else:
        convolve = functional.conv1d if isinstance(node, nir.Conv1d) else functional.conv2d
        padding = node.padding if isinstance(node.padding, (str, int)) else tuple(node.padding)
        weight, bias = torch.from_numpy(node.weight), torch.from_numpy(node.bias)
        y = convolve(rows, weight, bias, node.stride, padding, node.dilation, node.groups)
    return y.numpy().reshape(*x.shape[:2], *y.shape[1:])


def pool_options(node):
    return [tuple(map(int, value)) for value in (node.kernel_size, node.stride, node.padding)]


@st.composite
def convolutions(draw, axes):
    """A convolution and an input that it fits into."""
    groups = draw(st.integers(1, 3))
    channels, features = (groups * draw(st.integers(1, 2)) for _ in range(2))
    some = st.tuples(*[st.integers(1, 3)] * axes)
    kernel, stride, dilation = draw(some), draw(some), draw(some)
    padding = draw(
        st.one_of(st.sampled_from(["same", "valid"]), st.tuples(*[st.integers(0, 3)] * axes))
    )
    if padding == "same":
        stride = (1,) * axes
    reach = [d * (k - 1) + 1 for k, d in zip(kernel, dilation, strict=True)]
    extents = tuple(r + draw(st.integers(0, 4)) for r in reach)
    rng = np.random.default_rng(draw(st.integers(0, 1000)))
    weight = rng.normal(size=(features, channels // groups, *kernel))
    told = draw(st.booleans())
    bias = rng.normal(size=features)
    if axes == 1:
        numbers = [
            value if isinstance(value, str) else value[0] for value in (stride, padding, dilation)
        ]
        node = nir.Conv1d(extents[0] if told else None, weight, *numbers, groups, bias)
    else:
        node = nir.Conv2d(
            extents if told else None, weight, stride, padding, dilation, groups, bias
        )
    return node, rng.normal(size=(2, 3, channels, *extents))


# torch warns that it copies, where 'same' is odd
@pytest.mark.filterwarnings("ignore:Using padding='same'")
@settings(max_examples=24)
@given(st.integers(1, 2).flatmap(convolutions))
def test_a_convolution_equals_torch(case):
    node, x = case
    np.testing.assert_allclose(ran(node, x), reference(node, x), rtol=0, atol=1e-12)


@settings(max_examples=16)
@given(st.data())
@pytest.mark.parametrize("kind", [nir.SumPool2d, nir.AvgPool2d])
def test_a_pool_equals_torch_zeros_of_the_padding_counted(kind, data):
    pair = st.tuples(st.integers(1, 4), st.integers(1, 4))
    kernel, stride = data.draw(pair), data.draw(pair)
    # torch refuses more padding than half a kernel
    padding = [data.draw(st.integers(0, k // 2)) for k in kernel]
    extents = [k + data.draw(st.integers(0, 4)) for k in kernel]
    node = kind(*map(np.array, (kernel, stride, padding)))
    x = np.random.default_rng(0).normal(size=(2, 3, 2, *extents))
    np.testing.assert_allclose(ran(node, x), reference(node, x), rtol=0, atol=1e-12)


def test_many_rows_at_once_equal_each_alone(monkeypatch):
    node = nir.Conv2d((9, 7), np.ones((2, 1, 3, 3)), 1, 1, 1, 1, np.zeros(2))
    x = np.random.default_rng(0).normal(size=(4, 5, 1, 9, 7))
    whole = ran(node, x)
    monkeypatch.setattr("spikedeploy.runtime.float_model.CHUNK_VALUES", 1000)
    np.testing.assert_allclose(ran(node, x), whole, rtol=0, atol=1e-12)


def test_every_row_of_stacked_weights_has_a_matrix_of_its_own():
    weight = np.arange(12.0).reshape(2, 3, 2)
    node = nir.Affine(weight, np.ones((2, 3)))
    x = np.array([[[[1.0, 0], [0, 1]]]])
    # the first column of the first matrix, the second of the second, and 1
    found = network(alone(node, (2, 2), (2, 3))).run(x)["output"]
    assert found[0, 0].tolist() == [[1, 3, 5], [8, 10, 12]]


@pytest.mark.parametrize(
    ("start", "end", "wanted"),
    [(1, -1, (2, 12)), (0, -1, (24,)), (0, 1, (6, 4)), (-2, -1, (2, 12)), (1, 1, (2, 3, 4))],
)
def test_flatten_joins_the_axes_that_it_names(start, end, wanted):
    node = nir.Flatten({"input": None}, start, end)
    x = np.random.default_rng(0).normal(size=(2, 3, 2, 3, 4))
    found = network(alone(node, (2, 3, 4), wanted)).run(x)["output"]
    np.testing.assert_array_equal(found, x.reshape(2, 3, *wanted))


# delays


def delayed(x, *taus, **convention):
    node = nir.Delay(np.array(taus))
    return network(alone(node, (len(taus),), (len(taus),)), **convention).run(x)["output"]


def test_every_element_has_its_own_delay():
    x = np.arange(1.0, 9).reshape(1, 4, 2)
    assert delayed(x, 1e-3, 2e-3)[0].tolist() == [[0, 0], [1, 0], [3, 2], [5, 4]]
    assert delayed(x, 0.0, 3e-3)[0].tolist() == [[1, 0], [3, 0], [5, 0], [7, 2]]


def test_a_delay_that_is_not_whole_timesteps_is_refused():
    with pytest.raises(ConventionError, match=r"'n': a delay of 0\.0025 s is 2\.5 timesteps"):
        delayed(np.ones((1, 1, 1)), 2.5e-3)


def test_a_delay_written_in_float32_is_whole():
    node = nir.Delay(np.array([3e-3], np.float32))
    found = network(alone(node, (1,), (1,))).run(np.eye(5)[None, :, :1])["output"]
    assert found.ravel().tolist() == [0, 0, 0, 1, 0]


def test_a_delay_in_a_loop_counts_once():
    # the spike of t = 0 comes back at t = 3, and there it starts the next: period 3
    nodes = {
        "input": nir.Input(np.array([1])),
        "cell": lif(1, threshold=0.5),
        "wait": nir.Delay(np.array([3e-3])),
        "output": nir.Output(np.array([1])),
    }
    edges = [("input", "cell"), ("cell", "wait"), ("wait", "cell"), ("cell", "output")]
    # the leak is fast, so that only what arrives now counts
    nodes["cell"].tau[:], nodes["cell"].r[:] = 1e-3, 1.0
    graph = nir.NIRGraph(nodes, edges)
    x = np.zeros((1, 8, 1))
    x[0, 0] = 1
    assert network(graph).run(x)["cell"].ravel().tolist() == [1, 0, 0, 1, 0, 0, 1, 0]


# files and chips


OBLONG = nir.Conv2d(None, np.ones((4, 1, 3, 5)), (2, 1), (1, 0), (1, 2), 2, np.zeros(4))


@pytest.mark.parametrize(
    ("node", "shape"),
    [
        (OBLONG, (2, 10, 12)),
        (nir.Conv1d(None, np.ones((2, 1, 3)), 1, "same", 2, 1, np.zeros(2)), (1, 9)),
        (nir.SumPool2d(*(np.array(v) for v in ((2, 3), (1, 2), (0, 1)))), (2, 5, 8)),
        (nir.AvgPool2d(*(np.array(v) for v in ((2, 3), (1, 2), (0, 1)))), (2, 5, 8)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_file_comes_back_and_computes_the_same(node, shape, tmp_path):
    path = tmp_path / "a.nir"
    x = np.random.default_rng(0).normal(size=(1, 2, *shape))
    out = node_shape(node, shape)
    save(Artifact(alone(node, shape, out), None, Convention(1e-3)), path)
    found = FloatGraph(load(path)).run(x)["output"]
    np.testing.assert_allclose(found, reference(node, x), rtol=0, atol=1e-12)
    assert found.shape[2:] == out
