"""What other tools make of the same file, by hand; test_peers.py asks the tools themselves."""

import math

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.reading import preset, read_like
from spikedeploy.runtime.dialects.tools import PRESETS
from spikedeploy.runtime.errors import ConventionError, RuleError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, lif, popsan

# tau in timesteps for which exp(-1/tau) = 0.5
HALF = 1 / math.log(2)


def full(*values, size=1):
    return [np.full(size, float(value)) for value in values]


def played(tool, node, *inputs, **given):
    """Spikes and output of a single neuron behind a weight of 1."""
    whole = chain(nir.Affine(np.eye(1), np.zeros(1)), node, width=1, act=1)
    network, convention = read_like(whole, tool, given)
    running = FloatGraph(Artifact(network, None, convention))
    trace = running.run(np.array(inputs, float)[None, :, None])
    return trace["n2"].ravel().tolist(), trace["output"].ravel().tolist()


def spikes(tool, node, *inputs, **given):
    return played(tool, node, *inputs, **given)[0]


# by hand, a neuron each


def test_norse_leaves_r_of_a_lif_out():
    # V = 0.5 V + 0.5 x: 0.8, 1.2 -> spike
    node = lif(1, tau=2e-3, r=10.0)
    assert spikes("norse", node, 1.6, 1.6, 0) == [0, 1, 0]
    # as NIR means it, V = 0.5 V + 5 x
    found = FloatGraph(Artifact(chain(node, width=1, act=1), None, Convention(1e-3)))
    assert found.run(np.full((1, 2, 1), 1.6))["n1"].ravel().tolist() == [1, 1]


def rockpool_neuron(v_leak=0.0):
    """dt = tau/(1 + r) is then half a life of both time constants."""
    return nir.CubaLIF(*full(HALF, HALF, HALF - 1, v_leak, 1), w_in=np.array([77.0]))


HALVING = cuba(1, alpha=0.0, beta=0.5, dt=1e-3, threshold=1.0)
# nengo's synapse keeps a half, as its membrane does
SLOW = nir.CubaLIF(*full(2e-3, 1e-3 * HALF, 2, 0, 1), w_in=np.array([2.0]))
CASES = {
    "norse adds the input of an IF whatever dt is": (
        ("norse", nir.IF(*full(7, 1)), {"dt": 1e-5}), (0.6, 0.6, 0.6), [0, 1, 0]),
    "norse returns to zero": (("norse", HALVING, {}), (3.5, 0, 0), [1, 0, 0]),
    # 3.5 - 1 = 2.5; 1.25 - 1
    "norse subtracts where it is told to": (
        ("norse", HALVING, {"reset": "subtract"}), (3.5, 0, 0), [1, 1, 0]),
    "spikingjelly fires at the threshold": (
        ("spikingjelly", lif(1, tau=2e-4, r=2.0), {}), (1.0, 0), [1, 0]),
    "snntorch fires above the threshold": (
        ("snntorch", lif(1, tau=2e-4, r=2.0), {}), (1.0, 0), [0, 0]),
    # V = 0.5 V + x with a threshold of 1 / 2.5: 0.3, 0.45 -> spike
    "snntorch puts a gain into the threshold": (
        ("snntorch", lif(1, tau=2e-4, r=5.0), {}), (0.3, 0.3, 0), [0, 1, 0]),
    # V = 0.5 V + x: 2.5 -> 2 spikes, 0.5; 0.25 + 1.75 = 2 -> 2 spikes
    "sinabs counts timesteps and sends many spikes": (
        ("sinabs", lif(1, tau=HALF, r=9.0), {}), (2.5, 1.75 + 1e-9, 0.9), [2, 2, 0]),
    # -5 -> -1; 0.5; 1.5 -> spike
    "sinabs holds integrators above minus the threshold": (
        ("sinabs", nir.IF(*full(3, 1)), {}), (-5, 1.5, 1.0), [0, 0, 1]),
    "sinabs fires at the threshold": (
        ("sinabs", nir.IF(*full(1, 1)), {}), (1, 2, 0.5), [1, 2, 0]),
    # I: 2.2, 1.1, 0.55 | V: 2.2 -> 2, 0.2; 0.1 + 1.1 -> 1, 0.2; 0.1 + 0.55
    "rockpool decays what arrives and sends many spikes": (
        ("rockpool", rockpool_neuron(), {}), (4.4, 0, 0), [2, 1, 0]),
    # V: 0.7, 0.35 + 0.7 -> spike, 0.05
    "rockpool takes v_leak for a bias": (
        ("rockpool", rockpool_neuron(v_leak=0.7), {}), (0, 0, 0), [0, 1, 0]),
    # I: 0, 1.2, 0.6 | V: 0, 1.2 -> spike, 0.6
    "a synapse of nengo delivers one timestep later": (
        ("nengo", SLOW, {}), (1.2, 0, 0), [0, 1, 0]),
    # V: 0, 0.5 * 3 -> spike
    "lava delivers one timestep later and leaves r out": (
        ("lava", lif(1, tau=2e-3, r=8.0), {"dt": 1e-3}), (3, 0, 0), [0, 1, 0]),
}  # fmt: skip


