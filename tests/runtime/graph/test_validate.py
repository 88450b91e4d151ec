"""What nir's own type checker accepts, and what is refused here by node and remedy."""

import contextlib
from dataclasses import fields

import h5py
import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import (
    ArtifactError,
    ConventionError,
    ObservationError,
    SpikedeployError,
)
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import alone, chain, cuba, ends, lif


def artifact(network):
    return Artifact(network, None, Convention(1e-3))


class Oscillator(nir.NIRNode):
    """A node that some other tool invented."""

    def __init__(self):
        self.input_type = self.output_type = {}


def conv2d(**change):
    """A valid convolution of (2, 6, 6) but for the change."""
    valid = {
        "input_shape": None,
        "weight": np.ones((4, 2, 3, 3)),
        "stride": 1,
        "padding": 0,
        "dilation": 1,
        "groups": 1,
        "bias": np.zeros(4),
    }
    return nir.Conv2d(**{**valid, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bias": np.zeros(3)}, r"bias has shape \(3,\).* need \(4,\)"),
        ({"bias": np.array([0, 0, np.nan, 0])}, "bias holds nan at index"),
        ({"weight": np.ones((4, 2, 3))}, "a Conv2d needs 4 axes"),
        ({"weight": np.ones((4, 0, 3, 3))}, "weight is empty"),
        ({"groups": 3}, "4 features cannot be divided into 3 groups"),
        ({"groups": 2}, r"2 channels arrive, but the weight .* with 2 groups is for 4"),
        ({"groups": 0}, "groups holds 0; it must be 1 or more"),
        ({"stride": (0, 1)}, "stride holds 0"),
        ({"stride": (1.5, 1)}, "stride is .*whole numbers, one or 2"),
        ({"dilation": (1, -1)}, "dilation holds -1"),
        ({"dilation": 4}, r"a kernel of extent \(9, 9\) does not fit into \(6, 6\)"),
        ({"padding": (1, 1, 1)}, "padding is"),
        ({"padding": -1}, "padding holds -1"),
        ({"padding": "reflect"}, "padding is 'reflect'"),
        ({"padding": "same", "stride": 2}, "'same' with stride .* differs between tools"),
        ({"padding": 10**6}, "is more than 16777216 values"),
        ({"input_shape": (6, 5)}, r"'input' puts out \(2, 6, 6\), 'n' takes \(2, 6, 5\)"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_convolution_that_is_none_is_refused_by_name(change, message):
    # set afterwards where nir's own constructor would fail first
    late = {n: v for n, v in change.items() if n != "input_shape"}
    node = conv2d(**{n: v for n, v in change.items() if n == "input_shape"})
    for name, value in late.items():
        setattr(node, name, value)
    with pytest.raises(ArtifactError, match=f"'n'.*{message}|{message}"):
        artifact(alone(node, (2, 6, 6), (4, 4, 4)))


def pool(kernel, stride=(1, 1), padding=(0, 0)):
    return nir.SumPool2d(*map(np.array, (kernel, stride, padding)))


@pytest.mark.parametrize(
    ("node", "shape", "message"),
    [
        (nir.Delay(np.array([1e-3, -1e-3])), (2,), "delay holds -0.001 s"),
        (nir.Delay(np.array([1e-3, np.nan])), (2,), "delay holds nan"),
        (nir.Scale(np.array(["a", "b"])), (2,), "scale holds <U1, not numbers"),
        (lif(2, threshold=-1.0), (2,), "v_threshold holds -1, below its v_reset 0"),
        (nir.Flatten({"input": None}, 2, 1), (2, 3, 4), "axes 2 to 1 cannot be flattened"),
        (nir.Flatten({"input": None}, 0, 3), (2, 3, 4), "axes 0 to 3 cannot be flattened"),
        (nir.Flatten({"input": None}, -4, -1), (2, 3, 4), "start_dim holds -4"),
        (pool([2, 2]), (6,), r"takes \(C, H, W\)"),
        (pool([3, 0]), (2, 6, 6), "kernel_size holds 0"),
        (pool([3.5, 3]), (2, 6, 6), "kernel_size is"),
        (pool([7, 3]), (2, 6, 6), "does not fit"),
        (pool([3, 3], stride=[0, 1]), (2, 6, 6), "stride holds 0"),
        (pool([3, 3], padding=[0, -1]), (2, 6, 6), "padding holds -1"),
        (lif(2, tau=0.0), (2,), "tau holds 0"),
        (nir.Scale(np.ones((3, 1))), (3, 3), "shapes of the graph disagree"),
        (Oscillator(), (2,), "Oscillator is no primitive of NIR"),
    ],
)
def test_a_node_that_cannot_be_computed_is_refused_by_name(node, shape, message):
    with pytest.raises(ArtifactError, match=f"'n': .*{message}|{message}.*'n'"):
        artifact(alone(node, shape, (2,)))


@pytest.mark.parametrize("kind", [lif, cuba], ids=["LIF", "CubaLIF"])
def test_every_field_of_a_neuron_has_its_shape_and_is_finite(kind):
    for field in fields(kind(2)):
        if field.name in ("input_type", "output_type", "metadata"):
            continue
        for value in (np.ones(3), np.ones((2, 1)), np.array(1.0), np.array([1.0, np.nan])):
            node = kind(2)
            setattr(node, field.name, value)
            with pytest.raises(ArtifactError, match=f"node 'n': .*{field.name}|node 'n': .* shape"):
                artifact(alone(node, (2,), (2,)))


@pytest.mark.parametrize("name", ["a/b", "", ".", "a\0b", 3])
def test_a_name_that_no_file_can_hold_is_refused(name):
    network = alone(lif(2), (2,), (2,))
    network.nodes[name] = network.nodes.pop("n")
    network.edges = [("input", name), (name, "output")]
    with pytest.raises(ArtifactError, match="HDF5 cannot hold this name"):
        artifact(network)


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([("input", "output"), ("a", "output")], "'a': no edges lead to it from an Input"),
        ([("input", "output"), ("input", "a")], "'a': no edges lead from it to an Output"),
        ([("input", "output"), ("a", "b"), ("b", "a")], "'a': no edges lead to it"),
        ([("input", "a"), ("a", "b"), ("b", "a"), ("input", "output")], "'a': no .* to an Output"),
        ([("a", "output"), ("b", "a"), ("a", "b")], "'a': no edges lead to it"),
        ([("input", "output"), ("input", "output")], "is there twice"),
        ([("input", "output"), ("output", "input")], "goes into an Input node"),
        ([("input", "a", "output")], "is not a pair"),
    ],
)
def test_edges_that_make_no_graph_are_refused(edges, message):
    nodes = ends(2, 2)
    named = {name for edge in edges for name in edge} - {"input", "output"}
    network = nir.NIRGraph({**nodes, **{name: lif(2) for name in named}}, [], type_check=False)
    network.edges = edges
    with pytest.raises(ArtifactError, match=message):
        artifact(network)


# files


def written(path, network):
    nir.write(path, network)
    return path


def test_a_slash_in_a_name_is_recognised_when_the_file_is_read(tmp_path):
    network = alone(lif(2), (2,), (2,))
    network.nodes["l/f"] = network.nodes.pop("n")
    network.edges = [("input", "l/f"), ("l/f", "output")]
    with pytest.raises(ArtifactError, match=r"'l' has no type. If it was called 'l/f'.* Rename"):
        load(written(tmp_path / "a.nir", network))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("type", "Resonator", "'Resonator' is no primitive of NIR"),
        ("tau", None, r"no LIF can be made of r \(2,\), .*tau"),
        ("tau", np.ones(3), r"no LIF can be made of .*tau \(3,\).* same shape"),
    ],
    ids=["kind of the future", "missing field", "other shape"],
)
def test_a_node_that_nir_cannot_make_is_named_with_what_there_is(field, value, message, tmp_path):
    path = written(tmp_path / "a.nir", alone(lif(2), (2,), (2,)))
    with h5py.File(path, "r+") as file:
        del file[f"node/nodes/n/{field}"]
        if value is not None:
            file[f"node/nodes/n/{field}"] = value
    with pytest.raises(ArtifactError, match=f"'n': {message}"):
        load(path)


