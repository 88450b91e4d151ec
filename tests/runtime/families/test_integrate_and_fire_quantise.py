"""Layers without a synaptic current become integers by the rule of each chip's own tools."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import (
    axon_types,
    check_axons,
    quantise,
)
from tests.float_layers import float_layer


def floats(weight, name="if1", **more):
    return float_layer(weight, name, **more)


def quantised(layer, name, rounding=None, limits=True, **options):
    used = chip(name, **options)
    return quantise(layer, name, used.arithmetic, rounding, limits)


def whole(layer):
    return layer.synapses[0].weight.tolist()


def test_speck2f_scales_weights_bias_and_threshold_together():
    layer = quantised(floats([[0.5, -0.25, 0.1]], bias=0.3, threshold=0.7), "speck2f")
    # 127 / 0.5 = 254
    assert whole(layer) == [[127, -64, 25]]  # -63.5 to the even one
    assert layer.voltage_bias.tolist() == [76] * 3
    assert layer.bias.tolist() == [0] * 3
    assert layer.threshold.tolist() == [178] * 3
    assert layer.scale == pytest.approx(1 / 254)


def test_spiker_takes_fraction_bits_and_drops_what_is_left():
    layer = floats([[0.7, -0.7, 0.011]], threshold=1.01, beta=0.9)
    layer = quantised(layer, "spiker", weight_bits=8)
    # 127 / 0.7 = 181: seven fraction bits, 89.6, 1.408 and 129.28
    assert whole(layer) == [[89, -89, 1]]
    assert layer.threshold.tolist() == [129] * 3
    assert layer.scale == 1 / 128


@pytest.mark.parametrize(
    ("beta", "shift"), [(0.0, 0), (0.4, 0), (0.5, 1), (0.75, 2), (0.9, 3), (0.9375, 4), (1.0, -1)]
)
def test_spikers_shift_is_the_whole_part_of_the_logarithm(beta, shift):
    layer = quantised(floats([[1.0]], beta=beta), "spiker", limits=beta < 1)
    assert layer.membrane_decay.tolist() == [shift]


def test_odin_has_magnitudes_of_three_bits():
    layer = quantised(floats([[0.5, 0.07], [-0.5, -0.25]], threshold=2.0), "odin")
    # 14 per unit; 0.98 and -3.5
    assert whole(layer) == [[7, 1], [-7, -4]]
    assert layer.threshold.tolist() == [28] * 2


def test_a_bias_without_a_register_is_an_axon():
    layer = quantised(floats([[1.0]], bias=0.25, voltage_bias=0.25), "odin")
    assert (layer.bias.tolist(), layer.voltage_bias.tolist()) == ([4], [0])  # 3.5 to the even one
    layer = quantised(floats([[1.0]], bias=0.25), "truenorth")
    assert (layer.bias.tolist(), layer.voltage_bias.tolist()) == ([0], [64])


@settings(max_examples=60)
@given(
    st.sampled_from(["speck2f", "truenorth", "odin", "spiker"]),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.1, 1.0, 30.0]),
)
def test_a_weight_is_off_by_less_than_one_and_by_half_where_the_nearest_is_taken(name, seed, size):
    weight = size * np.random.default_rng(seed).normal(size=(6, 5))
    point = chip(name).arithmetic
    layer = quantised(floats(weight, threshold=size), name, limits=False)
    low, high = point.weight_range
    found = layer.synapses[0].weight
    assert low <= found.min() <= found.max() <= high
    error = np.abs(found * layer.scale - weight).max() / layer.scale
    assert error <= (0.5 if point.rounding == "nearest" else 1.0) * (1 + 1e-9)
    # and the scale is as large as fits, or half of that where it is a power of two
    room = max(found.max() / high, found.min() / low, layer.threshold.max() / point.threshold_max)
    assert room > (0.85 if point.scaling == "full" else 0.42)


@pytest.mark.parametrize("name", ["speck2f", "truenorth", "odin", "spiker"])
@pytest.mark.parametrize("limits", [True, False])
def test_a_synaptic_current_is_refused_by_the_rule_primitive(name, limits):
    with pytest.raises(RuleError, match=f"^rule primitive: layer 'if1' .* {name} adds spikes"):
        quantised(floats([[1.0]], alpha=0.5), name, limits=limits)


def test_a_leak_that_is_exponential_is_refused_by_the_rule_decay_range():
    for name in ("truenorth", "odin", "speck2f"):
        with pytest.raises(
            RuleError, match=rf"^rule decay-range: layer 'if1' keeps 0\.9 .* {name}"
        ):
            quantised(floats([[1.0]], beta=0.9), name)
    with pytest.raises(RuleError, match=r"^rule decay-range: .*speck2f has no leak"):
        quantised(floats([[1.0]], beta=0.9), "speck2f", limits=False)


def test_spiker_has_no_neurons_without_a_leak():
    with pytest.raises(
        RuleError, match=r"^rule decay-range: layer 'if1' keeps 1 .* leaks by a shift"
    ):
        quantised(floats([[1.0]]), "spiker")


def test_without_limits_a_linear_leak_takes_what_is_lost_half_way_to_the_threshold():
    layer = quantised(floats([[1.0]], threshold=8.0, beta=0.8), "odin", limits=False)
    # 7 per unit: a threshold of 56, of which 0.2 * 28 = 5.6
    assert (layer.threshold.tolist(), layer.membrane_decay.tolist()) == ([56], [6])


def test_an_axon_of_odin_has_one_sign_wherever_it_goes():
    odin = chip("odin")
    signed = quantised(floats([[1.0, 0.5], [-1.0, 0.0]]), "odin")
    check_axons([signed], odin.name, odin.arithmetic)
    mixed = quantised(floats([[1.0, -0.5], [-1.0, 0.0]]), "odin")
    with pytest.raises(
        RuleError, match=r"^rule sign: layer 'if1': 1 of 2 axons from 'input'.*axon 0"
    ):
        check_axons([mixed], odin.name, odin.arithmetic)
    # the same neuron excites one layer and inhibits the next
    other = quantised(floats([[-1.0], [-1.0]], name="if2"), "odin")
    with pytest.raises(RuleError, match=r"^rule sign: layer 'if2': 1 of 2 axons"):
        check_axons([signed, other], odin.name, odin.arithmetic)


def test_axons_of_one_type_give_a_neuron_the_same_weight():
    # rows 0 and 1 agree where both reach; row 2 does not agree with either; row 3 fits the first
    weight = np.array([[2, 0, 3], [2, 5, 0], [1, 5, 0], [0, 5, 3]])
    assert axon_types(weight) == 2
    assert axon_types(np.array([[1], [2], [3], [4], [5]])) == 5
    assert axon_types(np.zeros((4, 3), int)) == 1


def test_truenorth_has_four_types_of_axons():
    used = chip("truenorth")
    four = quantised(floats([[0.25], [0.5], [0.75], [1.0], [0.5]]), "truenorth")
    check_axons([four], used.name, used.arithmetic)
    five = quantised(floats([[0.2], [0.4], [0.6], [0.8], [1.0]]), "truenorth")
    with pytest.raises(RuleError, match=r"^rule axon-types: layer 'if1': its weights need 5 types"):
        check_axons([five], used.name, used.arithmetic)
    wider = chip("truenorth", axon_types=5)
    check_axons([five], wider.name, wider.arithmetic)


def test_an_unknown_rounding_is_refused():
    with pytest.raises(ConfigError, match="rounding 'up' is unknown"):
        quantised(floats([[1.0]]), "speck2f", "up")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"current_decay": np.array([0.5, 0.0])}, "primitive: layer 'if1'"),
        ({"membrane_decay": np.array([1.0, 0.9])}, "decay-range: layer 'if1'"),
        (
            {"threshold": np.array([-0.5, 1.0])},
            "threshold-range: layer 'if1': threshold -0.5 is below 0",
        ),
        ({"threshold": np.array([1.0, 1e-4])}, "threshold-range: layer 'if1': threshold 0.0001"),
    ],
)
def test_one_neuron_that_the_chip_does_not_have_is_enough(fields, message):
    with pytest.raises(RuleError, match=f"^rule {message}"):
        quantised(replace(floats([[1.0, 1.0]]), **fields), "odin")


def test_without_limits_only_the_thresholds_that_are_lost_become_the_smallest():
    layer = replace(floats([[1.0] * 3]), threshold=np.array([1e-4, 2.0, 0.0]))
    assert quantised(layer, "odin", limits=False).threshold.tolist() == [1, 14, 0]


def test_a_layer_of_zeros_has_a_scale_of_one():
    layer = quantised(floats([[0.0]], threshold=0.0), "speck2f")
    assert (layer.scale, layer.threshold.tolist(), layer.voltage_bias.tolist()) == (1.0, [0], [0])


@pytest.mark.parametrize(
    ("fields", "scale"),
    [
        ({"threshold": 0.25}, 127 / 0.5),
        ({"threshold": 1000.0}, 32767 / 1000),
        ({"bias": -3.0}, 128 / 3),
        ({"bias": 3.0}, 127 / 3),
        ({"bias": 2.0, "voltage_bias": 1.0}, 127 / 3),
    ],
)
def test_the_first_number_that_fills_its_bits_sets_the_scale(fields, scale):
    layer = quantised(floats([[0.5, -0.25]], **{"threshold": 0.0, **fields}), "speck2f")
    assert layer.scale == pytest.approx(1 / scale)


def test_a_leak_is_no_larger_than_its_bits():
    beta = np.array([1 - 2.0**-20, 1 - 2.0**-15, 1 - 2.0**-14])
    layer = replace(floats([[1.0] * 3]), membrane_decay=beta)
    assert quantised(layer, "spiker").membrane_decay.tolist() == [15, 15, 14]
    lossy = replace(floats([[1.0] * 3], threshold=30.0), membrane_decay=np.array([0.0, 0.5, 1.0]))
    # thresholds of 210, of which 105 and 52.5
    assert quantised(lossy, "odin", limits=False).membrane_decay.tolist() == [105, 52, 0]
    few = quantised(lossy, "odin", limits=False, leak_bits=6)
    assert few.membrane_decay.tolist() == [63, 52, 0]
