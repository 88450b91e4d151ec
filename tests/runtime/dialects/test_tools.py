"""What other tools make of a file, and mean by one of theirs, by hand and by recorded spikes.

test_peers.py and test_peer_exports.py ask the tools themselves. tests/golden/exports holds what
snnTorch, Norse and SpikingJelly exported and computed (lab/peers/exported_networks.py).
"""

import math
from dataclasses import replace

import nir
import numpy as np
import pytest

from lab.peers.exported_networks import CASES as RECORDED
from lab.peers.exported_networks import FOLDER
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.reading import preset, read_as_written, read_like, writer
from spikedeploy.runtime.dialects.tools import WRITERS
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ArtifactError, ConventionError, RuleError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.discretisation import discretise
from tests.networks import chain, cuba, lif, popsan

# tau in timesteps for which exp(-1/tau) = 0.5
HALF = 1 / math.log(2)


def full(*values, size=1):
    return [np.full(size, float(value)) for value in values]


def played(read, tool, node, inputs, given):
    """Spikes and output of a single neuron behind a weight of 1."""
    whole = chain(nir.Affine(np.eye(1), np.zeros(1)), node, width=1, act=1)
    network, convention = read(whole, tool, given)
    trace = FloatGraph(Artifact(network, None, convention)).run(
        np.array(inputs, float)[None, :, None]
    )
    return trace["n2"].ravel().tolist(), trace["output"].ravel().tolist()


def rockpool_neuron(v_leak=0.0):
    """dt = tau/(1 + r) is then half a life of both time constants."""
    return nir.CubaLIF(*full(HALF, HALF, HALF - 1, v_leak, 1), w_in=np.array([77.0]))


