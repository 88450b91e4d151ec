"""Readout layers: neurons without a threshold whose membranes leave a chip, or run on the host."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.metrics.traffic import host_work
from tests.networks import chain, cuba
from tests.readouts import ACTIONS, DT, HIDDEN, INPUTS, KINDS, cubali, events, li, network

LOIHI = ("loihi1", "loihi1-nengo", "int")
STATES = ("kept", "reset")


def backends(program):
    """Machines of every backend that runs the program."""
    names = ("interpreter", "numpy", "numba")
    if program.chip.name in ("loihi1-nengo", "ideal", "spinnaker2", "xylo-a2", "odin"):
        names = names[:2]
    return {name: Machine(program, 3, backend=name) for name in names}


def one_neuron(node):
    """input (2) -> weights 1 and 0.3 -> the node."""
    network = chain(nir.Linear(np.array([[1.0, 0.3]])), node, width=2, act=1)
    return Artifact(network, None, Convention(DT, state="kept"))


def test_a_leaky_readout_on_loihi_by_hand():
    program = compile_program(one_neuron(li(0.5)), chip("loihi1"))
    (layer,) = program.layers
    # 255 for the weight of 1, and 76 for 0.3 (76.5, half to even). No more than 1.3 arrives in a
    # timestep, which adds up to 2.6; half of 24 bits hold 4,194,303 / (2.6 * 255 * 64) = 98 times
    # that, so the exponent is 6: weights are 255 * 64 and 76 * 64, states 64 times as much.
    assert layer.synapses[0].weight[:, 0].tolist() == [255 * 64, 76 * 64]
    machine = Machine(program, trace=True)
    rows = np.array([[[1, 0], [0, 1], [0, 0], [1, 1]]], np.uint8)
    output = machine.infer(rows)
    # v = v / 2 + w:  1044480, 522240 + 311296, 416768, 208384 + 1355776
    assert machine.recordings["n2"].membrane[0, :, 0].tolist() == [1044480, 833536, 416768, 1564160]
    np.testing.assert_allclose(
        output[0, :, 0], np.array([1044480, 833536, 416768, 1564160]) / 1044480
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("name", LOIHI)
def test_backends_agree_in_every_bit_and_count(kind, state, name):
    machines = backends(compile_program(network(kind, state), chip(name)))
    outputs = {each: machine.infer(events()) for each, machine in machines.items()}
    for each, machine in machines.items():
        np.testing.assert_array_equal(outputs[each], outputs["interpreter"])
        np.testing.assert_array_equal(
            machine.ledger.counts, machines["interpreter"].ledger.counts, each
        )


def windows(machine, raster, size):
    return np.concatenate(
        [machine.infer(raster[:, t : t + size]) for t in range(0, raster.shape[1], size)], axis=1
    )


@pytest.mark.parametrize("kind", ["same", "second", "only"])
@pytest.mark.parametrize("name", ["loihi1", "ideal", "loihi1:membrane_output=none"])
def test_states_live_on_from_one_timestep_to_the_next(kind, name):
    if kind == "only" and "none" in name:
        pytest.skip("nothing is left for the chip")
    program = compile_program(network(kind), chip(name), clock="gated")
    whole = Machine(program, 3).infer(events())
    for machine in backends(program).values():
        np.testing.assert_allclose(windows(machine, events(), 1), whole, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["same", "second", "two layers"])
@pytest.mark.parametrize("name", ["loihi1", "ideal", "loihi1:membrane_output=none"])
def test_steps_of_the_chip_give_the_rows_of_a_window_later(kind, name):
    program = compile_program(network(kind), chip(name))
    whole = Machine(program, 3).infer(events())
    late = max(program.layer(layer).start for layer in program.output_layers)
    for machine in backends(program).values():
        rows = np.stack([machine.step(row).copy() for row in events().swapaxes(0, 1)], axis=1)
        np.testing.assert_allclose(rows[:, late:], whole[:, : 25 - late], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "name"),
    [(kind, "ideal") for kind in KINDS]
    + [(k, "ideal:membrane_output=none") for k in ("none", "same", "second", "two layers")],
)
@pytest.mark.parametrize("state", STATES)
def test_the_ideal_chip_and_the_host_behind_it_integrate_as_the_float_twin_does(kind, name, state):
    # the chip rounds nothing here, so that the host is all that can differ
    artifact = network(kind, state)
    program = compile_program(artifact, chip(name))
    of_host = ("fast", "readout") if "none" in name else ()
    found = [layer.name for layer in program.host]
    assert found == [name for name in of_host if name in artifact.graph.nodes]
    wanted = FloatGraph(artifact).run(events())["output"]
    for machine in backends(program).values():
        np.testing.assert_allclose(machine.infer(events()), wanted, rtol=0, atol=1e-12)


def test_the_host_adds_up_the_spikes_of_the_chip():
    # by itself: V = b V + W s of the spikes that the chip sent
    artifact = network("none", neurons="LIF")
    program = compile_program(artifact, chip("spiker"))
    machine = Machine(program, 3, trace=True)
    found = machine.infer(events())
    spikes = machine.recordings["hidden"].spikes.astype(float)
    nodes = artifact.graph.nodes
    decay_factor = 1 - DT / nodes["readout"].tau
    membrane, rows = np.zeros((3, ACTIONS)), []
    for t in range(25):
        membrane = decay_factor * membrane + spikes[:, t] @ nodes["w2"].weight.T
        rows.append(membrane + nodes["affine"].bias)
    np.testing.assert_allclose(found, np.stack(rows, 1), rtol=0, atol=1e-12)
    assert spikes.any()


@pytest.mark.parametrize(
    ("name", "neurons"), [("truenorth", "IF"), ("odin", "IF"), ("spiker", "LIF"), ("speck2f", "IF")]
)
def test_chips_without_a_way_out_leave_readouts_to_the_host_and_say_so(name, neurons):
    program = compile_program(network("same", neurons=neurons), chip(name), limits=False)
    (remark,) = [each for each in program.remarks if "the host integrates it" in each]
    assert "'readout': membranes do not leave" in remark
    assert f"{ACTIONS} multiplications in each timestep" in remark
    assert "additions for each spike of 'input'" in remark
    assert "additions for each spike of 'hidden'" in remark
    machine = Machine(program, 3, trace=True)
    output = machine.infer(events())
    assert np.ptp(output) > 0
    # of 3 x 25 timesteps: a product for each readout; additions by the synapses of each spike
    spikes = {"input": events(), "hidden": machine.recordings["hidden"].spikes}
    work = host_work(program, spikes)
    assert work["multiplications"] == 75 * ACTIONS
    assert work["additions"] == sum(
        (spikes[s.source].sum(axis=(0, 1)) * np.count_nonzero(s.weight, axis=1)).sum()
        for s in program.host[0].synapses
    )


def test_what_the_host_needs_leaves_the_chip_as_messages():
    artifact = network("none")
    spikes = Machine(compile_program(artifact, chip("ideal")), 3)
    host = Machine(compile_program(artifact, chip("ideal", membrane_output="none")), 3)
    spikes.infer(events())
    host.infer(events())
    one, other = spikes.ledger, host.ledger
    # the hidden spikes go to the host, and not to the readout; 3 membranes in each of 75 timesteps
    assert other.by_layer("message") == {
        "hidden": one.by_layer("message")["hidden"] + one.by_layer("spike_out")["hidden"]
    }
    assert one.by_layer("message")["readout"] == (
        one.by_layer("spike_out")["hidden"] + ACTIONS * 3 * 25
    )


@pytest.mark.parametrize("name", ["ideal", "loihi1", "int"])
def test_readouts_never_spike_and_do_not_flatter_the_sparsity(name):
    machine = Machine(compile_program(network("second"), chip(name), clock="gated"), 3)
    machine.infer(events())
    ledger = machine.ledger
    spikes = ledger.by_layer("spike_out")
    assert spikes["hidden"] > 0
    assert spikes["readout"] == spikes["fast"] == 0
    assert ledger.readouts == ("fast", "readout") or ledger.readouts == ("readout", "fast")
    assert ledger.sparsity == 1 - spikes["hidden"] / (HIDDEN * 3 * 25)
    assert ledger.by_layer("sop")["fast"] > 0
    assert ledger.by_layer("neuron_update")["fast"] > 0


def test_without_a_neuron_that_spikes_there_is_no_sparsity():
    machine = Machine(compile_program(network("only"), chip("loihi1")), 3)
    machine.infer(events())
    assert machine.ledger.sparsity is None


def test_outputs_of_xylo_are_scaled_back_to_float():
    nodes = [nir.Linear(4 * np.eye(INPUTS)), cuba(INPUTS, 0.5, 0.5, threshold=3.0)]
    weight = np.zeros((2, INPUTS))
    weight[0, 0], weight[1, 1] = 1.0, -0.5
    artifact = Artifact(
        chain(*nodes, nir.Linear(weight), cubali(2, 0.5, 0.75), width=INPUTS, act=2),
        None,
        Convention(DT, "subtract", spikes="many"),
    )
    program = compile_program(artifact, chip("xylo-a2"))
    raster = np.zeros((1, 12, INPUTS), np.uint8)
    raster[0, 1, :2] = 1
    machine = Machine(program, trace=True)
    found = machine.infer(raster)
    assert machine.recordings["n2"].spikes.any()
    assert found[0, :, 0].max() > 0
    np.testing.assert_allclose(found[0, :, 1], -found[0, :, 0] / 2, atol=0.05)


def test_xylo_refuses_a_skip_to_its_outputs():
    with pytest.raises(RuleError, match=r"^rule outputs: layer 'readout' is no output population"):
        compile_program(network("same", reset="subtract"), chip("xylo-a2"))


def test_a_network_that_the_host_would_compute_alone_is_refused():
    with pytest.raises(RuleError, match="no neuron of the network spikes, and membranes do not"):
        compile_program(network("only"), chip("loihi1", membrane_output="none"))


def test_spinnaker_says_how_a_long_skip_can_run():
    with pytest.raises(RuleError, match=r"at most 1\. .* membrane_output=none"):
        compile_program(network("same"), chip("spinnaker2"))
    assert compile_program(network("same"), chip("spinnaker2", membrane_output="none")).host


@pytest.mark.parametrize("name", ["loihi1", "int", "loihi1-nengo"])
def test_an_overflow_is_counted_and_told(name):
    artifact = one_neuron(cubali(1))
    program = compile_program(artifact, chip(name))
    remark = program.remarks[-1]
    room = int(remark.split("hold ")[1].split()[0])
    assert room >= 64
    for spikes, over in ((room, False), (2 * room + 2, True)):
        raster = np.zeros((1, spikes, 2), np.uint8)
        raster[..., 0] = 1
        for backend in ("interpreter", "numpy"):
            machine = Machine(program, backend=backend)
            machine.infer(raster)
            assert (machine.ledger.total("saturation") > 0) == over


@pytest.mark.parametrize("state", STATES)
def test_a_readout_behind_a_delay_of_the_convention_comes_late(state):
    artifact = network("none", state)
    late = Artifact(artifact.graph, None, Convention(DT, delay=1, state=state))
    wanted = FloatGraph(late).run(events())["output"]
    for backend in ("interpreter", "numpy"):
        machine = Machine(compile_program(late, chip("ideal")), 3, backend=backend)
        found = machine.infer(events()) if state == "reset" else windows(machine, events(), 5)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
