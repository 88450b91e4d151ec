"""Layers that are advanced together in one stack do what each does alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program, Readout
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import count, trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.families.cuba.numpy_kernels import CHUNK, LARGEST, SHORTEST, suits
from tests.programs import chains, layer, rasters

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
        counts = count(program, {program.input: raster, **spikes}, traces)
        np.testing.assert_array_equal(machine.ledger.counts[-1:], counts)
    assert machine._backends[1]._wave is not None


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
    assert (machine._backends[1]._wave is None) == kept


def stack(*weights):
    """One layer behind the other, in registers in which everything fits."""
    wide = Register(60, "none")
    on = chip("loihi1", accumulator=wide, current=wide, push=wide, membrane=wide)
    sources = ["input", *(f"layer{k}" for k in range(1, len(weights) + 1))]
    layers = [
        layer(
            on.arithmetic, sources[k + 1], weight.T, (Synapses(sources[k], weight, 1),),
            decays=(2047, 1024), threshold=640, start=k + 1,
        )
        for k, weight in enumerate(weights)
    ]  # fmt: skip
    width = len(weights[0])
    return Program(on, Convention(1e-3), "input", width, tuple(layers), sources[-1], None)


def suited(program, timesteps=SHORTEST, batch=1):
    return suits(program, program.chip.arithmetic, timesteps, batch)


ONE = np.ones((1, 1), np.int16)


def test_so_many_weights_are_worth_a_wave_and_one_axon_more_is_not():
    # (width + 2 neurons) * 2 neurons, zeros included
    program = stack(ONE, ONE)
    assert suited(replace(program, width=LARGEST // 2 - 2))
    assert not suited(replace(program, width=LARGEST // 2 - 1))


def test_a_wave_needs_two_layers_and_its_shortest_window():
    assert suited(stack(ONE, ONE))
    assert not suited(stack(ONE))
    assert not suited(stack(ONE, ONE), timesteps=SHORTEST - 1)


@pytest.mark.parametrize("place", [0, 1])
def test_sums_beyond_what_float32_holds_are_no_wave(place):
    # 64 * 262143 is the largest multiple of 64 below 2**24
    weights = [ONE, ONE]
    program = stack(*weights)
    for total, fits in ((262143, True), (262144, False)):
        biased = replace(program.layers[place], bias=np.array([total - 1]))
        layers = [biased if k == place else other for k, other in enumerate(program.layers)]
        assert suited(replace(program, layers=tuple(layers))) == fits


def test_what_arrives_late_is_no_wave():
    program = stack(ONE, ONE)
    one = np.ones((1, 1))
    assert suited(replace(program, readout=Readout(one, one[0], lag=0)))
    assert not suited(replace(program, readout=Readout(one, one[0], lag=1)))
    first, second = program.layers
    slow = replace(second, synapses=(replace(second.synapses[0], delay=2),))
    assert not suited(replace(program, layers=(first, slow)))
