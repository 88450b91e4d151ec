"""Floats become the numbers of a chip: worked out by hand, bounded on every chip, or refused.

Xylo, whose time constants become shifts first, has test_quantize_xylo besides.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.cuba.quantise import drop_low_bits, quantise
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import axon_types, check_axon_types
from tests.float_layers import float_layer
from tests.networks import popsan

LOIHI1 = chip("loihi1").arithmetic
TRUNCATE = Quantisation(rounding="truncate")
CHANNEL = Quantisation(granularity="channel")
NETWORK = compile_program(popsan(), chip("ideal"))
CUBA = {"threshold": 0.5, "alpha": 0.5, "beta": 0.75}
FIRE = ("speck2f", "truenorth", "odin", "spiker")


def floats(weight, **more):
    return float_layer(weight, "lif1", **more)


def quantised(layer, name, choice=PLAIN, limits=True, **options):
    """The layer alone in a network on a chip."""
    used, network = chip(name, **options), replace(NETWORK, layers=(layer,))
    (found,) = used.arithmetic.quantise(network, choice, None, limits)
    return found


# chip, choice, fields of the float layer, what becomes of them
BY_HAND = {
    "the largest weight fills its bits, and the threshold follows": (
        # 255 / 0.6 = 425 mantissas per unit
        "loihi1", PLAIN, CUBA | {"weight": [[0.3, -0.6, 0.01]]},
        {"weight": [[128, -255, 4]], "threshold": [212 * 64] * 3, "scale": 1 / 425 / 64},
    ),
    "a bias shares the scale of the weights": (
        "loihi1", PLAIN, CUBA | {"weight": [[0.3]], "bias": -0.6},
        {"weight": [[128]], "bias": [-255]},
    ),
    "decays are rounded to twelve bits": (
        "loihi1", PLAIN, {"weight": [[1.0]], "alpha": 0.9, "beta": 0.8},
        {"current_decay": [4096 - 410], "membrane_decay": [4096 - 819]},
    ),
    "a threshold that does not fit shrinks the scale": (
        # 131071 / 1000 mantissas per unit
        "loihi1", PLAIN, CUBA | {"weight": [[0.6, 0.2]], "threshold": 1000.0},
        {"weight": [[79, 26]], "threshold": [131071 * 64] * 2},
    ),
    # 0.5 * 255 * 64 = 8160 = 4080 * 2
    "a voltage bias is a mantissa and an exponent": (
        "loihi1", PLAIN, CUBA | {"weight": [[1.0]], "voltage_bias": 0.5}, {"voltage_bias": [8160]},
    ),
    # 3.0001 * 255 * 64 = 48961.6, of which an exponent of 4 keeps 3060 * 16
    "an exponent drops what its mantissa cannot hold": (
        "loihi1", PLAIN, CUBA | {"weight": [[1.0]], "voltage_bias": 3.0001},
        {"voltage_bias": [48960]},
    ),
    "with a scale for each neuron every one fills the weight": (
        # 255 / 0.3 = 850 and 255 / 0.6 = 425 mantissas per unit; 0.5 of each, 425 and 212.5
        "loihi1", CHANNEL, CUBA | {"weight": [[0.3, -0.6], [0.1, 0.02]], "voltage_bias": 0.01},
        {"weight": [[255, -255], [85, 8]], "threshold": [425 * 64, 212 * 64],
         "voltage_bias": [544, 272], "scale": [1 / 850 / 64, 1 / 425 / 64]},
    ),
    "speck2f scales weights, bias and threshold together": (
        # 127 / 0.5 = 254; -63.5 to the even one
        "speck2f", PLAIN, {"weight": [[0.5, -0.25, 0.1]], "bias": 0.3, "threshold": 0.7},
        {"weight": [[127, -64, 25]], "voltage_bias": [76] * 3, "bias": [0] * 3,
         "threshold": [178] * 3, "scale": 1 / 254},
    ),
    "odin has magnitudes of three bits": (
        # 14 per unit; 0.98 and -3.5
        "odin", PLAIN, {"weight": [[0.5, 0.07], [-0.5, -0.25]], "threshold": 2.0},
        {"weight": [[7, 1], [-7, -4]], "threshold": [28] * 2},
    ),
    "a bias without a register is an axon": (  # 3.5 to the even one
        "odin", PLAIN, {"weight": [[1.0]], "bias": 0.25, "voltage_bias": 0.25},
        {"bias": [4], "voltage_bias": [0]},
    ),
    "a bias with one is not": (
        "truenorth", PLAIN, {"weight": [[1.0]], "bias": 0.25}, {"bias": [0], "voltage_bias": [64]},
    ),
    "a layer of zeros has a scale of one": (
        "speck2f", PLAIN, {"weight": [[0.0]], "threshold": 0.0},
        {"scale": 1.0, "threshold": [0], "voltage_bias": [0]},
    ),
}  # fmt: skip


def check(layer, expected):
    for name, values in expected.items():
        found = layer.synapses[0].weight if name == "weight" else getattr(layer, name)
        np.testing.assert_allclose(found, values, rtol=1e-9, err_msg=name)


@pytest.mark.parametrize("case", BY_HAND)
def test_by_hand(case):
    name, choice, layer, expected = BY_HAND[case]
    check(quantised(floats(**layer), name, choice), expected)


@pytest.mark.parametrize("seed", range(5))
def test_truncation_is_the_formula_of_popsans_mapping(seed):
    rng = np.random.default_rng(seed)
    weight, bias = rng.normal(size=(8, 6)), rng.normal(size=6)
    layer = quantised(replace(floats(weight, **CUBA), bias=bias), "loihi1", TRUNCATE)
    # k = 255 / max(|W|, |b|), int(clip(W k)), int(vth k)  (pop-spiking-deep-rl, utility.py)
    k = 255 / max(np.abs(weight).max(), np.abs(bias).max())
    expected = {
        "weight": np.clip(weight * k, -255, 255).astype(int).tolist(),
        "bias": np.clip(bias * k, -255, 255).astype(int).tolist(),
        "threshold": [int(0.5 * k) * 64] * 6,
        # 1/2 and 1/4 of 4096, as there
        "current_decay": [2048] * 6,
        "membrane_decay": [3072] * 6,
    }
    check(layer, expected)


@settings(max_examples=24)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([2, 3, 4, 5, 6, 8]),
    st.sampled_from(["split", "mixed"]),
)
def test_a_weight_of_loihi_is_off_by_half_a_step_at_most_and_stored_unchanged(seed, bits, mode):
    fixed = chip("loihi1", weight_bits=bits, sign_mode=mode).arithmetic
    weight = np.random.default_rng(seed).normal(size=(6, 5))
    layer = quantise(floats(weight, **CUBA | {"threshold": 3.0}), fixed)
    whole = layer.synapses[0].weight
    assert (whole % fixed.weight_step == 0).all()
    assert np.abs(whole).max() <= fixed.weight_max
    np.testing.assert_array_equal(drop_low_bits(whole, fixed), whole)
    error = np.abs(whole * layer.scale * 64 - weight)
    assert error.max() <= 0.5 * fixed.weight_step * layer.scale * 64 * (1 + 1e-9)


@settings(max_examples=24)
@given(st.sampled_from(FIRE), st.integers(0, 2**32 - 1), st.sampled_from([0.1, 1.0, 30.0]))
def test_a_weight_is_off_by_less_than_one_and_by_half_where_the_nearest_is_taken(name, seed, size):
    weight = size * np.random.default_rng(seed).normal(size=(6, 5))
    rules = chip(name).arithmetic
    layer = quantised(floats(weight, threshold=size), name, limits=False)
    low, high = rules.weight_range
    found = layer.synapses[0].weight
    assert low <= found.min() <= found.max() <= high
    error = np.abs(found * layer.scale - weight).max() / layer.scale
    assert error <= (0.5 if rules.rounding == "nearest" else 1.0) * (1 + 1e-9)
    # and the scale is as large as fits, or half of that where it is a power of two
    room = max(found.max() / high, found.min() / low, layer.threshold.max() / rules.threshold_max)
    assert room > (0.85 if rules.scaling == "full" else 0.42)


@settings(max_examples=24)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["nearest", "truncate"]))
def test_a_voltage_bias_is_as_near_as_its_smallest_exponent_allows(seed, rounding):
    rng = np.random.default_rng(seed)
    most = 4095 << 7
    wanted = (rng.normal(size=8) * 2.0 ** rng.integers(0, 20, 8)).clip(-most, most)
    layer = floats(np.full((1, 8), 255.0), **CUBA | {"threshold": 100.0})
    layer = replace(layer, voltage_bias=wanted / 64)
    found = quantise(layer, LOIHI1, Quantisation(rounding=rounding))
    assert found.scale == pytest.approx(1 / 64)
    for value, held in zip(wanted, found.voltage_bias.tolist(), strict=True):
        step = 1
        while abs(value) / step > 4095 and step < 128:
            step *= 2
        assert held % step == 0
        assert abs(held) <= most
        assert abs(held - value) <= (0.5 if rounding == "nearest" else 1.0) * step * (1 + 1e-9)


@pytest.mark.parametrize(("rule", "kept"), [("floor", -256), ("zero", -254)])
def test_emulators_differ_in_odd_negative_mixed_weights(rule, kept):
    fixed = chip("loihi1", sign_mode="mixed", step_rounding=rule).arithmetic
    assert drop_low_bits(np.array([[-255, 255, -254]]), fixed).tolist() == [[kept, 254, -254]]


@pytest.mark.parametrize(
    ("rule", "exponent", "kept"),
    [
        ("exact", 3, [255 << 3, -254 << 3]),
        ("exact", -3, [31, -32]),
        # what a single weight adds ends with the accumulator: 2**21 - 1 in units of 64
        ("weight", 7, [32640, -32512]),
        ("weight", -3, [31, -32]),
    ],
)
def test_a_weight_with_an_exponent_counts_so_many_times_rounded_down(rule, exponent, kept):
    fixed = chip("loihi1", exponents=rule, accumulator=Register(22, "clip")).arithmetic
    assert drop_low_bits(np.array([255, -254]), fixed, exponent).tolist() == kept


def test_the_exponent_of_a_readout_is_that_of_its_whole_scale():
    layer = floats(np.ones((40, 1)), threshold=np.inf, bias=0.5, alpha=0.0, beta=0.25)
    # 40 that arrive at once leave an exponent of 1
    found = quantise(replace(layer, spiking=False), LOIHI1)
    check(found, {"weight": [[255 << 1]] * 40, "bias": [128 << 1]})


def test_the_smallest_threshold_of_sigma_delta_neurons_is_one_state_unit():
    small = floats([[1.0, 1.0]], **CUBA)
    small = replace(small, threshold=np.array([1e-9, 0.5]), graded=True)
    assert quantise(small, LOIHI1).threshold.tolist() == [1, 8160]


def test_spiker_takes_fraction_bits_and_drops_what_is_left():
    layer = floats([[0.7, -0.7, 0.011]], threshold=1.01, beta=0.9)
    layer = quantised(layer, "spiker", weight_bits=8)
    # 127 / 0.7 = 181: seven fraction bits, 89.6, 1.408 and 129.28
    check(layer, {"weight": [[89, -89, 1]], "threshold": [129] * 3, "scale": 1 / 128})


@pytest.mark.parametrize(
    ("beta", "shift"), [(0.0, 0), (0.4, 0), (0.5, 1), (0.75, 2), (0.9, 3), (0.9375, 4), (1.0, -1)]
)
def test_spikers_shift_is_the_whole_part_of_the_logarithm(beta, shift):
    layer = quantised(floats([[1.0]], beta=beta), "spiker", limits=beta < 1)
    assert layer.membrane_decay.tolist() == [shift]


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


def test_without_limits_a_linear_leak_takes_what_is_lost_half_way_to_the_threshold():
    layer = quantised(floats([[1.0]], threshold=8.0, beta=0.8), "odin", limits=False)
    # 7 per unit: a threshold of 56, of which 0.2 * 28 = 5.6
    check(layer, {"threshold": [56], "membrane_decay": [6]})
    layer = replace(floats([[1.0] * 3]), threshold=np.array([1e-4, 2.0, 0.0]))
    assert quantised(layer, "odin", limits=False).threshold.tolist() == [1, 14, 0]


def test_a_leak_is_no_larger_than_its_bits():
    beta = np.array([1 - 2.0**-20, 1 - 2.0**-15, 1 - 2.0**-14])
    layer = replace(floats([[1.0] * 3]), membrane_decay=beta)
    assert quantised(layer, "spiker").membrane_decay.tolist() == [15, 15, 14]
    lossy = replace(floats([[1.0] * 3], threshold=30.0), membrane_decay=np.array([0.0, 0.5, 1.0]))
    # thresholds of 210, of which 105 and 52.5
    for options, leaks in (({}, [105, 52, 0]), ({"leak_bits": 6}, [63, 52, 0])):
        found = quantised(lossy, "odin", limits=False, **options)
        assert found.membrane_decay.tolist() == leaks


def test_axons_of_one_type_give_a_neuron_the_same_weight():
    # rows 0 and 1 agree where both reach; row 2 does not agree with either; row 3 fits the first
    weight = np.array([[2, 0, 3], [2, 5, 0], [1, 5, 0], [0, 5, 3]])
    assert axon_types(weight) == 2
    assert axon_types(np.array([[1], [2], [3], [4], [5]])) == 5
    assert axon_types(np.zeros((4, 3), int)) == 1


def fire(name, *weights, **options):
    """A look at the axons of layers on a chip."""
    used = chip(name, **options)

    def look():
        named = [float_layer(weight, f"if{k}") for k, weight in enumerate(weights)]
        layers = [quantised(each, name, limits=False) for each in named]
        check_axon_types(layers, used.name, used.arithmetic)

    return look


FOUR, FIVE = [[0.25], [0.5], [0.75], [1.0], [0.5]], [[0.2], [0.4], [0.6], [0.8], [1.0]]


def test_axons_that_a_chip_has_pass():
    fire("truenorth", FOUR)()
    fire("truenorth", FIVE, axon_types=5)()


def refused(name, choice=PLAIN, limits=True, size=1, options=None, **fields):
    """A quantiser before a layer with these numbers, which are arrays or one for all."""
    plain = {k: fields.pop(k) for k in ("bias", "spiking") if k in fields}
    layer = floats([[fields.pop("weight", 1.0)] * size], **CUBA if name == "loihi1" else {})
    changed = {k: np.broadcast_to(v, (size,)).astype(float) for k, v in fields.items()}
    layer = replace(layer, **changed, bias=plain.get("bias", 0.0) * np.ones(size))
    layer = replace(layer, spiking=plain.get("spiking", True))
    return lambda: quantised(layer, name, choice, limits, **(options or {}))


REFUSED = [
    (refused("loihi1", size=2, threshold=[0.5, -0.5]), "threshold-range"),
    (refused("loihi1", size=2, threshold=[1e-4, 0.5]), "threshold-range"),
    (refused("loihi1", size=2, threshold=1e6, weight=1e-3), "weight-bits"),
    (refused("loihi1", threshold=1e6, weight=1e-6), "weight-bits"),
    (refused("loihi1", threshold=np.inf, weight=1e-6, bias=1e3, spiking=False), "weight-bits"),
    (refused("loihi1", size=2, current_decay=[1.0, 0.5]), "decay-range"),
    (refused("loihi1", size=2, membrane_decay=[0.5, 0.0]), "decay-range"),
    (refused("loihi1", voltage_bias=0.25, options={"bias_mantissa_max": 0}), "bias"),
    *((refused(name, current_decay=0.5, limits=each), "primitive")
      for name in FIRE for each in (True, False)),
    (refused("odin", size=2, current_decay=[0.5, 0.0]), "primitive"),
    *((refused(name, membrane_decay=0.9), "decay-range") for name in FIRE if name != "spiker"),
    (refused("speck2f", membrane_decay=0.9, limits=False), "decay-range"),
    (refused("spiker"), "decay-range"),
    (refused("odin", size=2, membrane_decay=[1.0, 0.9]), "decay-range"),
    (refused("odin", size=2, threshold=[-0.5, 1.0]), "threshold-range"),
    (refused("odin", size=2, threshold=[1.0, 1e-4]), "threshold-range"),
    (fire("truenorth", FIVE), "axon-types"),
]  # fmt: skip


@pytest.mark.parametrize(("build", "rule"), REFUSED)
def test_what_the_chip_cannot_hold_is_refused_by_its_rule(build, rule):
    with pytest.raises(RuleError, match=f"^rule {rule}: layer '(lif1|if[01])'"):
        build()


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Quantisation(granularity="neuron"), "granularity 'neuron'"),
        (lambda: Quantisation(rounding="up"), "rounding 'up'"),
    ],
)
def test_a_choice_that_is_none_is_refused_by_name(make, word):
    with pytest.raises(ConfigError, match=word):
        make()
