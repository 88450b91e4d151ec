"""Floats become the integers of a chip, with bounded error or a refusal that says why."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation, Tuning
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.cuba.quantise import drop_low_bits, quantise
from tests.float_layers import float_layer

FIXED = chip("loihi1").arithmetic
TRUNCATE = Quantisation(rounding="truncate")
CHANNEL = Quantisation(granularity="channel")


def floats(weight, threshold=0.5, alpha=0.5, beta=0.75, **more):
    return float_layer(weight, "lif1", threshold=threshold, alpha=alpha, beta=beta, **more)


def test_the_largest_weight_becomes_the_chips_largest_and_the_threshold_follows():
    layer = quantise(floats([[0.3, -0.6, 0.01]]), FIXED)
    # 255 / 0.6 = 425 mantissas per unit
    assert layer.synapses[0].weight.tolist() == [[128, -255, 4]]
    assert layer.threshold.tolist() == [212 * 64] * 3
    assert layer.scale == pytest.approx(1 / 425 / 64)


def test_a_bias_shares_the_scale_of_the_weights():
    layer = quantise(floats([[0.3]], bias=-0.6), FIXED)
    assert layer.synapses[0].weight.tolist() == [[128]]
    assert layer.bias.tolist() == [-255]


@pytest.mark.parametrize("seed", range(5))
def test_truncation_is_the_formula_of_popsans_mapping(seed):
    rng = np.random.default_rng(seed)
    weight, bias = rng.normal(size=(8, 6)), rng.normal(size=6)
    layer = quantise(replace(floats(weight), bias=bias), FIXED, TRUNCATE)
    # k = 255 / max(|W|, |b|), int(clip(W k)), int(vth k)  (pop-spiking-deep-rl, utility.py)
    k = 255 / max(np.abs(weight).max(), np.abs(bias).max())
    assert layer.synapses[0].weight.tolist() == np.clip(weight * k, -255, 255).astype(int).tolist()
    assert layer.bias.tolist() == np.clip(bias * k, -255, 255).astype(int).tolist()
    assert layer.threshold.tolist() == [int(0.5 * k) * 64] * 6
    # 1/2 and 1/4 of 4096, as there
    assert (4096 - layer.current_decay).tolist() == [2048] * 6
    assert (4096 - layer.membrane_decay).tolist() == [1024] * 6


def test_decays_are_rounded_to_twelve_bits():
    layer = quantise(floats([[1.0]], alpha=0.9, beta=0.8), FIXED)
    assert layer.current_decay.tolist() == [4096 - 410]
    assert layer.membrane_decay.tolist() == [4096 - 819]


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([2, 3, 4, 5, 6, 8]),
    st.sampled_from(["split", "mixed"]),
)
def test_a_weight_is_off_by_half_a_step_at_most(seed, bits, mode):
    fixed = chip("loihi1", weight_bits=bits, sign_mode=mode).arithmetic
    weight = np.random.default_rng(seed).normal(size=(6, 5))
    layer = quantise(floats(weight, threshold=3.0), fixed)
    whole = layer.synapses[0].weight
    assert (whole % fixed.weight_step == 0).all()
    assert np.abs(whole).max() <= fixed.weight_max
    error = np.abs(whole * layer.scale * 64 - weight)
    assert error.max() <= 0.5 * fixed.weight_step * layer.scale * 64 * (1 + 1e-9)


@pytest.mark.parametrize("rounding", ["nearest", "truncate"])
def test_what_is_quantised_is_stored_unchanged(rounding):
    fixed = chip("loihi1", weight_bits=3, sign_mode="mixed").arithmetic
    weight = np.random.default_rng(1).normal(size=(9, 9))
    whole = (
        quantise(floats(weight, threshold=3.0), fixed, Quantisation(rounding=rounding))
        .synapses[0]
        .weight
    )
    np.testing.assert_array_equal(drop_low_bits(whole, fixed), whole)


@pytest.mark.parametrize(("rule", "kept"), [("floor", -256), ("zero", -254)])
def test_emulators_differ_in_odd_negative_mixed_weights(rule, kept):
    fixed = chip("loihi1", sign_mode="mixed", step_rounding=rule).arithmetic
    assert drop_low_bits(np.array([[-255, 255, -254]]), fixed).tolist() == [[kept, 254, -254]]


@pytest.mark.parametrize("clip_ratio", [1.0, 2.0])
def test_a_threshold_that_does_not_fit_shrinks_the_scale_however_much_is_clipped(clip_ratio):
    tuned = Quantisation(tuned={"lif1": Tuning(clip_ratio=clip_ratio)})
    layer = quantise(floats([[0.6, 0.2]], threshold=1000.0), FIXED, tuned)
    # 131071 / 1000 mantissas per unit
    assert layer.threshold.tolist() == [131071 * 64] * 2
    assert layer.synapses[0].weight.tolist() == [[79, 26]]


def test_a_voltage_bias_is_a_mantissa_and_an_exponent():
    layer = quantise(floats([[1.0]], voltage_bias=0.5), FIXED)
    # 0.5 * 255 * 64 = 8160 = 4080 * 2
    assert layer.voltage_bias.tolist() == [8160]
    layer = quantise(floats([[1.0]], voltage_bias=-0.3), FIXED)
    # 0.3 * 255 * 64 = 4896 = 2448 * 2
    assert layer.voltage_bias.tolist() == [-4896]
    layer = quantise(floats([[1.0]], voltage_bias=3.0001), FIXED)
    # 3.0001 * 255 * 64 = 48961.6, of which an exponent of 4 keeps 3060 * 16
    assert layer.voltage_bias.tolist() == [48960]


@pytest.mark.parametrize(
    ("fields", "rule", "message"),
    [
        ({"threshold": [0.5, -0.5]}, "threshold-range", "threshold -0.5 is below 0"),
        ({"threshold": [1e-4, 0.5]}, "threshold-range", "threshold 0.0001 is 0.026 of the small"),
        ({"threshold": [1e6, 1e6], "weight": 1e-3}, "weight-bits", "every weight becomes 0"),
        ({"current_decay": [1.0, 0.5]}, "decay-range", "a current that keeps all"),
        ({"membrane_decay": [0.5, 0.0]}, "decay-range", "a membrane that keeps nothing"),
    ],
)
def test_one_neuron_that_the_chip_cannot_hold_is_refused_by_rule_layer_and_limit(
    fields, rule, message
):
    changed = {name: np.array(values) for name, values in fields.items()}
    layer = floats([[changed.pop("weight", 1.0)] * 2])
    with pytest.raises(RuleError, match=rf"^rule {rule}: layer 'lif1': {message}"):
        quantise(replace(layer, **changed), FIXED)


def test_with_a_scale_for_each_neuron_every_one_fills_the_weight():
    layer = quantise(floats([[0.3, -0.6], [0.1, 0.02]], voltage_bias=0.01), FIXED, CHANNEL)
    # 255 / 0.3 = 850 and 255 / 0.6 = 425 mantissas per unit
    assert layer.synapses[0].weight.tolist() == [[255, -255], [85, 8]]
    # 0.5 of each, 425 and 212.5
    assert layer.threshold.tolist() == [425 * 64, 212 * 64]
    assert layer.voltage_bias.tolist() == [544, 272]
    assert layer.scale.tolist() == pytest.approx([1 / 850 / 64, 1 / 425 / 64])


def test_a_clip_ratio_above_one_clips_the_largest_weights_and_nothing_else():
    tuned = Quantisation(tuned={"lif1": Tuning(clip_ratio=2.0)})
    layer = quantise(floats([[0.3, -0.6, 0.1]]), FIXED, tuned)
    # 2 * 255 / 0.6 = 850 mantissas per unit
    assert layer.synapses[0].weight.tolist() == [[255, -255, 85]]
    assert layer.threshold.tolist() == [425 * 64] * 3


def test_a_tuned_threshold_is_multiplied_before_it_is_rounded():
    tuned = Quantisation(tuned={"lif1": Tuning(threshold=0.9)})
    layer = quantise(floats([[0.3, -0.6]]), FIXED, tuned)
    # 0.45 * 425 = 191.25
    assert layer.threshold.tolist() == [191 * 64] * 2
    assert layer.synapses[0].weight.tolist() == [[128, -255]]


@pytest.mark.parametrize(
    "wrong", [{"granularity": "neuron"}, {"headroom": "some"}, {"rounding": "up"}]
)
def test_an_unknown_choice_is_refused_by_name(wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(ConfigError, match=f"{name} '{value}' is unknown"):
        Quantisation(**wrong)


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_a_tuning_that_is_no_factor_is_refused(value):
    with pytest.raises(ConfigError, match="clip_ratio"):
        Tuning(clip_ratio=value)


def test_a_bias_that_the_chips_neurons_lack_is_refused_with_the_largest():
    fixed = chip("loihi1", bias_mantissa_max=0).arithmetic
    assert not quantise(floats([[1.0, 1.0]]), fixed).voltage_bias.any()
    biased = replace(floats([[1.0, 1.0]]), voltage_bias=np.array([0.25, 0.0]))
    with pytest.raises(RuleError, match=r"^rule bias: layer 'lif1': a voltage bias of 0\.25;"):
        quantise(biased, fixed)


@pytest.mark.parametrize(
    ("spiking", "found"),
    [(True, "too small beside its threshold .1e.06, of"), (False, "too small beside its bias")],
)
def test_what_makes_every_weight_0_is_named(spiking, found):
    layer = floats([[1e-6]], threshold=1e6 if spiking else np.inf, bias=0 if spiking else 1e3)
    with pytest.raises(RuleError, match=found):
        quantise(replace(layer, spiking=spiking), FIXED)


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


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["nearest", "truncate"]))
def test_a_voltage_bias_is_as_near_as_its_smallest_exponent_allows(seed, rounding):
    rng = np.random.default_rng(seed)
    most = 4095 << 7
    wanted = (rng.normal(size=8) * 2.0 ** rng.integers(0, 20, 8)).clip(-most, most)
    layer = replace(floats(np.full((1, 8), 255.0), threshold=100.0), voltage_bias=wanted / 64)
    found = quantise(layer, FIXED, Quantisation(rounding=rounding))
    assert found.scale == pytest.approx(1 / 64)
    for value, held in zip(wanted, found.voltage_bias.tolist(), strict=True):
        step = 1
        while abs(value) / step > 4095 and step < 128:
            step *= 2
        assert held % step == 0
        assert abs(held) <= most
        assert abs(held - value) <= (0.5 if rounding == "nearest" else 1.0) * step * (1 + 1e-9)


def test_the_exponent_of_a_readout_is_that_of_its_whole_scale():
    layer = floats(np.ones((40, 1)), threshold=np.inf, bias=0.5, alpha=0.0, beta=0.25)
    layer = replace(layer, spiking=False)
    # 40 that arrive at once leave an exponent of 1, also where headroom asks for half of the scale
    for share, weight, bias in ((1.0, 255, 128), (0.5, 128, 64)):
        found = quantise(layer, FIXED, share=share)
        assert found.synapses[0].weight.ravel().tolist() == [weight << 1] * 40
        assert found.bias.tolist() == [bias << 1]


def test_the_smallest_threshold_of_sigma_delta_neurons_is_one_state_unit():
    small = replace(floats([[1.0, 1.0]]), threshold=np.array([1e-9, 0.5]), graded=True)
    assert quantise(small, FIXED).threshold.tolist() == [1, 8160]