def test_texts_that_hdf5_would_read_for_ever_are_refused(tmp_path):
    path = written(tmp_path / "a.nir", alone(lif(2), (2,), (2,)))
    content = bytearray(path.read_bytes())
    heap = content.index(b"GCOL")
    at, end = heap + 16, heap + int.from_bytes(content[heap + 8 : heap + 16], "little")
    while content[at] or content[at + 1]:
        at += 16 + -(-int.from_bytes(content[at + 8 : at + 16], "little") // 8) * 8
    # the free space behind the last text now has no length, and is never left
    assert at < end - 16
    content[at + 8 : at + 16] = bytes(8)
    path.write_bytes(content)
    with pytest.raises(ArtifactError, match=r"its texts, at byte \d+, are damaged"):
        load(path)


# numbers


def test_gains_too_large_for_a_number_are_refused():
    node = cuba(1)
    node.w_in[:], node.r[:] = 1e300, 1e300
    with pytest.raises(ConventionError, match=r"'n': at dt = 0\.001 s its gain .* too large"):
        artifact(alone(node, (1,), (1,)))


def test_sums_too_large_for_a_number_are_refused_by_node():
    network = chain(nir.Linear(np.array([[1e200]])), lif(1, threshold=1e307), width=1, act=1)
    with pytest.raises(ObservationError, match=r"node 'n1': its values became too large"):
        FloatGraph(artifact(network)).run(np.full((1, 2, 1), 1e200))


ODD = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 5e-324, 1e308, -1e308, 1e-310])
SHAPES = st.sampled_from([(), (0,), (1,), (2,), (3,), (2, 2), (2, 1), (1, 2)])


