"""Headroom: a network that overflows its registers is scaled down until it cannot."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.quantise import bounds, with_headroom
from tests.float_layers import float_layer
from tests.networks import chain, cuba, lif, popsan

PROVEN = Quantisation(headroom="proven")
LOIHI1 = chip("loihi1").arithmetic


def crowd(axons=600, threshold=100.0, size=1):
    """Neurons that so many axons drive with the largest weight, which one timestep overflows."""
    weight = np.ones((size, axons))
    neurons = cuba(size, alpha=0.0, beta=0.75, threshold=threshold)
    return Artifact(
        chain(nir.Linear(weight), neurons, width=axons, act=size), None, Convention(1e-3)
    )


def everything(artifact, timesteps=6):
    width = artifact.graph.nodes["input"].input_type["input"][0]
    return np.ones((1, timesteps, width), np.uint8)


def ran(artifact, quantisation, name="loihi1"):
    machine = Machine(compile_program(artifact, chip(name), quantisation))
    output = machine.infer(everything(artifact))
    return output, machine.ledger.total("saturation")


def test_without_headroom_a_crowd_wraps_the_current_and_silences_the_neuron():
    output, saturations = ran(crowd(), Quantisation())
    # 600 * 255 * 64 = 9,792,000 > 2**23
    assert saturations > 0
    assert not output.any()


@pytest.mark.parametrize("granularity", ["layer", "channel"])
@pytest.mark.parametrize("name", ["loihi1", "loihi1-nengo"])
def test_with_proven_headroom_nothing_overflows_and_it_spikes_as_in_float(granularity, name):
    artifact = crowd()
    output, saturations = ran(artifact, replace(PROVEN, granularity=granularity), name)
    float_twin = Machine(compile_program(artifact, chip("ideal"))).infer(everything(artifact))
    assert saturations == 0
    assert float_twin.any()
    np.testing.assert_array_equal(output, float_twin)


def test_where_nothing_can_overflow_headroom_changes_nothing():
    plain = compile_program(popsan(), chip("loihi1"))
    proven = compile_program(popsan(), chip("loihi1"), PROVEN)
    for one, other in zip(plain.layers, proven.layers, strict=True):
        np.testing.assert_array_equal(one.synapses[0].weight, other.synapses[0].weight)
        assert one.scale == other.scale


def test_a_membrane_without_a_leak_has_no_headroom_that_can_be_proven():
    neurons = lif(1)
    graph = chain(
        nir.Linear(-np.ones((1, 2))), nir.IF(neurons.r, neurons.v_threshold), width=2, act=1
    )
    with pytest.raises(RuleError, match="layer 'n2': no scale keeps its membranes"):
        compile_program(Artifact(graph, None, Convention(1e-3)), chip("loihi1"), PROVEN)


def proven(layer, registers, granularity, timesteps=20):
    """The layer alone in a network, with headroom."""
    network = replace(compile_program(popsan(), chip("ideal")), layers=(layer,))
    (found,) = with_headroom(registers, network, Quantisation(granularity), timesteps)
    return found


@pytest.mark.parametrize("seed", range(4))
def test_neurons_with_scales_of_their_own_have_the_headroom_that_each_needs_alone(seed):
    rng = np.random.default_rng(seed)
    narrow = replace(LOIHI1, membrane=Register(20, "clip"), current=Register(19, "clip"))
    layer = float_layer(rng.normal(size=(30, 4)), "n", alpha=0.5, beta=0.9, threshold=20.0)
    vary = {"threshold": np.array([20.0, 2.0, 90.0, 5.0]), "voltage_bias": rng.normal(size=4)}
    layer = replace(layer, **vary)
    together = proven(layer, narrow, "channel")
    assert (together.scale > 1 / (255 * 64)).any()
    for n in range(4):
        one = replace(
            layer,
            synapses=(replace(layer.synapses[0], weight=layer.synapses[0].weight[:, n : n + 1]),),
            **{
                name: getattr(layer, name)[n : n + 1]
                for name in ("bias", "voltage_bias", "threshold", "current_decay", "membrane_decay")
            },
        )
        alone = proven(one, narrow, "channel")
        assert alone.synapses[0].weight[:, 0].tolist() == together.synapses[0].weight[:, n].tolist()
        assert alone.threshold[0] == together.threshold[n]
        assert alone.scale[0] == together.scale[n]


@pytest.mark.parametrize("name", ["accumulator", "current", "push", "membrane"])
def test_the_register_that_is_too_narrow_is_filled_and_does_not_overflow(name):
    narrow = replace(LOIHI1, **{name: Register(18, "clip")})
    layer = float_layer(np.ones((30, 1)), "n", alpha=0.5, beta=0.9, threshold=0.5, voltage_bias=-7)
    found = proven(layer, narrow, "layer")
    network = replace(compile_program(popsan(), chip("ideal")), layers=(found,))
    worst = bounds(network, found, narrow, 20)
    most = {
        "accumulator": worst.drive,
        "current": worst.current,
        "push": worst.current + abs(int(found.voltage_bias[0])),
        "membrane": max(worst.above, worst.below),
    }[name]
    # a thousandth is given up in a round, and weights are whole
    assert 0.9 < most / ((1 << 17) - 1) <= 1
