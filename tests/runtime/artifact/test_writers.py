"""Files of other tools as their authors meant them: recorded spikes, and by hand what has none.

tests/golden/exports holds what snnTorch, Norse and SpikingJelly exported and computed
(lab/peers/exported_networks.py); test_peer_exports.py asks the tools themselves.
"""

from itertools import pairwise

import nir
import numpy as np
import pytest

from lab.peers.exported_networks import CASES, FOLDER
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.reading import read_as_written, writer
from spikedeploy.runtime.dialects.tools import WRITERS
from spikedeploy.runtime.errors import ArtifactError, ConventionError, RuleError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, lif, popsan


def full(*values, size=1):
    return [np.full(size, float(value)) for value in values]


def recording(name):
    with np.load(FOLDER / f"{name}.npz") as arrays:
        return arrays["input"], arrays["output"]


def read(name, **options):
    case = CASES[name]
    given = options or case.options
    return load(FOLDER / f"{case.file}.nir", written_by=case.tool, **given)


@pytest.mark.parametrize("name", CASES)
def test_every_recorded_spike_of_the_authors_network_is_ours(name):
    inputs, outputs = recording(name)
    found = FloatGraph(read(name)).run(inputs[None])["output"][0]
    assert 100 < outputs.sum() < 600
    np.testing.assert_array_equal(found, outputs)


@pytest.mark.parametrize("kind", ["leaky", "synaptic"])
def test_what_a_snntorch_file_does_not_say_decides_its_spikes(kind):
    rasters = [recording(f"snntorch_{kind}_{name}")[1] for name in ("default", "zero", "subtract")]
    assert all(np.any(one != two) for one, two in pairwise(rasters))


@pytest.mark.parametrize("name", ["snntorch_leaky_default", "norse_lifcell", "spikingjelly_lif"])
def test_what_the_file_does_not_say_is_named_with_the_option(name):
    said = read(name).convention.describe()
    option = "--dt" if name.startswith("spikingjelly") else "--reset"
    assert "not in the file, so assumed: " in said
    assert option in said


def test_what_was_given_is_not_assumed():
    convention = read("snntorch_leaky_default", reset="zero").convention
    assert convention == Convention(1e-4)
    assert convention.source == "reset given, otherwise as snnTorch 1.0.0 writes it"


def test_norse_misreads_its_own_file_and_from_norse_does_not():
    inputs, outputs = recording("norse_lifboxcell")
    path = FOLDER / "norse_lifboxcell.nir"
    wrong = FloatGraph(load(path, like="norse", dt=5e-6)).run(inputs[None])["output"][0]
    assert np.count_nonzero(wrong != outputs) > 100


@pytest.mark.parametrize("tool", WRITERS)
def test_a_writer_says_where_its_meaning_is_to_be_seen(tool):
    assert writer(tool).source
    assert writer(tool).tool.split()[0].lower() == tool


# by hand, where no recording is


def played(tool, node, *inputs, **given):
    """Spikes of a single neuron behind a weight of 1."""
    whole = chain(nir.Affine(np.eye(1), np.zeros(1)), node, width=1, act=1)
    network, convention = read_as_written(whole, tool, given)
    running = FloatGraph(Artifact(network, None, convention))
    return running.run(np.array(inputs, float)[None, :, None])["n2"].ravel().tolist()


def test_sinabs_normalises_the_input_of_a_lif():
    # exp(-1/tau) = 0.5: V = 0.5 V + 0.5 x: 2.5 -> 2 spikes, 0.5 left
    node = lif(1, tau=1 / np.log(2), r=1.0)
    assert played("sinabs", node, 5.0, 1.5 + 1e-9, 0.0) == [2, 1, 0]
    assert played("sinabs", node, 5.0, 1.5 + 1e-9, 0.0, spikes="reached") == [1, 1, 0]


def test_sinabs_has_a_floor_only_where_it_is_given():
    node = nir.IF(*full(1, 1))
    assert played("sinabs", node, -5, 2, 3.5) == [0, 0, 0]
    assert played("sinabs", node, -5, 2, 3.5, floor="threshold") == [0, 1, 3]


def test_rockpool_says_its_dt_in_r():
    # r = tau exp(-dt/tau)/dt; I = a (I + x), V = b V + I with a = b = 0.5
    dt, tau = np.log(2) * 1e-2, 1e-2
    node = nir.CubaLIF(*full(tau, tau, tau * 0.5 / dt, 0, 1), w_in=np.ones(1))
    whole = chain(nir.Affine(np.eye(1), np.zeros(1)), node, width=1, act=1)
    assert read_as_written(whole, "rockpool")[1].dt == pytest.approx(dt, rel=1e-4)
    # I: 2, 1; V: 2 -> 2 spikes, 0; 1 -> a spike, 0
    assert played("rockpool", node, 4.001, 0, 0) == [2, 1, 0]


def test_lava_delays_by_one_timestep():
    node = cuba(1, alpha=0.0, beta=0.5, dt=1e-4, threshold=1.0)
    assert played("lava", node, 2, 0, 0) == [0, 1, 0]
    assert played("lava", node, 2, 0, 0, delay=0) == [1, 0, 0]
    assert played("lava", node, 1, 0, 0, delay=0, spikes="reached") == [1, 0, 0]


# chips


def test_chips_refuse_a_delayed_reset_by_the_rule_and_say_what_to_do():
    with pytest.raises(RuleError, match=r"rule reset: reset 'subtract-delayed'.*reset_delay=False"):
        compile_program(read("snntorch_leaky_default"), chip("loihi1"))