@pytest.mark.parametrize(("read", "inputs", "wanted"), CASES.values(), ids=CASES)
def test_a_neuron_spikes_as_its_tool_would_have_it(read, inputs, wanted):
    tool, node, given = read
    assert spikes(tool, node, *inputs, **given) == wanted


def test_rockpool_gives_every_layer_a_timestep_of_its_own():
    slow = nir.CubaLIF(*full(10 * HALF, 10 * HALF, HALF - 1, 0, 1))
    network = chain(rockpool_neuron(), slow, width=1, act=1)
    changed, convention = read_like(network, "rockpool")
    assert convention.dt == pytest.approx(1.0)
    np.testing.assert_allclose(changed.nodes["n2"].tau_mem, HALF)


def test_nengo_holds_membranes_at_0_and_sends_spikes_as_high_as_1_over_dt():
    # V = 0.5 V + 0.5 x: -5 -> 0; 0.9; 0.45 + 0.9 -> spike
    node = lif(1, tau=1e-3 * HALF, r=1.0)
    found, output = played("nengo", node, -10, 1.8, 1.8)
    assert (found, output) == ([0, 0, 1], [0, 0, 1000])


# tools and files


@pytest.mark.parametrize("tool", PRESETS)
def test_every_preset_names_its_tool_its_source_and_what_it_reads(tool):
    found = preset(tool)
    assert any(digit.isdigit() for digit in found.tool)
    assert found.source
    assert {nir.Affine, nir.CubaLIF} & set(found.kinds)


@pytest.mark.parametrize("tool", ["norse", "spikingjelly", "lava", "snntorch"])
def test_tools_of_the_usual_discretisation_agree_but_for_what_they_state(tool):
    # gains of 1 at their dt: what their importers change is then nothing
    rng = np.random.default_rng(0)
    nodes = [nir.Linear(2 * rng.normal(size=(12, 6)) / 6**0.5), cuba(12, dt=1e-4, threshold=1.0)]
    network = chain(*nodes, width=6, act=12)
    raster = rng.random((2, 40, 6)) < 0.3
    given = {"dt": 1e-4} if tool == "norse" else {}
    changed, convention = read_like(network, tool, given)
    found = FloatGraph(Artifact(changed, None, convention)).run(raster)
    plain = FloatGraph(Artifact(network, None, Convention(1e-4, delay=convention.delay)))
    np.testing.assert_array_equal(found["n2"], plain.run(raster)["n2"])


def test_a_preset_leaves_the_graph_as_it_was():
    node = lif(2, tau=2e-3, r=10.0)
    network = chain(node, width=2, act=2)
    read_like(network, "norse")
    read_like(chain(lif(2, r=1.0), width=2, act=2), "nengo")
    assert (node.r == 10).all()
    assert sorted(network.nodes) == ["input", "n1", "output"]


def test_a_file_whose_timestep_cannot_be_inferred_is_read_like_a_tool(tmp_path):
    nir.write(tmp_path / "a.nir", chain(lif(2, tau=0.0025, r=1.0), width=2, act=2))
    back = load(tmp_path / "a.nir", like="norse", dt=1e-4)
    assert back.convention == Convention(1e-4)
    assert "as Norse 1.1.0 reads it" in back.convention.describe()


def test_our_file_read_like_a_tool_keeps_its_codec_and_loses_its_provenance(tmp_path):
    artifact = popsan()
    save(artifact, tmp_path / "a.nir")
    back = load(tmp_path / "a.nir", like="norse", dt=1e-3, reset="subtract")
    assert back.convention == Convention(1e-3, reset="subtract")
    assert (back.codec.timesteps, back.provenance) == (artifact.codec.timesteps, None)


