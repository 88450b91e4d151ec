import random
from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.order import order
from tests.networks import chain, cuba, ends, graph, lif, popsan


def network(nodes, **convention):
    """A running graph without codec at dt = 1 ms."""
    return FloatGraph(Artifact(nodes, None, Convention(1e-3, **convention)))


def column(*values):
    """A raster (1, T, 1)."""
    return np.array(values, float)[None, :, None]


def loop(artifact, raster, delay=0, reset="zero"):
    """The policy of networks.popsan, neuron layer by neuron layer, as a textbook writes it."""
    nodes, trace = artifact.graph.nodes, {}
    x = raster.astype(float)
    for fc, spiking in (("n1", "n2"), ("n3", "n4"), ("n5", "n6")):
        x = np.concatenate([np.zeros_like(x[:, :delay]), x[:, : x.shape[1] - delay]], axis=1)
        drive = x @ nodes[fc].weight.T + nodes[fc].bias
        current, membrane = np.zeros((2, *drive[:, 0].shape))
        x = np.zeros_like(drive)
        for t in range(drive.shape[1]):
            current = 0.9 * current + drive[:, t]
            membrane = 0.8 * membrane + current
            x[:, t] = membrane > 0.5
            membrane = membrane - 0.5 * x[:, t] if reset == "subtract" else membrane * (1 - x[:, t])
        trace[spiking] = x
    x = np.concatenate([np.zeros_like(x[:, :delay]), x[:, : x.shape[1] - delay]], axis=1)
    return {**trace, "output": x @ nodes["n7"].weight.T + nodes["n7"].bias}


def spikes_in(artifact, batch=8, seed=0):
    obs = np.random.default_rng(seed).normal(size=(batch, 3))
    return artifact.codec.encode(obs)


def equal(found, wanted):
    assert found.keys() == wanted.keys()
    for name, values in wanted.items():
        np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-12)


# one neuron, worked by hand


def test_a_cuba_lif_neuron_worked_by_hand():
    # I: 0.4, 0.2, 0.1 | V: 0.4, 0.2 + 0.2 = 0.4, 0.2 + 0.1 = 0.3: no spike over 0.5
    # I: 0.4, 0.6, 0.3 | V: 0.4, 0.2 + 0.6 = 0.8 -> spike, 0; 0 + 0.3: I goes on, V began again
    nodes = chain(cuba(1, alpha=0.5, beta=0.5), width=1, act=1)
    assert network(nodes).run(column(0.4, 0, 0))["n1"].ravel().tolist() == [0, 0, 0]
    assert network(nodes).run(column(0.4, 0.4, 0))["n1"].ravel().tolist() == [0, 1, 0]


def test_the_leak_pulls_the_membrane_and_the_reset_goes_to_v_reset():
    # V = 0.5 V + 0.5 * 3: 1.5 -> spike, -1; -0.5 + 1.5 = 1; 0.5 + 1.5 = 2 -> spike
    node = lif(1, tau=2e-3, r=2.0, v_leak=3.0)
    node.v_reset[:] = -1.0
    found = network(chain(node, width=1, act=1)).run(column(0, 0, 0))
    assert found["n1"].ravel().tolist() == [1, 0, 1]


def test_the_exponential_integrator_decays_by_e_to_the_minus_dt_over_tau():
    node = nir.LI(np.array([5e-3]), np.array([1.0]), np.array([0.0]))
    found = network(chain(node, width=1, act=1), integrator="exponential").run(column(1, 0, 0))
    # V = b V + (1 - b) x
    b = np.exp(-0.2)
    np.testing.assert_allclose(found["output"].ravel(), (1 - b) * b ** np.arange(3), rtol=1e-14)


def test_integrators_without_a_leak_add_dt_times_r():
    node = nir.IF(np.array([500.0]), np.array([1.2]))
    # V = V + 0.5 x: 0.5, 1, 1.5 -> spike, 0, 0.5
    found = network(chain(node, width=1, act=1)).run(column(1, 1, 1, 0, 1))
    assert found["n1"].ravel().tolist() == [0, 0, 1, 0, 0]
    found = network(chain(nir.I(np.array([500.0])), width=1, act=1)).run(column(1, 1, 1))
    assert found["output"].ravel().tolist() == [0.5, 1.0, 1.5]


