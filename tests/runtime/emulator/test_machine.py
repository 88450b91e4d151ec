"""The machine is fast, and equal to the interpreter, which is short and right."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import CHUNK, Machine
from spikedeploy.runtime.errors import ConfigError, ObservationError
from tests.equality import runs
from tests.networks import popsan
from tests.programs import random_programs, rasters


@settings(max_examples=16)
@given(random_programs(), runs)
def test_a_chip_that_streams_shows_each_window_from_its_start_on(program, run):
    batch, timesteps, *_ = run
    raster = rasters(program, *run)[0]
    traces = trace(program, raster)
    machine = Machine(program, batch)
    for step in range(timesteps):
        machine.step(raster[:, step])
        current, membrane = machine.current, machine.membrane
        for layer in program.layers:
            row = step - layer.start
            expected = traces[layer.name]
            if row < 0:
                assert not membrane[layer.name].any()
            else:
                np.testing.assert_array_equal(current[layer.name], expected.current[:, row])
                np.testing.assert_array_equal(membrane[layer.name], expected.membrane[:, row])


@pytest.mark.parametrize("name", ["ideal", "loihi1"])
def test_states_that_are_kept_make_two_inferences_one_long_one(name):
    artifact = popsan()
    kept = replace(artifact, convention=replace(artifact.convention, state="kept"))
    program = compile_program(kept, chip(name), clock="gated")
    raster = rasters(program, 2, 10, 0.3, seed=0)[0]
    whole, halves = Machine(program, 2), Machine(program, 2)
    expected = whole.infer(raster)
    output = np.concatenate([halves.infer(raster[:, :5]), halves.infer(raster[:, 5:])], axis=1)
    np.testing.assert_array_equal(output, expected)
    assert Machine(program, 2).infer(raster[:, 5:]).tolist() != output[:, 5:].tolist()


def test_reset_forgets_what_was_kept():
    artifact = popsan()
    kept = replace(artifact, convention=replace(artifact.convention, state="kept", delay=1))
    machine = Machine(compile_program(kept, chip("loihi1")))
    raster = rasters(machine.program, 1, 5, 0.3, seed=0)[0]
    expected = machine.infer(raster)
    assert machine.infer(raster).tolist() != expected.tolist()
    machine.reset()
    assert not any(values.any() for values in machine.membrane.values())
    np.testing.assert_array_equal(machine.infer(raster), expected)


@pytest.mark.parametrize("name", ["ideal", "loihi1"])
def test_a_batch_gives_what_single_inferences_give(name):
    program = compile_program(popsan(hidden=(210, 30)), chip(name))
    raster = rasters(program, CHUNK + 3, 5, 0.2, seed=1)[0]
    together, alone = Machine(program, None), Machine(program)
    output = together.infer(raster)
    expected = np.concatenate([alone.infer(raster[i : i + 1]) for i in range(len(raster))])
    # the readout is float64 and may be summed in another order
    np.testing.assert_allclose(output, expected, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(together.ledger.counts, alone.ledger.counts)


@pytest.mark.parametrize(
    "raster",
    [
        np.zeros((1, 5, 29), np.uint8),
        np.zeros((2, 5, 30), np.uint8),
        np.zeros((5, 30), np.uint8),
        np.zeros((1, 0, 30), np.uint8),
        np.full((1, 5, 30), 2, np.uint8),
        np.zeros((1, 5, 30)),
        np.full((1, 5, 30), np.nan),
    ],
    ids=["width", "batch", "axes", "empty", "two", "floats", "nan"],
)
def test_a_raster_that_is_not_one_is_refused(raster):
    machine = Machine(compile_program(popsan(), chip("loihi1")))
    with pytest.raises(ObservationError, match=r"the spikes have shape|the raster holds"):
        machine.infer(raster)


def test_a_running_machine_refuses_another_way_of_running():
    artifact = popsan()
    kept = replace(artifact, convention=replace(artifact.convention, state="kept"))
    machine = Machine(compile_program(kept, chip("loihi1")))
    machine.infer(np.zeros((1, 5, 30), np.uint8))
    with pytest.raises(ConfigError, match="Call reset"):
        machine.infer(np.zeros((1, 4, 30), np.uint8))
    with pytest.raises(ConfigError, match="Call reset"):
        machine.step(np.zeros((1, 30), np.uint8))
    machine.reset()
    machine.step(np.zeros((1, 30), np.uint8))


def test_a_machine_needs_at_least_one_network():
    with pytest.raises(ConfigError, match="batch is 0"):
        Machine(compile_program(popsan(), chip("loihi1")), batch=0)


@settings(max_examples=16)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["zero", "subtract"]), st.sampled_from([1, 3]))
def test_on_ideal_backends_agree_up_to_the_rounding_of_float64(seed, reset, batch):
    # they add up the same products in another order: equal but for rounding, until a membrane comes
    # within that of its threshold
    artifact = popsan(hidden=(40, 30))
    convention = replace(artifact.convention, reset=reset)
    program = compile_program(replace(artifact, convention=convention), chip("ideal"))
    rng = np.random.default_rng(seed)
    layers = tuple(_with_real_weights(layer, rng) for layer in program.layers)
    program = replace(program, layers=layers, readout=None)
    raster = (rng.random((batch, 9, program.width)) < 0.4).astype(np.uint8)
    machine, slow = (
        Machine(program, batch, trace=True, backend=b) for b in ("numpy", "interpreter")
    )
    machine.infer(raster)
    slow.infer(raster)
    for layer in program.layers:
        found, expected = machine.recordings[layer.name], slow.recordings[layer.name]
        differs = (found.spikes != expected.spikes).any(axis=(0, 2))
        equal = int(differs.argmax()) if differs.any() else len(differs)
        for one, other in ((found.current, expected.current), (found.membrane, expected.membrane)):
            np.testing.assert_allclose(one[:, :equal], other[:, :equal], rtol=0, atol=ROUNDING)
        if differs.any():
            t = equal
            before = expected.membrane[:, t - 1] if t else np.zeros_like(expected.membrane[:, 0])
            membrane = layer.membrane_decay * before + expected.current[:, t] + layer.voltage_bias
            near = np.abs(membrane - layer.threshold) < ROUNDING
            assert near[found.spikes[:, t] != expected.spikes[:, t]].all()
            return


ROUNDING = 1e-12  # of sums of some tens of weights around 1


def _with_real_weights(layer, rng):
    synapses = tuple(replace(s, weight=rng.normal(size=s.weight.shape) / 4) for s in layer.synapses)
    return replace(layer, synapses=synapses)


@settings(max_examples=12)
@given(random_programs(), runs)
def test_a_backend_shows_the_membranes_and_spikes_that_it_recorded(program, run):
    machine = Machine(program, run[0], trace=True)
    machine.infer(rasters(program, *run)[0])
    for name, found in machine.recordings.items():
        for shown, recorded in (
            (machine._backends[run[0]].membranes(name), found.membrane),
            (machine._backends[run[0]].spikes(name), found.spikes),
        ):
            np.testing.assert_array_equal(shown, recorded.swapaxes(0, 1))
