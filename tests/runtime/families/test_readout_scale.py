"""Readout layers in Loihi's integers: exponent, room, and the choices of quantisation."""

import re
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import NEVER
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.families.cuba.quantise import (
    NET_EVENTS,
    describe_range,
    exponent_and_share,
)
from spikedeploy.runtime.float_model import FloatGraph
from tests.float_layers import float_layer
from tests.readouts import events, network

LOIHI1 = chip("loihi1").arithmetic


def layer_of(kind, name="loihi1", quantisation=None, limits=True):
    program = compile_program(
        network(kind), chip(name), quantisation or Quantisation(), limits=limits
    )
    return program.layers[-1]


@pytest.mark.parametrize("kind", ["same", "only", "only LI", "only I"])
def test_weights_fill_eight_bits_and_the_exponent_the_registers(kind):
    weights = layer_of(kind).synapses[0].weight.astype(int)
    most = max(np.abs(s.weight.astype(int)).max() for s in layer_of(kind).synapses)
    exponent = int(np.log2(most // 255))
    assert most == 255 << exponent
    assert (weights % (1 << exponent) == 0).all()


@pytest.mark.parametrize(
    "quantisation",
    [
        Quantisation("channel"),
        Quantisation(rounding="truncate"),
    ],
    ids=["channel", "truncate"],
)
def test_readouts_take_the_choices_of_quantisation(quantisation):
    artifact = network("only")
    plain = compile_program(artifact, chip("loihi1")).layers[0]
    program = compile_program(artifact, chip("loihi1"), quantisation)
    chosen = program.layers[0]
    assert not np.array_equal(plain.synapses[0].weight, chosen.synapses[0].weight)
    wanted = FloatGraph(artifact).run(events())["output"]
    found = Machine(program, 3).infer(events())
    assert np.abs(found - wanted).max() < 0.25 * np.abs(wanted).max()


LIMIT = (1 << 23) - 1


def whole(weight, current=0, membrane=0, spiking=False, **fields):
    """A quantised layer with weights (M, N), and what its states keep of 4096."""
    made = float_layer(weight, "out", threshold=64.0 if spiking else NEVER)
    ones = np.ones(made.size, np.int64)
    decays = {"current_decay": current * ones, "membrane_decay": membrane * ones}
    return replace(made, spiking=spiking, **decays, **fields)


def held(layer, timesteps=None):
    """How many net spikes its registers hold; None where nothing is said."""
    sentence = describe_range(layer, LOIHI1, timesteps)
    return int(re.search(r"hold (\d+) net spikes", sentence)[1]) if sentence else None


def response(layer, n, arrivals):
    """Largest membrane of a neuron (its current, where it spikes) after these arrivals of 1."""
    a, b = layer.current_decay[n] / 4096, layer.membrane_decay[n] / 4096
    current = membrane = most = 0.0
    for x in arrivals:
        current = a * current + x
        membrane = (0 if layer.spiking else b) * membrane + current
        most = max(most, membrane)
    return most


def test_windows_that_end_bound_what_adds_up():
    # without any leak membranes hold the sum of 1, 2, ..: at most T arrivals of T each
    layer = whole([[255]], current=0, membrane=4096)
    most = LIMIT // (255 * 64)
    assert held(layer, most) is None
    assert held(layer, most + 1) == most
    assert held(layer) == most


def test_a_bias_without_a_leak_adds_up_over_4096_timesteps():
    layer = whole([[255]], membrane=4096, voltage_bias=np.array([-100]))
    assert held(layer) == (LIMIT - 4096 * 100) // (255 * 64)
    layer = whole([[255]], membrane=4096, bias=np.array([-1]))
    assert held(layer) == (LIMIT - 4096 * 64) // (255 * 64)
    # sigma-delta neurons add theirs once
    graded = whole([[255]], membrane=4096, voltage_bias=np.array([-100]), graded=True)
    assert held(replace(graded, spiking=True)) == (LIMIT - 100) // (255 * 64)


def test_the_current_of_neurons_that_spike_is_looked_at_where_it_hardly_leaks():
    heavy = np.full((1, 1), 5000)
    for current, spoken in ((4079, False), (4080, True)):
        assert (held(whole(heavy, current, 4096, spiking=True)) is not None) == spoken
    both = whole(np.full((1, 2), 5000), spiking=True)
    assert held(replace(both, current_decay=np.array([0, 4095]))) == LIMIT // (5000 * 64)


@pytest.mark.parametrize(
    ("fields", "kind"),
    [
        ({}, "readout"),
        ({"spiking": True}, "layer"),
        ({"spiking": True, "graded": True}, "sigma-delta layer"),
    ],
)
def test_the_sentence_names_the_kind_of_layer_and_where_to_look(fields, kind):
    layer = replace(whole([[5000]], 4096, 4096), **fields)
    sentence = describe_range(layer, LOIHI1, None)
    assert sentence.startswith(f"{kind} 'out': its leaks do not bound")
    assert "spikedeploy drift" in sentence
    assert "spikedeploy drift" not in describe_range(layer, LOIHI1, None, drifts=False)


def reach(weights, a, b, bias, voltage_bias):
    """What a float neuron is estimated to reach: NET_EVENTS spikes, or all that can arrive."""
    layer = whole(np.array(weights)[:, None], 4096 * a, 4096 * b)
    peak, settled = response(layer, 0, [1] + [0] * 60), response(layer, 0, [1] * 3000)
    one_sign = max(sum(w for w in weights if w > 0), -sum(w for w in weights if w < 0))
    spikes = min(NET_EVENTS * max(map(abs, weights)) * peak, one_sign * settled)
    return spikes + abs(bias) * settled + abs(voltage_bias) / (1 - b)


@pytest.mark.parametrize(
    ("weights", "decays", "bias", "voltage_bias"),
    [
        ([1.0], (0.0, 0.0), 0.0, 0.0),
        ([1.0, -0.9, 0.5], (0.5, 0.25), 0.0, 0.0),
        ([0.5, -0.9, -0.9], (0.5, 0.25), 0.0, 0.0),
        ([1.0] * 40, (0.5, 0.5), 0.0, 0.0),
        ([1.0] * 40, (0.99, 0.5), 0.0, 0.0),
        ([1.0] * 40, (0.5, 0.99), 0.0, 0.0),
        ([1.0] * 9, (0.5, 0.25), -4.0, 0.0),
        ([1.0] * 9, (0.5, 0.25), 0.0, -20.0),
        ([1.0] * 9, (0.5, 0.25), 3.0, 20.0),
        ([1.0] * 300, (0.0, 0.0), 0.0, 0.0),
        # 260 at once leave no exponent, and 140 would
        ([1.0] * 200, (0.0, 0.0), 60.0, 0.0),
        ([1.0] * 200, (0.0, 0.0), -60.0, 0.0),
    ],
)
def test_the_exponent_is_the_largest_that_leaves_half_of_each_register(
    weights, decays, bias, voltage_bias
):
    layer = float_layer(
        np.array(weights)[:, None], "out", bias=bias, voltage_bias=voltage_bias,
        threshold=np.inf, alpha=decays[0], beta=decays[1],
    )  # fmt: skip
    layer = replace(layer, spiking=False)
    unit = 255 * 64
    one_sign = max(sum(w for w in weights if w > 0), -sum(w for w in weights if w < 0))
    filled = max(
        reach(weights, *decays, bias, voltage_bias) * unit / (LIMIT / 2),
        abs(voltage_bias) * unit / (4095 << 7),
        (one_sign + abs(bias)) * unit / LOIHI1.accumulator.limit,
    )
    exponent, share = exponent_and_share(layer, LOIHI1, 255.0)
    assert share == 1.0
    # 128 times 255 is the most that 16 bits store
    assert exponent == np.clip(np.floor(np.log2(1 / filled)), 0, 7)


UNIT = 255 * 64


@pytest.mark.parametrize(
    ("fields", "filled"),
    [
        ({"voltage_bias": -4000.0}, 4000 * UNIT / (4095 << 7)),
        ({"bias": 4000.0}, (1 + 4000) * UNIT / (LIMIT / 2)),
        ({"bias": 384.0}, (1 + 384) * UNIT / (LIMIT / 2)),  # 1.5
        # 64 spikes, and a bias that adds up to 1000 times itself
        ({"voltage_bias": -30.0, "beta": 0.999}, (64 + 30_000) * UNIT / (LIMIT / 2)),
    ],
)
def test_what_would_fill_more_than_there_is_shrinks_the_scale_to_just_that(fields, filled):
    layer = float_layer([[1.0]], "out", threshold=np.inf, **{"beta": 0.0, **fields})
    exponent, share = exponent_and_share(replace(layer, spiking=False), LOIHI1, 255.0)
    assert (exponent, share) == (0, pytest.approx(1 / filled))


NARROW = Register(20, "clip")


@pytest.mark.parametrize("name", ["current", "push", "membrane"])
def test_the_narrowest_register_sets_the_exponent(name):
    layer = float_layer(np.ones((40, 1)), "out", threshold=np.inf, beta=0.0)
    narrow = replace(LOIHI1, **{name: NARROW})
    exponents = [
        exponent_and_share(replace(layer, spiking=False), r, 255.0)[0] for r in (LOIHI1, narrow)
    ]
    # 40 * 16320 that arrive at once are a third of the accumulator, and more than 2**19
    assert exponents == [1, 0]


def test_a_readout_of_zeros_has_no_exponent():
    layer = replace(float_layer([[0.0]], "out", threshold=np.inf, beta=0.5), spiking=False)
    assert exponent_and_share(layer, LOIHI1, 1.0) == (0, 1.0)
    unbiased = replace(LOIHI1, bias_mantissa_max=0)
    assert exponent_and_share(layer, unbiased, 1.0) == (0, 1.0)
