"""Graphs inside graphs mean the same as the graph in one level."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, ends, graph, lif


def artifact(network):
    return Artifact(network, None, Convention(1e-3))


def recurrent():
    """A recurrent cell as snnTorch writes one."""
    weight = nir.Linear(np.array([[0.0, 1.5], [1.5, 0.0]]))
    edges = "input->lif, lif->w_rec, w_rec->lif, lif->output"
    return graph(edges, **ends(), lif=lif(2), w_rec=weight)


def test_a_graph_inside_computes_what_it_computes_alone():
    raster = np.random.default_rng(0).random((3, 20, 2)) < 0.5
    nested = artifact(chain(nir.Linear(2 * np.eye(2)), recurrent(), width=2, act=2))
    found = FloatGraph(nested).run(raster)
    alone = FloatGraph(artifact(recurrent())).run(2.0 * raster)
    assert found.keys() == {"n2.lif", "output"}
    np.testing.assert_array_equal(found["n2.lif"], alone["lif"])


def test_a_file_with_a_graph_inside_is_read_and_can_be_compiled(tmp_path):
    nir.write(tmp_path / "a.nir", chain(nir.Linear(np.eye(2)), recurrent(), width=2, act=2))
    back = load(tmp_path / "a.nir")
    assert back.convention == Convention(1e-3)
    assert [layer.name for layer in compile_program(back, chip("ideal")).layers] == ["n2.lif"]
    save(back, tmp_path / "b.nir")
    assert sorted(load(tmp_path / "b.nir").graph.nodes) == sorted(back.graph.nodes)


def test_a_way_past_everything_inside_adds_to_the_way_around():
    ten = nir.Scale(np.full(2, 10.0))
    inner = graph("input->ten, ten->output, input->output", **ends(), ten=ten)
    edges = "input->in, in->sum, input->sum, sum->output"
    network = graph(edges, **ends(), **{"in": inner}, sum=nir.Scale(np.ones(2)))
    found = FloatGraph(artifact(network)).run(np.ones((1, 1, 2)))
    # x around, x past the node inside, and 10 x through it
    assert found["output"].ravel().tolist() == [12, 12]


def test_several_ways_in_and_out_are_sums():
    inner = graph("input->a, a->output", **ends(), a=nir.Scale(np.ones(2)))
    network = nir.NIRGraph(
        {**ends(), "in": inner, "b": nir.Scale(np.full(2, 2.0)), "c": nir.Scale(np.full(2, 3.0))},
        [
            ("input", "in"),
            ("b", "in"),
            ("input", "b"),
            ("in", "c"),
            ("in", "output"),
            ("c", "output"),
        ],
    )
    # a = 1 + 2 = 3; output = 3 + 9
    found = FloatGraph(artifact(network)).run(np.ones((1, 1, 2)))
    assert found["output"].ravel().tolist() == [12, 12]


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([("input", "lif"), ("lif", "output")], r"in node 'n1': edge 'input' -> 'lif' .*no node"),
        (
            [("input", "cell"), ("cell", "output"), ("output", "cell")],
            "in node 'n1': .* out of an O",
        ),
        (
            [("input", "cell"), ("cell", "output"), ("cell", "input")],
            "in node 'n1': .* into an Inp",
        ),
    ],
)
def test_a_broken_graph_inside_is_refused_by_its_node(edges, message):
    inner = nir.NIRGraph({**ends(), "cell": lif(2)}, edges, type_check=False)
    nodes = {**ends(), "n1": inner}
    network = nir.NIRGraph(nodes, [("input", "n1"), ("n1", "output")], type_check=False)
    with pytest.raises(ArtifactError, match=message):
        artifact(network)


def test_names_that_would_be_the_same_are_refused():
    nodes = {**ends(), "a": chain(lif(2), width=2, act=2), "a.n1": lif(2)}
    edges = [("input", "a"), ("a", "a.n1"), ("a.n1", "output")]
    with pytest.raises(ArtifactError, match=r"would be called a\.n1.* Rename"):
        artifact(nir.NIRGraph(nodes, edges))