HALVING = cuba(1, alpha=0.0, beta=0.5, dt=1e-3, threshold=1.0)
# nengo's synapse keeps a half, as its membrane does
SLOW = nir.CubaLIF(*full(2e-3, 1e-3 * HALF, 2, 0, 1), w_in=np.array([2.0]))
READ = {
    # V = 0.5 V + 0.5 x: 0.8, 1.2 -> spike; as NIR means it, V = 0.5 V + 5 x
    "norse leaves r of a LIF out": (
        ("norse", lif(1, tau=2e-3, r=10.0), {}), (1.6, 1.6, 0), [0, 1, 0]),
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
# r = tau exp(-dt/tau)/dt; I = a (I + x), V = b V + I with a = b = 0.5
ROCKPOOL = nir.CubaLIF(*full(1e-2, 1e-2, HALF * 0.5, 0, 1), w_in=np.ones(1))
DELAYED = cuba(1, alpha=0.0, beta=0.5, dt=1e-4, threshold=1.0)
WRITTEN = {
    # exp(-1/tau) = 0.5: V = 0.5 V + 0.5 x: 2.5 -> 2 spikes, 0.5 left
    "sinabs normalises the input of a LIF": (
        ("sinabs", lif(1, tau=HALF, r=1.0), {}), (5.0, 1.5 + 1e-9, 0.0), [2, 1, 0]),
    "sinabs with single spikes": (
        ("sinabs", lif(1, tau=HALF, r=1.0), {"spikes": "reached"}),
        (5.0, 1.5 + 1e-9, 0.0), [1, 1, 0]),
    "sinabs has no floor": (("sinabs", nir.IF(*full(1, 1)), {}), (-5, 2, 3.5), [0, 0, 0]),
    "sinabs has a floor where it is given": (
        ("sinabs", nir.IF(*full(1, 1)), {"floor": "threshold"}), (-5, 2, 3.5), [0, 1, 3]),
    # I: 2, 1; V: 2 -> 2 spikes, 0; 1 -> a spike, 0
    "rockpool decays what arrives": (("rockpool", ROCKPOOL, {}), (4.001, 0, 0), [2, 1, 0]),
    "lava delays by one timestep": (("lava", DELAYED, {}), (2, 0, 0), [0, 1, 0]),
    "lava-dl does not": (("lava", DELAYED, {"delay": 0}), (2, 0, 0), [1, 0, 0]),
    "lava-dl fires at the threshold": (
        ("lava", DELAYED, {"delay": 0, "spikes": "reached"}), (1, 0, 0), [1, 0, 0]),
}  # fmt: skip
BY_HAND = [
    pytest.param(read, *case, id=name)
    for read, cases in ((read_like, READ), (read_as_written, WRITTEN))
    for name, case in cases.items()
]


@pytest.mark.parametrize(("read", "named", "inputs", "wanted"), BY_HAND)
def test_a_neuron_spikes_as_its_tool_has_it(read, named, inputs, wanted):
    tool, node, given = named
    assert played(read, tool, node, inputs, given)[0] == wanted


def test_nengo_holds_membranes_at_0_and_sends_spikes_as_high_as_1_over_dt():
    # V = 0.5 V + 0.5 x: -5 -> 0; 0.9; 0.45 + 0.9 -> spike
    node = lif(1, tau=1e-3 * HALF, r=1.0)
    found, output = played(read_like, "nengo", node, (-10, 1.8, 1.8), {})
    assert (found, output) == ([0, 0, 1], [0, 0, 1000])


def test_rockpool_gives_every_layer_a_timestep_of_its_own():
    slow = nir.CubaLIF(*full(10 * HALF, 10 * HALF, HALF - 1, 0, 1))
    network = chain(rockpool_neuron(), slow, width=1, act=1)
    changed, convention = read_like(network, "rockpool")
    assert convention.dt == pytest.approx(1.0)
    np.testing.assert_allclose(changed.nodes["n2"].tau_mem, HALF)
    assert network.nodes["n2"].tau_mem == 10 * HALF  # and leaves the graph as it was


@pytest.mark.parametrize("tool", ["norse", "spikingjelly", "lava", "snntorch"])
def test_tools_of_the_usual_discretisation_agree_but_for_what_they_state(tool):
    # gains of 1 at their dt: what their importers change is then nothing
    rng = np.random.default_rng(0)
    nodes = [nir.Linear(2 * rng.normal(size=(12, 6)) / 6**0.5), cuba(12, dt=1e-4, threshold=1.0)]
    network = chain(*nodes, width=6, act=12)
    raster = rng.random((2, 40, 6)) < 0.3
    changed, convention = read_like(network, tool, {"dt": 1e-4} if tool == "norse" else {})
    found = FloatGraph(Artifact(changed, None, convention)).run(raster)
    plain = FloatGraph(Artifact(network, None, Convention(1e-4, delay=convention.delay)))
    np.testing.assert_array_equal(found["n2"], plain.run(raster)["n2"])


# files


def recorded(name, **options):
    case = RECORDED[name]
    return load(
        FOLDER / f"{case.file}.nir", **{"written_by": case.tool, **(options or case.options)}
    )


@pytest.mark.parametrize("name", RECORDED)
def test_every_recorded_spike_of_the_authors_network_is_ours(name):
    with np.load(FOLDER / f"{name}.npz") as arrays:
        inputs, outputs = arrays["input"], arrays["output"]
    artifact = recorded(name)
    assert 100 < outputs.sum() < 800
    np.testing.assert_array_equal(FloatGraph(artifact).run(inputs[None])["output"][0], outputs)


# networks that users of the tools wrote, with what the tools computed
TOLD = [
    # Linear(16, 20), RLeaky(20), Linear(20, 4), Leaky(4), reset_mechanism="zero"
    ("snntorch_rleaky_leaky", "snntorch", {"reset": "zero-delayed"}, 29),
    # Leaky of beta = 0, whose tau in float32 is below dt
    ("snntorch_memoryless", "snntorch", {}, 68),
    # Linear(8, 12), IAFSqueeze(min_v_mem=-1), Linear(12, 3), IAFSqueeze
    ("sinabs_iaf_min", "sinabs", {"floor": "threshold"}, 113),
    # Linear(6, 5) and a LIF whose parameters are one number, or arrays of one; NumPy in float32
    ("scalar_neurons", None, {"dt": 1e-3, "reset": "zero"}, 34),
    ("scalar_neurons", "snntorch", {"reset": "zero"}, 34),
    ("scalar_neurons_size1", None, {"dt": 1e-3, "reset": "zero"}, 34),
    ("scalar_neurons_size1", "snntorch", {"reset": "zero"}, 34),
]


@pytest.mark.parametrize(("name", "tool", "given", "spikes"), TOLD)
def test_a_network_of_a_user_spikes_as_the_tool_said(name, tool, given, spikes):
    with np.load(FOLDER / f"{name}.npz") as arrays:
        inputs, outputs = arrays["input"], arrays["output"]
    assert outputs.sum() == spikes
    artifact = load(FOLDER / f"{name}.nir", written_by=tool, **given)
    np.testing.assert_array_equal(FloatGraph(artifact).run(inputs[None])["output"][0], outputs)


def test_an_rsynaptic_resets_late_whatever_it_was_told():
    # its forward subtracts from a variable of its own with reset_delay=False
    late = recorded("snntorch_rsynaptic_default", reset="zero").convention
    assert late.reset == "zero-delayed"
    assert recorded("snntorch_rsynaptic_default", reset="subtract").convention.reset == (
        "subtract-delayed"
    )
    loop = {"1.lif": cuba(1, dt=1e-4), "1.w_rec": nir.Linear(np.eye(1))}
    whole = chain(loop["1.lif"], cuba(1, dt=1e-4), width=1, act=1)
    nodes = {**whole.nodes, "w_rec": loop["1.w_rec"]}
    edges = [*whole.edges, ("n1", "w_rec"), ("w_rec", "n1")]
    mixed = nir.NIRGraph(nodes, edges, type_check=False)
    for reset in ("zero", "subtract"):
        with pytest.raises(
            ConventionError, match=r"node 'n1': .* resets an RSynaptic one timestep"
        ):
            read_as_written(mixed, "snntorch", {"reset": reset})


@pytest.mark.parametrize(("tau", "decay"), [(1 - 4e-8, 0.0), (1 + 4e-8, 0.0), (1 + 1e-5, 1e-5)])
@pytest.mark.parametrize("field", ["tau_syn", "tau_mem"])
def test_a_tau_of_dt_but_for_the_rounding_of_float32_forgets_at_once(tau, decay, field):
    one = dict.fromkeys(("tau_syn", "tau_mem", "r", "w_in", "v_threshold"), np.ones(1, np.float32))
    node = nir.CubaLIF(**{**one, field: np.float32([tau])}, v_leak=np.zeros(1, np.float32))
    found = discretise("n", node, Convention(1.0))
    name = {"tau_syn": "current_decay", "tau_mem": "membrane_decay"}[field]
    assert getattr(found, name) == pytest.approx(decay, rel=0.05)


@pytest.mark.parametrize(
    ("name", "option"),
    [("snntorch_leaky_default", "--reset"), ("norse_lifcell", "--reset"),
     ("spikingjelly_lif", "--dt")],
)  # fmt: skip
def test_what_the_file_does_not_say_is_named_with_the_option(name, option):
    said = recorded(name).convention.describe()
    assert "not in the file, so assumed: " in said
    assert option in said


def test_what_was_given_is_not_assumed():
    convention = recorded("snntorch_leaky_default", reset="zero").convention
    assert convention == Convention(1e-4)
    assert convention.source == (
        "reset given, otherwise as snnTorch 1.0.0 writes it; not in the file, so assumed: "
        "graded_spikes_factor 1, no inhibition and no state_quant"
    )


def test_our_file_read_like_a_tool_keeps_its_codec_and_loses_its_provenance(tmp_path):
    artifact = popsan()
    save(artifact, tmp_path / "a.nir")
    back = load(tmp_path / "a.nir", like="norse", dt=1e-3, reset="subtract")
    assert back.convention == Convention(1e-3, reset="subtract")
    assert "otherwise as Norse 1.1.0 reads it" in back.convention.describe()
    assert (back.codec.timesteps, back.provenance) == (artifact.codec.timesteps, None)


def test_a_convention_of_many_spikes_survives_its_file(tmp_path):
    network, convention = read_like(chain(nir.IF(*full(1, 1)), width=1, act=1), "sinabs")
    save(Artifact(network, None, convention), tmp_path / "a.nir")
    back = load(tmp_path / "a.nir").convention
    assert (back, back.source) == (convention, convention.source)
    assert "spikes=many, floor=threshold" in back.describe()


def test_one_cannot_read_as_written_and_as_read(tmp_path):
    save(popsan(), tmp_path / "a.nir")
    with pytest.raises(ConventionError, match=r"Give one of them"):
        load(tmp_path / "a.nir", like="norse", written_by="norse")
    with pytest.raises(ConventionError, match=r"spikedeploy wrote this file"):
        load(tmp_path / "a.nir", written_by="norse")


def test_a_delayed_reset_of_leaky_runs_on_chips_where_it_spikes_as_zero_does():
    artifact = recorded("snntorch_leaky_default", reset="zero-delayed")
    assert artifact.convention.reset == "zero"
    compile_program(artifact, chip("loihi1"))
    assert recorded("snntorch_synaptic_default", reset="zero-delayed").convention.reset != "zero"
    with pytest.raises(RuleError, match=r"rule reset: reset 'subtract-delayed'.*Train with"):
        compile_program(recorded("snntorch_leaky_default"), chip("loihi1"))


def test_a_leaky_without_a_leak_is_an_integrator_that_speck_takes(tmp_path):
    # beta = 1 makes tau = dt/(1 - beta) and r = tau/dt infinite
    endless = nir.LIF(*full(np.inf, np.inf, 0, 1), v_reset=np.zeros(1))
    nir.write(tmp_path / "a.nir", chain(nir.Linear(np.array([[0.4]])), endless, width=1, act=1))
    artifact = load(tmp_path / "a.nir", written_by="snntorch", reset="zero")
    spikes = FloatGraph(artifact).run(np.ones((1, 7, 1)))["n2"].ravel()
    assert spikes.tolist() == [0, 0, 1, 0, 0, 1, 0]  # 0.4, 0.8, 1.2
    compile_program(artifact, chip("speck2f:queue=on"))
    default = load(tmp_path / "a.nir", written_by="snntorch")
    assert default.convention.reset == "subtract"
    compile_program(default, chip("speck2f"))
    subtracts = load(tmp_path / "a.nir", written_by="snntorch", reset="subtract")
    with pytest.raises(RuleError, match=r"'subtract-ahead'.*Train with"):
        compile_program(subtracts, chip("speck2f"))
    with pytest.raises(ArtifactError, match=r"'n2': r holds inf.*--from snntorch"):
        load(tmp_path / "a.nir")


def test_the_default_subtraction_of_integrators_is_the_one_of_chips(tmp_path):
    weight = np.random.default_rng(0).normal(size=(8, 8))
    endless = nir.LIF(*(np.full(8, value) for value in (np.inf, np.inf, 0.0, 1.0, 0.0)))
    nir.write(tmp_path / "a.nir", chain(nir.Linear(weight), endless, width=8, act=8))
    artifact = load(tmp_path / "a.nir", written_by="snntorch")
    delayed = replace(artifact, convention=replace(artifact.convention, reset="subtract-delayed"))
    raster = np.random.default_rng(1).random((4, 200, 8)) < 0.3
    found = [FloatGraph(each).run(raster)["output"] for each in (artifact, delayed)]
    assert found[0].sum() > 500
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("kind", ["leaky", "synaptic"])
def test_neurons_of_snntorch_that_subtract_at_once_run_on_chips_that_subtract(kind):
    artifact = recorded(f"snntorch_{kind}_at_once")
    with np.load(FOLDER / f"snntorch_{kind}_at_once.npz") as arrays:
        inputs, outputs = arrays["input"], arrays["output"]
    ideal = Machine(compile_program(artifact, chip("ideal")), 1)
    np.testing.assert_array_equal(ideal.infer(inputs[None])[0], outputs)
    xylo = Machine(compile_program(artifact, chip("xylo-a2")), 1)  # its limits kept
    assert (xylo.infer(inputs[None])[0] != outputs).mean() < 0.2  # weights of 8 bits


# what files leave out, tool by tool: read, or an assumption with its words, or refused with them

FULL = np.ones(1)
MEANINGS = {
    ("snntorch", "initial state"): ("refused", lif(1, v_leak=0.5), "writes v_leak = 0"),
    ("snntorch", "reset"): ("assumed", cuba(1, dt=1e-4), "--reset zero or subtract if yours"),
    ("snntorch", "decay 0"): ("read", lif(1, tau=1e-4 * (1 - 4e-8), r=1.0), 0.0),
    ("snntorch", "height of spikes"): ("assumed", cuba(1, dt=1e-4), "graded_spikes_factor 1"),
    ("snntorch", "floor"): ("none", cuba(1, dt=1e-4), "none"),
    ("norse", "initial state"): ("read", lif(1, tau=1e-5, r=1.0, v_leak=0.5), 0.9),
    ("norse", "reset"): ("assumed", lif(1, tau=1e-5, r=1.0), "--reset subtract if reset_method"),
    ("norse", "decay 0"): ("read", lif(1, tau=1e-6 * (1 - 4e-8), r=1.0), 0.0),
    ("norse", "floor"): ("none", lif(1, tau=1e-5, r=1.0), "none"),
    ("spikingjelly", "initial state"): (
        "read", nir.LIF(*full(1e-3, 1, -0.5, 1), v_reset=np.full(1, -0.5)), 0.9),
    ("spikingjelly", "reset"): ("none", lif(1, tau=1e-3, r=1.0), "zero"),
    ("spikingjelly", "decay 0"): ("read", cuba(1, dt=1e-4, alpha=0.5, beta=0.0), 0.0),
    ("spikingjelly", "floor"): ("none", lif(1, tau=1e-3, r=1.0), "none"),
    ("sinabs", "initial state"): ("refused", lif(1, tau=9.0, r=1.0, v_leak=0.5), "v_leak = 0"),
    ("sinabs", "reset"): ("assumed", nir.IF(FULL, FULL), "--reset zero for MembraneReset"),
    ("sinabs", "height of spikes"): ("assumed", nir.IF(FULL, FULL), "--spikes reached for Single"),
    ("sinabs", "floor"): ("assumed", nir.IF(FULL, FULL), "--floor threshold for min_v_mem"),
    ("rockpool", "initial state"): (
        "refused", nir.CubaLIF(*full(1, 1, 1, 0.5, 1)), "writes v_leak = 0"),
    ("rockpool", "reset"): ("none", ROCKPOOL, "subtract"),
    ("rockpool", "recurrence"): ("assumed", ROCKPOOL, "no recurrent weights"),
    ("rockpool", "floor"): ("none", ROCKPOOL, "none"),
    ("lava", "initial state"): ("refused", nir.CubaLIF(*full(1, 1, 1, 0.5, 1)), "v_leak = 0"),
    ("lava", "reset"): ("none", DELAYED, "zero"),
    ("lava", "decay 0"): ("read", cuba(1, dt=1e-4, alpha=0.5, beta=0.0), 0.0),
    ("lava", "height of spikes"): ("assumed", DELAYED, "--spikes reached for lava-dl"),
    ("lava", "floor"): ("none", DELAYED, "none"),
}  # fmt: skip


def test_every_tool_that_writes_files_stands_in_the_table():
    assert {tool for tool, _ in MEANINGS} == set(WRITERS)


@pytest.mark.parametrize(("tool", "meaning"), MEANINGS)
def test_what_a_file_leaves_out_is_read_or_assumed_or_refused(tool, meaning):
    how, node, told = MEANINGS[tool, meaning]
    network = chain(nir.Affine(np.eye(1), np.zeros(1)), node, width=1, act=1)
    if how == "refused":
        with pytest.raises(ConventionError, match=told):
            read_as_written(network, tool)
        return
    graph, convention = read_as_written(network, tool)
    if how == "assumed":
        assert told in convention.source.partition("not in the file, so assumed: ")[2]
        options = [option for option in WRITERS[tool].open if f"--{option} " in told]
        # what an option chooses is tried by `check --against`
        assert len(options) == told.startswith("--")
    elif how == "none":
        assert told in (convention.reset, convention.floor)
        assert meaning not in WRITERS[tool].open
    else:
        found = discretise("n2", graph.nodes["n2"], convention)
        assert found.membrane_decay == pytest.approx(told)
        if meaning == "initial state":
            # starts where it leaks to, and stays there
            assert (found.leak, found.threshold) == (0, 1 - float(node.v_leak[0]))


# what is refused

REFUSED = [
    (read_like, "snntorch", nir.IF(*full(1, 1)), "reads IF as a leaky neuron of decay factor 0.9"),
    (read_like, "snntorch", cuba(1, dt=1e-3), "needs r = tau_mem/dt, dt being 0.0001 s always"),
    (read_like, "snntorch", lif(1, v_leak=1.0), "needs v_leak = 0"),
    (read_like, "snntorch", nir.LI(*full(1, 1, 0)), "reads no LI, only Affine"),
    (read_like, "norse", nir.CubaLIF(*full(1, 1, 1, 1, 2)), "would add v_leak to the synapse"),
    (read_like, "spikingjelly", lif(1, tau=1e-3, r=5.0), "needs r = 1 or tau/dt"),
    (read_like, "spikingjelly", nir.IF(*full(1, 1)), "needs r = 1/dt = 10000"),
    (read_like, "spikingjelly", cuba(1, dt=1e-3), "needs r = tau_mem/dt"),
    (read_like, "sinabs", cuba(1), "reads no CubaLIF"),
    (read_like, "rockpool", nir.CubaLIF(*full(1, 1, -2, 0, 1)), "is not above 0"),
    (read_like, "nengo", lif(1, r=2.0), "needs r = 1"),
    (read_like, "lava", nir.Affine(np.eye(1), np.ones(1)), "reads no bias"),
    (read_like, "lava", cuba(1, dt=1e-3), "needs r = tau_mem/dt"),
    (read_as_written, "snntorch", nir.IF(*full(1, 1)), "writes no IF, but a Leaky"),
    (read_as_written, "snntorch", lif(1, v_leak=1.0), "writes v_leak = 0"),
    *(
        (read_as_written, tool, node, f"writes one dt above 0 into all gains; here they say {said}")
        for tool, node, said in (
            ("snntorch", lif(1, r=0.0), "inf s"),
            ("snntorch", nir.CubaLIF(*full(1, 1, 0, 0, 1)), "inf s"),
            ("snntorch", lif(1, r=-1.0), "-"),
            ("spikingjelly", lif(1, r=0.0), "inf s"),
            ("lava", nir.CubaLIF(*full(1, 1, 0, 0, 1)), "inf s"),
        )
    ),
    (read_as_written, "norse", lif(1, r=10.0), "writes r = 1"),
    (read_as_written, "spikingjelly", nir.LIF(*full(1, 1, 0.5, 1)), "writes v_leak = v_reset"),
    (read_as_written, "sinabs", lif(1, r=2.0), "writes r = 1"),
    (read_as_written, "rockpool", nir.CubaLIF(*full(1, 1, -2, 0, 1)), "above 0"),
    (read_as_written, "lava", lif(1), "writes no LIF"),
]


@pytest.mark.parametrize(("read", "tool", "node", "message"), REFUSED)
def test_what_a_tool_does_not_know_is_refused_by_node(read, tool, node, message):
    with pytest.raises(ConventionError, match=f"node 'n1': .*{message}"):
        read(chain(node, width=1, act=1), tool)


def test_layers_that_a_tool_treats_differently_cannot_be_mixed():
    network = chain(nir.IF(*full(1, 1)), lif(1), width=1, act=1)
    for tool in ("sinabs", "nengo"):
        with pytest.raises(ConventionError, match=r"'n1': .*floors the membranes"):
            read_like(network, tool)
    whole = chain(cuba(1, dt=1e-4), cuba(1, dt=1e-3), cuba(1, dt=1e-3), width=1, act=1)
    with pytest.raises(ConventionError, match=r"'n1': snnTorch 1\.0\.0 writes one dt into all"):
        read_as_written(whole, "snntorch")


def test_a_dt_that_snntorch_never_writes_is_said():
    for dt, is_said in ((1e-4, False), (1e-3, True)):
        _, convention = read_as_written(chain(cuba(1, dt=dt), width=1, act=1), "snntorch")
        said = f"but for gains that say dt = {dt:g} s, where it writes 0.0001 s"
        assert (said in convention.source) is is_said


@pytest.mark.parametrize(
    ("read", "tool", "given", "message"),
    [
        (read_like, "snntorch", {"dt": 1e-3}, "dt be chosen; its options are: none"),
        (read_like, "norse", {"integrator": "exponential"}, "its options are: dt, reset"),
        (read_as_written, "snntorch", {"integrator": "euler"}, "is no choice in snnTorch"),
        (read_as_written, "snntorch", {"reset": "subtract-ahead"}, "nothing that snnTorch 1.0.0"),
        (read_as_written, "snntorch", {"dt": 1e-3}, "whatever its network was trained with"),
        (read_as_written, "norse", {"reset": "none"}, "Choose one of 'zero', 'subtract'"),
        (read_as_written, "lava", {"dt": 1e-3}, "the gains of the file say 0.0001 s"),
    ],
)
def test_an_option_that_contradicts_the_tool_is_refused(read, tool, given, message):
    node = lif(1, 1e-3, 1.0) if tool == "norse" else cuba(1, dt=1e-4)
    with pytest.raises(ConventionError, match=message):
        read(chain(node, width=1, act=1), tool, given)


@pytest.mark.parametrize("look_up", [preset, writer])
def test_a_tool_that_is_not_known_is_refused_with_the_nearest(look_up):
    with pytest.raises(ConventionError, match=r"'snn-torch'.*\. Did you mean 'snntorch'"):
        look_up("snn-torch")