def test_a_convention_of_many_spikes_survives_its_file(tmp_path):
    node = nir.IF(*full(1, 1))
    network, convention = read_like(chain(node, width=1, act=1), "sinabs")
    save(Artifact(network, None, convention), tmp_path / "a.nir")
    back = load(tmp_path / "a.nir").convention
    assert (back, back.source) == (convention, convention.source)
    assert "spikes=many, floor=threshold" in back.describe()


def test_what_no_chip_does_is_refused_when_it_is_compiled():
    network, convention = read_like(chain(nir.IF(*full(1, 1)), width=1, act=1), "sinabs")
    with pytest.raises(RuleError, match=r"spikes 'many', floor 'threshold': .* Run in float"):
        compile_program(Artifact(network, None, convention), chip("ideal"))


def test_many_spikes_need_something_to_subtract():
    with pytest.raises(ConventionError, match=r"'zero' and spikes 'many' contradict"):
        Convention(1e-3, spikes="many")
    node = nir.IF(*full(1, 0))
    with pytest.raises(ConventionError, match=r"'n1': its threshold is not above v_reset"):
        Artifact(
            chain(node, width=1, act=1), None, Convention(1e-3, reset="subtract", spikes="many")
        )


# what the tools refuse


@pytest.mark.parametrize(
    ("tool", "node", "message"),
    [
        ("snntorch", nir.IF(*full(1, 1)), "reads IF as a leaky neuron of decay factor 0.9"),
        ("snntorch", cuba(1, dt=1e-3), "needs r = tau_mem/dt, dt being 0.0001 s always"),
        ("snntorch", lif(1, v_leak=1.0), "needs v_leak = 0"),
        ("snntorch", nir.LI(*full(1, 1, 0)), "reads no LI, only Affine"),
        ("norse", nir.CubaLIF(*full(1, 1, 1, 1, 2)), "would add v_leak to the synapse"),
        ("spikingjelly", lif(1, tau=1e-3, r=5.0), "needs r = 1 or tau/dt"),
        ("spikingjelly", nir.IF(*full(1, 1)), "needs r = 1/dt = 10000"),
        ("spikingjelly", cuba(1, dt=1e-3), "needs r = tau_mem/dt"),
        ("sinabs", cuba(1), "reads no CubaLIF"),
        ("sinabs", lif(1, v_leak=1.0), "needs v_leak = 0"),
        ("rockpool", lif(1), "reads no LIF, only Affine, Linear, CubaLIF"),
        ("rockpool", nir.CubaLIF(*full(1, 1, -2, 0, 1)), "is not above 0"),
        ("nengo", lif(1, r=2.0), "needs r = 1"),
        ("lava", nir.IF(*full(1, 1)), "reads no IF"),
        ("lava", cuba(1, dt=1e-3), "needs r = tau_mem/dt"),
    ],
)
def test_what_a_tool_refuses_is_refused_by_node(tool, node, message):
    with pytest.raises(ConventionError, match=f"node 'n1': .*{message}"):
        read_like(chain(node, width=1, act=1), tool)


def test_layers_that_a_tool_treats_differently_cannot_be_mixed():
    network = chain(nir.IF(*full(1, 1)), lif(1), width=1, act=1)
    for tool in ("sinabs", "nengo"):
        with pytest.raises(ConventionError, match=r"'n1': .*floors the membranes"):
            read_like(network, tool)


def test_a_bias_is_nothing_that_lava_reads():
    network = chain(nir.Affine(np.eye(1), np.ones(1)), lif(1), width=1, act=1)
    with pytest.raises(ConventionError, match=r"'n1': .* reads no bias"):
        read_like(network, "lava")


@pytest.mark.parametrize(
    ("tool", "given", "offered"),
    [
        ("snntorch", {"dt": 1e-3}, "none"),
        ("spikingjelly", {"reset": "subtract"}, "dt"),
        ("norse", {"integrator": "exponential"}, "dt, reset"),
    ],
)
def test_an_option_that_a_tool_does_not_offer_is_refused(tool, given, offered):
    (option,) = given
    message = f"does not let {option} be chosen; its options are: {offered}"
    with pytest.raises(ConventionError, match=message):
        read_like(chain(lif(1, tau=1e-3), width=1, act=1), tool, given)


def test_a_preset_that_does_not_exist_is_refused_with_the_nearest():
    with pytest.raises(ConventionError, match=r"no preset 'snn-torch'\. Did you mean 'snntorch'"):
        preset("snn-torch")