def test_neurons_that_do_not_spike_put_out_their_membrane():
    full = [np.array([v]) for v in (2e-3, 2e-3, 2.0, 0.0)]
    node = nir.CubaLI(*full, w_in=np.array([2.0]))
    # I: 1, 0.5, 0.25 | V: 1, 0.5 + 0.5, 0.5 + 0.25
    found = network(chain(node, width=1, act=1)).run(column(1, 0, 0))
    assert found["output"].ravel().tolist() == [1.0, 1.0, 0.75]
    assert found.keys() == {"output"}


# graphs


@pytest.mark.parametrize("convention", [{}, {"reset": "subtract"}, {"delay": 1}], ids=str)
def test_a_policy_equals_the_textbook_loop(convention):
    artifact = replace(popsan(), convention=Convention(1e-3, **convention))
    raster = np.concatenate([spikes_in(artifact, 100), spikes_in(artifact, 100, seed=1)], axis=1)
    equal(FloatGraph(artifact).run(raster), loop(artifact, raster, **convention))


def test_the_order_of_nodes_and_edges_changes_no_bit():
    artifact = popsan()
    raster = spikes_in(artifact)
    before = FloatGraph(artifact).run(raster)
    for seed in range(5):
        nodes, edges = list(artifact.graph.nodes.items()), list(artifact.graph.edges)
        random.Random(seed).shuffle(nodes)
        random.Random(seed).shuffle(edges)
        shuffled = replace(artifact, graph=nir.NIRGraph(dict(nodes), edges))
        for name, values in FloatGraph(shuffled).run(raster).items():
            np.testing.assert_array_equal(values, before[name])


# loops


def recurrent(weight, bias=0.0):
    """A spiking neuron with a recurrent connection `weight`."""
    return graph(
        "input->cell, cell->back, back->cell, cell->output",
        **ends(1, 1),
        cell=lif(1),
        back=nir.Affine(np.array([[weight]]), np.array([bias])),
    )


def test_a_recurrent_spike_arrives_in_the_next_timestep():
    # V: 1.5 -> spike; 0 + 2 -> spike; ...: it keeps itself going
    assert network(recurrent(2.0)).run(column(1.5, 0, 0, 0))["cell"].ravel().tolist() == [1] * 4
    # V: 1.5 -> spike; 0 - 2; -1.8 + 1.5; -0.27 + 1.5 -> spike
    found = network(recurrent(-2.0)).run(column(1.5, 0, 1.5, 1.5))
    assert found["cell"].ravel().tolist() == [1, 0, 0, 1]


@pytest.mark.parametrize("weight", [2.0, -2.0])
def test_a_recurrent_connection_takes_one_timestep_whatever_the_delay(weight):
    raster = (np.random.default_rng(0).random((4, 30, 1)) < 0.5) * 1.5
    found = network(recurrent(weight)).run(raster)
    delayed = network(recurrent(weight), delay=1).run(raster)
    np.testing.assert_array_equal(found["cell"], delayed["cell"])


def two_layers(**more):
    """Two spiking layers and a connection back from the second to the first."""
    return graph(
        "input->a, a->up, up->z, z->back, back->a, z->output",
        **ends(2, 2),
        a=lif(2),
        z=lif(2),
        up=nir.Linear(np.array([[1.5, 0.0], [0.0, 1.5]])),
        back=nir.Linear(np.array([[0.0, 1.5], [1.5, 0.0]])),
        **more,
    )


def test_the_edge_that_comes_back_is_found_whatever_the_names():
    assert order(popsan().graph).late == frozenset()
    assert order(two_layers()).late == {("z", "back")}
    # names and files may list the second layer first
    nodes = graph(
        "input->z, z->up, up->a, a->back, back->z, a->output",
        **ends(1, 1),
        a=lif(1),
        z=lif(1),
        up=nir.Linear(np.eye(1)),
        back=nir.Linear(np.eye(1)),
    )
    assert order(nodes).late == {("a", "back")}
    assert order(nodes).names == ("input", "back", "z", "up", "a", "output")


