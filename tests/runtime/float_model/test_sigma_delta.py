"""Sigma-delta neurons in float, and in a file."""

import copy
import pickle

import h5py
import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact, digest, load, save
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.discretisation import SigmaDelta
from tests.graded import GRADED, INPUT, OUTPUT, SIGMA, delta_network, one_neuron, rasters


def test_a_neuron_by_hand():
    graph = FloatGraph(one_neuron())
    trace = graph.run(INPUT)
    assert trace["sd1"].dtype == np.int64
    assert trace["sd1"][0, :, 0].tolist() == GRADED
    assert trace["output"][0, :, 0].tolist() == OUTPUT
    assert graph.nodes["sd1"].membrane[0, 0] == SIGMA[-1]


def test_the_state_goes_on_from_run_to_run_and_with_copies():
    raster = rasters()
    whole = FloatGraph(delta_network(hidden=(8, 6))).run(raster)
    graph = FloatGraph(delta_network(hidden=(8, 6)))
    first = graph.run(raster[:, :15])
    rest = [copied.run(raster[:, 15:]) for copied in (copy.deepcopy(graph), graph)]
    rest.append(pickle.loads(pickle.dumps(_after(raster[:, :15]))).run(raster[:, 15:]))
    for name, rows in whole.items():
        for each in rest:
            np.testing.assert_array_equal(np.concatenate([first[name], each[name]], 1), rows)


def _after(raster):
    graph = FloatGraph(delta_network(hidden=(8, 6)))
    graph.run(raster)
    return graph


def test_a_file_keeps_the_neurons_and_says_what_others_see(tmp_path):
    artifact = delta_network(hidden=(8, 6))
    save(artifact, tmp_path / "a.nir")
    read = load(tmp_path / "a.nir")
    raster = rasters()
    one, other = FloatGraph(artifact).run(raster), FloatGraph(read).run(raster)
    assert one.keys() == other.keys()
    assert all((one[name] == other[name]).all() for name in one)
    assert digest(read) == digest(artifact)
    # any NIR tool reads the graph; what it does not know is said in words
    assert isinstance(nir.read(tmp_path / "a.nir").nodes["sd1"], nir.I)
    with h5py.File(tmp_path / "a.nir") as file:
        remark = file["node/metadata/spikedeploy/sigma_delta/sd1/remark"][()]
    assert b"integrator" in remark


@pytest.mark.parametrize(
    ("neurons", "message"),
    [
        ({"fc1": SigmaDelta(np.ones(1), np.zeros(1))}, "it is Linear"),
        ({"sd9": SigmaDelta(np.ones(1), np.zeros(1))}, "no such node"),
        ({"sd1": SigmaDelta(np.ones(2), np.zeros(2))}, r"shape \(2,\)"),
    ],
)
def test_neurons_that_are_none_are_refused(neurons, message):
    artifact = one_neuron()
    with pytest.raises(ArtifactError, match=message):
        Artifact(artifact.graph, None, artifact.convention, sigma_delta=neurons)


def test_a_threshold_of_0_is_refused():
    with pytest.raises(ArtifactError, match="above 0"):
        SigmaDelta(np.array([0.5, 0.0]), np.zeros(2))
