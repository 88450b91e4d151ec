"""Layers that are advanced together in one stack do what each does alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.ledger import count
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.families.cuba_numpy.wave import CHUNK, LARGEST, SHORTEST, suits
from tests.programs import chains, rasters

windows = st.integers(SHORTEST, SHORTEST + 2 * CHUNK)


@settings(max_examples=60, deadline=None)
@given(chains(), windows, st.sampled_from([0.0, 0.3, 1.0]), st.integers(0, 2**32 - 1))
def test_a_wave_equals_the_interpreter_in_everything_that_is_left(program, timesteps, rate, seed):
    assert suits(program, program.chip.arithmetic, timesteps, 1)
    machine = Machine(program, trace=True)
    # a second inference finds what the first left in memory
    for raster in rasters(program, 1, timesteps, rate, seed, inferences=2):
        traces = trace(program, raster)
        output = machine.infer(raster)
        for name, found in machine.recordings.items():
            np.testing.assert_array_equal(found.current, traces[name].current)
            np.testing.assert_array_equal(found.membrane, traces[name].membrane)
            np.testing.assert_array_equal(found.spikes, traces[name].spikes)
        np.testing.assert_array_equal(output, traces[program.output].spikes)
        spikes = {name: found.spikes for name, found in traces.items()}
        busy = {name: found.active for name, found in traces.items()}
        counts = count(program, {program.input: raster, **spikes}, busy)
        np.testing.assert_array_equal(machine.ledger.counts[-1:], counts)
    assert machine._backend._wave is not None


@settings(max_examples=20, deadline=None)
@given(chains())
def test_what_is_short_wide_or_large_goes_layer_by_layer(program):
    assert not suits(program, program.chip.arithmetic, SHORTEST - 1, 1)
    assert not suits(program, program.chip.arithmetic, SHORTEST, 2)
    assert not suits(replace(program, width=LARGEST), program.chip.arithmetic, SHORTEST, 1)


@settings(max_examples=20, deadline=None)
@given(chains())
def test_layers_that_do_not_hear_just_the_one_before_go_one_by_one(program):
    first, second, *others = program.layers
    loop = replace(first.synapses[0], source=first.name, weight=np.eye(first.size, dtype=np.int16))
    looped = replace(first, synapses=(*first.synapses, loop))
    assert not suits(
        replace(program, layers=(looped, second, *others)), program.chip.arithmetic, SHORTEST, 1
    )
    early = replace(program, output=first.name)
    assert not suits(early, program.chip.arithmetic, SHORTEST, 1)


@pytest.mark.parametrize("kept", [False, True])
@settings(max_examples=5, deadline=None)
@given(program=chains())
def test_states_that_are_kept_are_no_wave(program, kept):
    state = "kept" if kept else "reset"
    program = replace(program, convention=replace(program.convention, state=state))
    machine = Machine(program)
    machine.infer(rasters(program, 1, SHORTEST, 0.3, 0)[0])
    assert (machine._backend._wave is None) == kept