def test_a_loop_without_a_neuron_is_refused_by_name():
    nodes = graph(
        "input->a, a->b, b->a, b->output",
        **ends(1, 1),
        a=nir.Linear(np.eye(1)),
        b=nir.Linear(np.eye(1)),
    )
    with pytest.raises(ArtifactError, match="the loop through a, b has no neuron"):
        network(nodes)


# state and number type


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("nodes", [popsan(obs=1).graph, two_layers()], ids=["forward", "loop"])
def test_a_state_that_is_kept_makes_parts_equal_the_whole(nodes, delay):
    width = int(nodes.nodes["input"].input_type["input"][0])
    raster = np.random.default_rng(0).random((3, 12, width)) < 0.3
    whole = network(nodes, delay=delay).run(raster)
    running = network(nodes, state="kept", delay=delay)
    parts = [running.run(part) for part in np.split(raster, [1, 5, 6], axis=1)]
    for name, values in whole.items():
        joined = np.concatenate([part[name] for part in parts], axis=1)
        np.testing.assert_allclose(joined, values, rtol=0, atol=1e-12)


def test_a_state_of_another_batch_is_refused():
    artifact = replace(popsan(), convention=Convention(1e-3, state="kept"))
    running = FloatGraph(artifact)
    running.run(spikes_in(artifact, batch=2))
    with pytest.raises(ObservationError, match=r"state of 2 networks.* Call reset"):
        running.run(spikes_in(artifact, batch=3))


# what is refused


def two_inputs():
    """The sum of two inputs at one output, the second twice at another."""
    nodes = {"a": nir.Input(np.array([2])), "b": nir.Input(np.array([2]))}
    outputs = {"sum": nir.Output(np.array([2])), "more": nir.Output(np.array([2]))}
    edges = "a->sum, b->sum, b->twice, twice->more"
    return graph(edges, **nodes, **outputs, twice=nir.Scale(np.full(2, 2.0)))


def test_several_inputs_and_outputs_go_by_their_names():
    found = network(two_inputs()).run({"a": [[[1, 2]]], "b": [[[10, 20]]]})
    assert {name: rows.tolist() for name, rows in found.items()} == {
        "sum": [[[11, 22]]],
        "more": [[[20, 40]]],
    }


@pytest.mark.parametrize(
    ("raster", "message"),
    [
        (np.zeros((1, 2, 2)), "without a name.* inputs a, b"),
        (
            {"a": np.zeros((1, 2, 2))},
            "'b' has no match",
        ),
        ({"a": np.zeros((1, 2, 2)), "b": np.zeros((1, 3, 2))}, "Give all rasters the same batch"),
    ],
)
def test_rasters_that_are_not_those_of_the_inputs_are_refused(raster, message):
    with pytest.raises(ObservationError, match=message):
        network(two_inputs()).run(raster)


def test_a_spiking_node_must_leave_the_name_output_to_the_readout():
    nodes = graph(
        "input->output, output->end",
        input=nir.Input(np.array([1])),
        end=nir.Output(np.array([1])),
        output=lif(1),
    )
    with pytest.raises(ArtifactError, match=r"'output' spikes.* Rename it"):
        network(nodes)


@pytest.mark.parametrize("shape", [(5, 30), (1, 5, 31), (1, 0, 30), (0, 5, 30)])
def test_a_raster_of_the_wrong_shape_is_refused(shape):
    with pytest.raises(ObservationError, match=r"takes (\(B, T, 30\)|30 spike trains)"):
        FloatGraph(popsan()).run(np.zeros(shape))


def test_a_raster_with_nan_is_refused():
    with pytest.raises(ObservationError, match="NaN"):
        FloatGraph(popsan()).run(np.full((1, 5, 30), np.nan))