def test_a_delayed_reset_to_zero_of_leaky_runs_on_chips_because_it_spikes_as_zero_does():
    artifact = read("snntorch_leaky_default", reset="zero-delayed")
    assert artifact.convention.reset == "zero"
    compile_program(artifact, chip("loihi1"))
    assert read("snntorch_synaptic_default", reset="zero-delayed").convention.reset != "zero"


# what is refused


@pytest.mark.parametrize(
    ("tool", "node", "message"),
    [
        ("snntorch", nir.IF(*full(1, 1)), "writes no IF, only Affine"),
        ("snntorch", lif(1, v_leak=1.0), "writes v_leak = 0"),
        ("norse", lif(1, r=10.0), "writes r = 1"),
        ("spikingjelly", nir.LIF(*full(1, 1, 0.5, 1)), "writes v_leak = v_reset"),
        ("sinabs", lif(1, r=2.0), "writes r = 1"),
        ("sinabs", cuba(1), "writes no CubaLIF"),
        ("rockpool", nir.CubaLIF(*full(1, 1, -2, 0, 1)), "above 0"),
        ("lava", lif(1), "writes no LIF"),
    ],
)
def test_what_a_tool_does_not_write_is_refused_by_node(tool, node, message):
    with pytest.raises(ConventionError, match=f"node 'n1': .*{message}.*without --from"):
        read_as_written(chain(node, width=1, act=1), tool)


@pytest.mark.parametrize(
    ("tool", "given", "message"),
    [
        ("snntorch", {"integrator": "exponential"}, "integrator is no choice in snnTorch"),
        ("snntorch", {"reset": "subtract-ahead"}, "nothing that snnTorch 1.0.0 does"),
        ("snntorch", {"dt": 1e-3}, "whatever its network was trained with"),
        ("norse", {"reset": "subtract-delayed"}, "Choose one of 'zero', 'subtract'"),
        ("lava", {"dt": 1e-3}, "the gains of the file say 0.0001 s"),
    ],
)
def test_an_option_that_contradicts_the_tool_is_refused(tool, given, message):
    node = lif(1, 1e-3, 1.0) if tool == "norse" else cuba(1, dt=1e-4)
    with pytest.raises(ConventionError, match=message):
        read_as_written(chain(node, width=1, act=1), tool, given)


def test_layers_of_different_dt_are_not_one_export():
    whole = chain(cuba(1, dt=1e-4), cuba(1, dt=1e-3), cuba(1, dt=1e-3), width=1, act=1)
    with pytest.raises(ConventionError, match=r"'n1': snnTorch 1\.0\.0 writes one dt into all"):
        read_as_written(whole, "snntorch")


def test_a_tool_that_does_not_write_nir_is_refused_with_the_nearest():
    with pytest.raises(ConventionError, match=r"Did you mean 'snntorch'"):
        writer("snn-torch")


def test_one_cannot_read_as_written_and_as_read(tmp_path):
    save(popsan(), tmp_path / "a.nir")
    with pytest.raises(ConventionError, match=r"Give one of them"):
        load(tmp_path / "a.nir", like="norse", written_by="norse")
    with pytest.raises(ConventionError, match=r"spikedeploy wrote this file"):
        load(tmp_path / "a.nir", written_by="norse")


# a batch axis of one


def with_batch(graph, axes=1):
    """The graph with leading axes of 1 at its ports and neurons."""
    nodes = {}
    for name, node in graph.nodes.items():
        if isinstance(node, (nir.Input, nir.Output)):
            shape = [1] * axes + [int(n) for n in node.output_type["output"]]
            nodes[name] = type(node)(np.array(shape))
        elif isinstance(node, nir.CubaLIF):
            fields = ("tau_syn", "tau_mem", "r", "v_leak", "v_threshold", "v_reset", "w_in")
            values = {field: getattr(node, field)[(None,) * axes] for field in fields}
            nodes[name] = nir.CubaLIF(**values)
        else:
            nodes[name] = node
    return nir.NIRGraph(nodes, graph.edges, type_check=False)


@pytest.mark.parametrize("axes", [1, 2])
def test_a_batch_axis_of_one_is_taken_off(tmp_path, axes):
    plain = popsan()
    nir.write(tmp_path / "plain.nir", plain.graph)
    nir.write(tmp_path / "batch.nir", with_batch(plain.graph, axes))
    one, two = (load(tmp_path / f"{name}.nir") for name in ("plain", "batch"))
    raster = np.random.default_rng(0).random((2, 50, 30)) < 0.3
    outputs = [FloatGraph(each).run(raster)["output"] for each in (one, two)]
    assert outputs[0].any()
    np.testing.assert_array_equal(*outputs)


def test_a_single_channel_is_no_batch(tmp_path):
    conv = nir.Conv1d(8, np.ones((1, 1, 3)), 1, 0, 1, 1, np.zeros(1))
    neurons = nir.IF(*(np.ones((1, 6)) for _ in range(2)))
    ends = {"input": nir.Input(np.array([1, 8])), "output": nir.Output(np.array([1, 6]))}
    edges = [("input", "c"), ("c", "n"), ("n", "output")]
    nir.write(tmp_path / "a.nir", nir.NIRGraph({**ends, "c": conv, "n": neurons}, edges))
    graph = load(tmp_path / "a.nir", dt=1.0).graph
    assert graph.nodes["n"].r.shape == (1, 6)


def test_a_batch_of_two_is_still_refused(tmp_path):
    whole = chain(nir.Affine(np.eye(2), np.zeros(2)), cuba(2), width=2, act=2)
    whole.nodes["input"] = nir.Input(np.array([2, 2]))
    nir.write(tmp_path / "a.nir", nir.NIRGraph(whole.nodes, whole.edges, type_check=False))
    with pytest.raises(ArtifactError, match="input"):
        load(tmp_path / "a.nir")
