"""The clocks gated, pipelined and free: what is equal in them, what is not, and what is counted."""

from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import clock_on, compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ChipError, ConventionError, RuleError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import event_driven, popsan
from tests.readouts import network

BACKENDS = ["interpreter", "numpy", "numba"]


def kept(artifact, **convention):
    return replace(artifact, convention=replace(artifact.convention, state="kept", **convention))


def raster(width, timesteps=12, batch=3):
    return (np.random.default_rng(0).random((batch, timesteps, width)) < 0.3).astype(np.uint8)


def ran(program, rows, backend="numpy"):
    machine = Machine(program, len(rows), trace=True, backend=backend)
    return machine.infer(rows), machine


def test_a_network_runs_in_its_own_clock_where_the_chip_has_it_and_else_free():
    gated = Convention(1e-3)
    assert clock_on(gated, chip("ideal")) == clock_on(gated, chip("spinnaker2")) == "gated"
    assert clock_on(gated, chip("loihi1")) == clock_on(gated, chip("xylo-a2")) == "free"
    assert clock_on(replace(gated, clock="pipelined"), chip("loihi1")) == "pipelined"
    assert clock_on(replace(gated, delay=1), chip("loihi1")) == "pipelined"
    assert clock_on(gated, chip("speck2f")) == "gated"
    with pytest.raises(RuleError, match="rule clock: speck2f advances its layers gated"):
        clock_on(replace(gated, clock="pipelined"), chip("speck2f"))


def test_a_name_asks_for_a_clock_but_does_not_say_what_the_chip_can():
    assert compile_program(popsan(), chip("loihi1:clock=gated")).assumed_clock
    with pytest.raises(ChipError, match="'clocks' cannot be given as text"):
        chip("loihi1:clocks=gated")
    with pytest.raises(ChipError, match="clock 'never' is unknown"):
        chip("loihi1:clock=never")


def test_a_pipeline_has_its_delays_once():
    with pytest.raises(ConventionError, match="clock 'pipelined' and delay 1"):
        Convention(1e-3, delay=1, clock="pipelined")


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", ["loihi1", "loihi1:membrane_output=none"])
def test_states_that_are_reset_make_a_free_chip_equal_a_gated_one_in_every_window(backend, name):
    for artifact in (popsan(), network("two layers", state="reset")):
        rows = raster(artifact.graph.nodes["input"].output_type["output"][0])
        gated, free = (
            ran(compile_program(artifact, chip(name), clock=clock), rows, backend)
            for clock in ("gated", "free")
        )
        np.testing.assert_array_equal(gated[0], free[0])
        for layer, found in gated[1].recordings.items():
            np.testing.assert_array_equal(found.membrane, free[1].recordings[layer].membrane)
            np.testing.assert_array_equal(found.spikes, free[1].recordings[layer].spikes)


@pytest.mark.parametrize("clock", ["free", "pipelined"])
@pytest.mark.parametrize("build", [popsan, lambda: network("second"), lambda: network("same")])
def test_backends_agree_over_inferences_that_go_on(clock, build):
    artifact = kept(build())
    program = compile_program(artifact, chip("loihi1"), clock=clock)
    rows = raster(program.width, 20)
    found = {}
    for backend in BACKENDS:
        machine = Machine(program, 3, trace=True, backend=backend)
        outputs = [machine.infer(rows[:, t : t + 4]) for t in range(0, 20, 4)]
        found[backend] = np.concatenate(outputs, 1), machine
    for backend in BACKENDS[1:]:
        np.testing.assert_array_equal(found[backend][0], found["interpreter"][0])
        ledgers = [found[each][1].ledger.counts for each in (backend, "interpreter")]
        np.testing.assert_array_equal(*ledgers)


@pytest.mark.parametrize("build", [popsan, lambda: network("second"), lambda: network("same")])
def test_the_float_twin_of_a_pipeline_equals_the_ideal_chip(build):
    artifact = kept(build(), clock="pipelined")
    program, twin = compile_program(artifact, chip("ideal")), FloatGraph(artifact)
    assert program.clock == "pipelined"
    machine, rows = Machine(program, 3, trace=True), raster(program.width, 20)
    for t in range(0, 20, 5):
        expected = twin.run(rows[:, t : t + 5])
        output = machine.infer(rows[:, t : t + 5])
        np.testing.assert_allclose(output, expected["output"], atol=1e-12)
        for layer in program.spiking:
            spikes = machine.recordings[layer.name].spikes
            np.testing.assert_array_equal(spikes, expected[layer.name])


def test_a_free_chip_updates_every_neuron_until_the_last_layer_has_seen_the_last_row():
    artifact, rows = popsan(), raster(popsan().graph.nodes["input"].output_type["output"][0], 5, 1)
    gated, free = (
        ran(compile_program(artifact, chip("loihi1"), clock=clock), rows)[1].ledger
        for clock in ("gated", "free")
    )
    assert (gated.clock, free.clock) == ("gated", "free")
    # three layers, each a timestep behind the one before it: 5 rows take 8 timesteps
    assert (gated.timesteps, gated.steps) == (5, 8)
    assert (free.timesteps, free.steps) == (8, 8)
    assert free.total("bias_sop") == gated.total("bias_sop")
    for event in ("neuron_update", "spike_out", "sop"):
        assert free.total(event) >= gated.total(event)
    assert free.total("neuron_update") > gated.total("neuron_update")
    per_neuron = [
        ledger.total("neuron_update") + ledger.total("neuron_idle") for ledger in (gated, free)
    ]
    assert per_neuron == [8 * sum(free.neurons)] * 2
    assert len(EVENTS) == free.counts.shape[-1]


def test_the_output_of_a_pipeline_trails_by_the_shortest_and_by_the_longest_path():
    skipping = load(zoo.path("kart-grid/sparse"))
    for artifact, late in ((popsan(), (3, 3)), (event_driven(), (1, 1)), (skipping, (1, 2))):
        for clock in ("gated", "free"):
            made_up_for = compile_program(artifact, chip("loihi1"), clock=clock)
            assert (made_up_for.trailing, made_up_for.fill) == ((0, 0), max(late))
        program = compile_program(artifact, chip("loihi1"), clock="pipelined")
        assert (program.trailing, program.fill) == (late, 0)


def test_the_first_action_that_an_observation_reaches_is_as_late_as_is_said():
    artifact = event_driven()
    late = compile_program(artifact, chip("loihi1"), clock="pipelined").control_steps_late(1)
    moved = []
    for observation in (np.zeros(3), np.full(3, 2.0)):
        controller = SpikingController(artifact, chip("loihi1"), clock="pipelined")
        moved.append([controller.act(seen) for seen in (observation, *np.zeros((3, 3)))])
    differs = np.flatnonzero(np.any(np.array(moved[0]) != np.array(moved[1]), axis=1))
    assert differs[0] == late[0] == 1


def test_spikes_do_not_outlive_a_control_step_where_states_are_reset():
    program = compile_program(popsan(), chip("loihi1"), clock="pipelined")
    assert program.convention.state == "reset"
    assert program.control_steps_late(5) is None