@st.composite
def mutilated(draw):
    """A valid graph of several kinds, with one change that may make it invalid."""
    nodes = {
        "input": nir.Input(np.array([2])),
        "fc": nir.Affine(np.eye(2), np.zeros(2)),
        "cuba": cuba(2),
        "lif": lif(2),
        "if": nir.IF(np.full(2, 1e3), np.ones(2)),
        "wait": nir.Delay(np.full(2, 1e-3)),
        "scale": nir.Scale(np.ones(2)),
        "bit": nir.Threshold(np.zeros(2)),
        "output": nir.Output(np.array([2])),
    }
    edges = list(zip(list(nodes)[:-1], list(nodes)[1:], strict=True))
    edges.append(("lif", "fc"))
    name = draw(st.sampled_from([n for n in nodes if n not in ("input", "output")]))
    numbers = [f for f, v in vars(nodes[name]).items() if isinstance(v, np.ndarray)]
    field = draw(st.sampled_from(numbers))
    if draw(st.booleans()):
        getattr(nodes[name], field).flat[draw(st.integers(0, 1))] = draw(ODD)
    else:
        setattr(nodes[name], field, np.full(draw(SHAPES), draw(ODD)))
    edges.pop(draw(st.integers(0, len(edges) - 1))) if draw(st.booleans()) else None
    return nir.NIRGraph(nodes, edges, type_check=False)


@settings(max_examples=120)
@given(mutilated(), st.sampled_from(["euler", "exponential"]), st.sampled_from([1e-3, 1e-12, 1e12]))
def test_a_changed_graph_is_refused_by_name_or_computes_numbers(network, integrator, dt):
    with contextlib.suppress(SpikedeployError):
        valid = Artifact(network, None, Convention(dt, integrator=integrator))
        found = FloatGraph(valid).run(np.ones((1, 4, 2)))
        assert np.isfinite(found["output"]).all()
