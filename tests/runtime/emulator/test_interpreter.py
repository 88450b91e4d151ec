"""The specification, worked out by hand."""

import numpy as np

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.program import Program, Synapses
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from tests.programs import layer

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


def test_a_membrane_at_its_threshold_does_not_spike():
    raster = np.array([[[1, 0], [0, 0]]], np.uint8)
    assert not trace(one_neuron([2, 0]), raster)["neuron"].spikes.any()
    assert trace(one_neuron([3, 0]), raster)["neuron"].spikes.any()


def test_a_spike_leaves_the_current_alone():
    raster = np.array([[[1, 0], [0, 0], [0, 0]]], np.uint8)
    ran = trace(one_neuron([100, 0]), raster)["neuron"]
    assert ran.current.ravel().tolist() == [0, 6400, 4800]
    assert ran.spikes.ravel().tolist() == [0, 1, 1]
    assert ran.membrane.ravel().tolist() == [0, 0, 0]


def test_a_bias_acts_from_the_first_timestep_and_on_the_membrane_only():
    ran = trace(one_neuron([0, 0], bias=100), np.zeros((1, 3, 2), np.uint8))["neuron"]
    assert not ran.current.any()
    # 100, then 50 + 100 > 128: spike, then 0 + 100
    assert ran.membrane.ravel().tolist() == [100, 0, 100]
    assert ran.spikes.ravel().tolist() == [0, 1, 0]
