"""Networks rewritten for the imports of other tools: the same spikes as those tools read them."""

import h5py
import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact, for_importer, load, save
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.tools import IMPORTERS, norse_visits
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ConventionError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, graph, lif, popsan, spiking_mlp

TORCH = ("norse", "snntorch", "spikingjelly")


def layered(neurons, convention=None, gain=1.0):
    """Two layers of random weights and biases: 10 -> 12 -> 5."""
    rng, nodes = np.random.default_rng(0), []
    for fan_in, size in ((10, 12), (12, 5)):
        weight = gain * 2 * rng.normal(size=(size, fan_in)) / fan_in**0.5
        nodes += [nir.Affine(weight, gain * 0.1 * rng.normal(size=size)), neurons(size)]
    return Artifact(chain(*nodes, width=10, act=5), None, convention or Convention(1e-3))


def output(artifact):
    raster = np.random.default_rng(1).random((1, 300, 10)) < 0.3
    return FloatGraph(artifact).run(raster.astype(float))["output"]


def same(artifact, tool, tmp_path, **told):
    """The file has the same spikes as it states, and as the tool reads it."""
    path = tmp_path / "for.nir"
    save(for_importer(artifact, tool), path)
    wanted = output(artifact)
    assert 20 < np.count_nonzero(wanted) < wanted.size - 20
    for read in (load(path), load(path, like=tool, **told)):
        assert np.array_equal(output(read), wanted)
    return load(path).graph


def uneven(size):
    """Thresholds of their own, and a gain of 2."""
    neurons = cuba(size)
    neurons.v_threshold = np.linspace(0.3, 0.9, size)
    neurons.w_in = 2 * neurons.w_in
    return neurons


def leaky(size):
    return lif(size, tau=0.008, r=3.0, threshold=0.5, v_leak=0.2)


NEURONS = {
    "CubaLIF": (cuba, 1),
    "CubaLIF-uneven": (uneven, 0.5),
    "LIF-physical": (lambda n: lif(n, tau=0.01, r=1.0), 10),
    "LIF-leak": (leaky, 1),
    "exponential": (cuba, 1),
}


@pytest.mark.parametrize("tool", TORCH)
@pytest.mark.parametrize("case", NEURONS)
def test_a_tool_reads_the_same_spikes(case, tool, tmp_path):
    neurons, gain = NEURONS[case]
    integrator = "exponential" if case == "exponential" else "euler"
    same(layered(neurons, Convention(1e-3, integrator=integrator), gain), tool, tmp_path)


@pytest.mark.parametrize("tool", ["norse", "spikingjelly"])
def test_integrators_too(tool, tmp_path):
    same(layered(lambda n: nir.IF(np.full(n, 300.0), np.full(n, 1.0))), tool, tmp_path)


OWN = [
    ("rockpool", {"reset": "subtract", "integrator": "exponential", "spikes": "many"}, 0.5, {}),
    ("norse", {"reset": "subtract"}, 1.0, {"reset": "subtract"}),
]


@pytest.mark.parametrize(("tool", "options", "gain", "told"), OWN)
def test_tools_that_subtract_read_networks_that_do(tool, options, gain, told, tmp_path):
    same(layered(cuba, Convention(1e-3, **options), gain), tool, tmp_path, **told)


@pytest.mark.parametrize("tool", TORCH)
@pytest.mark.parametrize("policy", [popsan, spiking_mlp])
def test_policies_keep_their_weights_and_their_codec(policy, tool):
    artifact = policy()
    found = for_importer(artifact, tool)
    assert found.codec is artifact.codec
    for name, node in artifact.graph.nodes.items():
        if isinstance(node, nir.Affine):
            assert found.graph.nodes[name].weight is node.weight


@pytest.mark.parametrize("tool", ["spikingjelly", "snntorch"])
def test_a_membrane_at_the_threshold_spikes_as_the_network_states(tool, tmp_path):
    weight = np.random.default_rng(2).integers(-1, 3, (5, 10)).astype(float)
    neurons = cuba(5, 0.0, 0.5, threshold=2.0)
    network = chain(nir.Affine(weight, np.zeros(5)), neurons, width=10, act=5)
    above, reached = (
        Artifact(network, None, Convention(1e-3, spikes=rule)) for rule in ("above", "reached")
    )
    assert not np.array_equal(output(reached), output(above))  # the rule decides
    found = same(above if tool == "spikingjelly" else reached, tool, tmp_path)
    if tool == "spikingjelly":
        assert found.nodes["n2"].v_threshold[0] == np.nextafter(np.float32(2), np.float32(3))


def recurrent():
    rng = np.random.default_rng(3)
    nodes = {
        "input": nir.Input(np.array([10])),
        "fc": nir.Affine(rng.normal(size=(8, 10)), np.zeros(8)),
        "hidden": cuba(8),
        "rec": nir.Linear(rng.normal(size=(8, 8)) / 3),
        "out": nir.Linear(rng.normal(size=(5, 8))),
        "last": cuba(5),
        "output": nir.Output(np.array([5])),
    }
    edges = "input->fc, fc->hidden, hidden->rec, rec->hidden, hidden->out, out->last, last->output"
    return Artifact(graph(edges, **nodes), None, Convention(1e-3))


