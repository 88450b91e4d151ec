"""The specification, worked out by hand."""

from dataclasses import replace

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.families.cuba.neurons import sum_arriving
from tests.networks import chain, cuba
from tests.programs import layer, random_programs, rasters

CHIP = chip("loihi1")


def one_neuron(weights, **options):
    """Axons with these weights onto one neuron that keeps 3/4 of its current and 1/2 membrane."""
    weight = np.array(weights, np.int16)[:, None]
    neuron = layer(
        CHIP.arithmetic,
        "neuron",
        weight.T,
        (Synapses("input", weight, delay=1),),
        decays=(1023, 2048),  # the register of the current holds one less than is taken away
        **{"threshold": 2 << 6, **options},
    )
    convention = Convention(1e-3, delay=1)
    return Program(CHIP, convention, "input", len(weight), (neuron,), "neuron", None)


def test_a_trace_worked_out_by_hand():
    # weights 3 and -5; everything arrives one timestep late, and times 64: 192 and -320
    #
    # t   arrives        current                         membrane
    # 0   -                 0                               0
    # 1   192             192                             192 > 128: spike, then 0
    # 2   -320            144 - 320 = -176                  0 - 176 = -176
    # 3   192 - 320      -132 - 128 = -260                -88 - 260 = -348
    # 4   -              -195                            -174 - 195 = -369
    # 5   -              -146.25 toward zero: -146       -184.5 toward zero: -184 - 146 = -330
    # 6   -              -109.5 toward zero: -109        -165 - 109 = -274
    raster = np.array([[[1, 0], [0, 1], [1, 1], [0, 0], [0, 0], [0, 0], [0, 0]]], np.uint8)
    program = one_neuron([3, -5])
    machine = Machine(program, trace=True)
    machine.infer(raster)
    for ran in (trace(program, raster), machine.recordings):
        assert ran["neuron"].current.ravel().tolist() == [0, 192, -176, -260, -195, -146, -109]
        assert ran["neuron"].membrane.ravel().tolist() == [0, 0, -176, -348, -369, -330, -274]
        assert ran["neuron"].spikes.ravel().tolist() == [0, 1, 0, 0, 0, 0, 0]


@pytest.mark.parametrize("shift", [0, 1, 3])
def test_sums_of_a_negative_exponent_are_rounded_down_together(shift):
    fixed = CHIP.arithmetic
    weight = np.array([[5, -5], [6, -6]], np.int16)
    lists = (Synapses("a", weight, 1, shift=shift), Synapses("b", weight, 1))
    both = layer(fixed, "n", weight.T, lists, decays=(0, 0), threshold=64)
    both = replace(both, bias=np.array([1, 2]))
    row = np.ones((1, 2), np.uint8)
    assert sum_arriving(both, [row, row]).tolist() == [
        [1 + (11 >> shift) + 11, 2 + (-11 >> shift) - 11]
    ]


@settings(max_examples=12)
@given(random_programs(), st.sampled_from(["zero", "subtract"]), st.integers(0, 2**32 - 1))
def test_membranes_before_their_reset_say_which_neurons_spiked(program, reset, seed):
    fixed = replace(program.chip.arithmetic, refractory=1)
    convention = replace(program.convention, reset=reset)
    chosen = replace(program.chip, arithmetic=fixed)
    layers = tuple(
        # some membranes lose nothing
        replace(a, membrane_decay=np.where(np.arange(a.size) % 3, a.membrane_decay, 4096))
        for a in program.layers
    )
    program = replace(program, chip=chosen, convention=convention, layers=layers)
    check_before_reset(program, rasters(program, 2, 6, 0.3, seed)[0])


def check_before_reset(program, raster):
    arithmetic, convention = program.chip.arithmetic, program.convention
    for name, ran in trace(program, raster).items():
        of = program.layer(name)
        before = arithmetic.before_reset(of, convention, ran)
        np.testing.assert_array_equal(before > of.threshold, ran.spikes)
        after = before - of.threshold if convention.reset == "subtract" else 0.0
        np.testing.assert_array_equal(np.where(ran.spikes, after, before), ran.membrane)


@pytest.mark.parametrize("reset", ["zero", "subtract"])
def test_membranes_in_float_before_their_reset_say_which_neurons_spiked(reset):
    rng = np.random.default_rng(0)
    neurons = cuba(6, threshold=1.0)
    neurons.v_leak[:] = rng.normal(size=6) / 4
    keeping = nir.IF(np.full(5, 1000.0), np.ones(5))
    nodes = [nir.Linear(rng.normal(size=(6, 8))), neurons, nir.Linear(rng.normal(size=(5, 6)))]
    network = chain(*nodes, keeping, width=8, act=5)
    program = compile_program(Artifact(network, None, Convention(1e-3, reset)), chip("ideal"))
    check_before_reset(program, rasters(program, 2, 12, 0.4, seed=1)[0])