@pytest.mark.parametrize("tool", TORCH)
def test_loops_deliver_in_the_next_timestep(tool, tmp_path):
    same(recurrent(), tool, tmp_path)


def test_loops_have_nodes_of_their_own_where_an_import_could_not_run_them():
    edges = for_importer(recurrent(), "snntorch").graph.edges
    assert not [edge for edge in edges if edge[::-1] in edges]
    before, after = recurrent().graph, for_importer(recurrent(), "norse").graph
    assert norse_visits(before.nodes, sorted(before.edges))[-1] == "rec"
    assert norse_visits(after.nodes, sorted(after.edges))[-1].endswith("_output")


def test_norse_refuses_a_node_that_waits_for_two():
    nodes = {
        "input": nir.Input(np.array([10])),
        "a": nir.Linear(np.ones((8, 10))),
        "b": cuba(8),
        "c": nir.Linear(np.ones((5, 8))),
        "d": nir.Linear(np.ones((5, 10))),
        "e": cuba(5),
        "output": nir.Output(np.array([5])),
    }
    skip = graph("input->a, a->b, b->c, c->e, input->d, d->e, e->output", **nodes)
    artifact = Artifact(skip, None, Convention(1e-3))
    with pytest.raises(ConventionError, match="waits for more"):
        for_importer(artifact, "norse")
    for_importer(artifact, "spikingjelly")


def slow(size):
    neurons = cuba(size)
    neurons.v_leak = np.full(size, 0.1)
    return neurons


def from_below(size):
    neurons = lif(size)
    neurons.v_reset = np.full(size, -0.5)
    return neurons


def mixed(size):
    return nir.LIF(np.linspace(0.01, 0.02, size), *(np.full(size, v) for v in (10.0, 0.0, 1.0)))


REFUSED = {
    "reset": ("snntorch", cuba, {"reset": "subtract"}, "'zero', and these by 'subtract'"),
    "delay": ("norse", cuba, {"delay": 1}, "its delay is 0, that of the network 1"),
    "floor": ("spikingjelly", cuba, {"floor": "zero"}, "its floor is 'none'"),
    "many": ("norse", cuba, {"reset": "subtract", "spikes": "many"}, "its spikes is 'above'"),
    "v_leak": ("norse", slow, {}, "behind a synaptic current"),
    "v_reset": ("snntorch", from_below, {}, "v_reset is not 0"),
    "decays": ("spikingjelly", mixed, {}, "needs one (tau|r) for all neurons"),
    "IF": ("snntorch", lambda n: nir.IF(np.full(n, 1e3), np.ones(n)), {}, "decay factor 0.9"),
    "readout": ("norse", lambda n: nir.LI(*np.full((3, n), 0.01)), {}, "reads no LI"),
    "no decay": ("rockpool", lambda n: cuba(n, 0.0), {}, "reset by 'subtract'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_tool_cannot_express_is_refused_with_the_reason(case):
    tool, neurons, options, reason = REFUSED[case]
    artifact = layered(neurons, Convention(1e-3).with_options(options))
    with pytest.raises(ConventionError, match=reason) as caught:
        for_importer(artifact, tool)
    assert f"--for {tool}: " in str(caught.value)
    assert "without the preset" not in str(caught.value)
    with pytest.raises(ConfigError, match=", ".join(IMPORTERS)):
        for_importer(artifact, "brian2")


def fields(path):
    with h5py.File(path) as file:
        return {field for node in file["node/nodes"].values() for field in node}


def test_releases_without_v_reset_get_none_and_the_policy_stays(tmp_path):
    artifact, path = popsan(), tmp_path / "old.nir"
    save(artifact, path)
    assert "v_reset" in fields(path)
    for release in ("1.0.4", "1.0.5"):
        save(artifact, path, release)
        assert "v_reset" not in fields(path)
        assert load(path).provenance.env == artifact.provenance.env  # its digest agrees
    save(artifact, path, "1.0.6")
    assert "v_reset" in fields(path)


def test_an_old_release_cannot_have_a_reset_of_its_own(tmp_path):
    artifact = layered(from_below)
    with pytest.raises(ArtifactError, match=r"nir 1\.0\.4 has no v_reset"):
        save(artifact, tmp_path / "old.nir", "1.0.4")
    assert not list(tmp_path.iterdir())
    with pytest.raises(ArtifactError, match="was not tried"):
        save(artifact, tmp_path / "old.nir", "0.2")


def test_the_command_writes_and_compares(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save(popsan(), "popsan.nir")
    code, out, _ = command("export", "popsan.nir", "--for", "snntorch", "-o", "s.nir")
    assert (code, out.count("✓")) == (0, 2)
    assert command("export", "popsan.nir", "--for", "snntorch", "-o", "s.nir")[0] == 0  # again
    code, _, err = command("export", "popsan.nir", "--for", "norse", "-o", "popsan.nir")
    assert code == 2
    assert "popsan.nir" in err
