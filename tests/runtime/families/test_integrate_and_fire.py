"""Integrate-and-fire neurons of each chip, by hand and beside a second one in plain Python."""

import json

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import ChipError
from tests.networks import chain
from tests.paths import GOLDEN

# networks of random numbers that SANA-FE 2.2.9 ran, by what they have
SANAFE = {
    f"{n['reset']}, leak {max(n['leak'])}, bias {max(n['bias'])}": n
    for n in json.loads((GOLDEN / "neurons" / "sanafe_truenorth.json").read_text())["networks"]
}


def one_layer(name, weights, *, leak=0, threshold, bias=0, reset="zero", floor="none", **options):
    """Axons (M) onto the neurons (N) of a chip, without a delay."""
    datasheet = chip(name, delay=0, **options)
    weight = np.array(weights, np.int16)
    ones = np.ones(weight.shape[1], np.int64)
    layer = Layer(
        name="layer",
        synapses=(Synapses("input", weight, delay=0),),
        bias=0 * ones,
        voltage_bias=bias * ones,
        threshold=threshold * ones,
        current_decay=0 * ones,
        membrane_decay=leak * ones,
        scale=1.0,
        start=0,
    )
    convention = Convention(1e-3, reset=reset, floor=floor)
    return Program(datasheet, convention, "input", len(weight), (layer,), "layer", None)


def ran(program, raster):
    """Membranes, spikes and overflows of the first neuron."""
    found = trace(program, np.array([raster], np.uint8))["layer"]
    return tuple(a[0, :, 0].tolist() for a in (found.membrane, found.spikes, found.overflows))


def test_speck2f_by_hand():
    # weights 100 and -90, bias 3, threshold 40; all of a timestep is one sum, and subtracted as
    # often as it goes
    #
    # t   spikes   sum                 membrane before     spikes   after
    # 0   1 0      100 + 3             103                 2        103 - 80 = 23
    # 1   1 1      100 - 90 + 3        36                  0        36
    # 2   0 0      3                   39                  0        39
    # 3   0 1      -90 + 3             -48                 0        -48
    # 4   1 0      103                 55                  1        15
    program = one_layer("speck2f", [[100], [-90]], threshold=40, bias=3, reset="subtract")
    membrane, spikes, lost = ran(program, [[1, 0], [1, 1], [0, 0], [0, 1], [1, 0]])
    assert membrane == [23, 36, 39, -48, 15]
    assert spikes == [2, 0, 0, 0, 1]
    assert not any(lost)


@pytest.mark.parametrize(("floor", "least"), [("none", -80), ("threshold", -40), ("zero", 0)])
def test_speck2f_has_the_floor_that_the_convention_wants(floor, least):
    program = one_layer("speck2f", [[-80]], threshold=40, floor=floor)
    assert ran(program, [[1]])[0] == [least]


@settings(max_examples=24)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["none", "threshold"]))
def test_speck2f_equals_sinabs_rule_on_the_numbers_that_its_tools_would_make(seed, floor):
    # sinabs: V += W s + b;  V / threshold spikes, without fraction;  V no lower than min_v_mem
    rng = np.random.default_rng(seed)
    weight, bias = rng.normal(size=(6, 5)), rng.normal(size=5) / 4
    threshold = 1.0
    # discretize_conv_spike: the smallest of three scales, each with 128 below 0 and 127 above
    scale = min(
        *(127 / max(x.max(), 1e-9) for x in (weight, bias)),
        *(128 / max(-x.min(), 1e-9) for x in (weight, bias)),
        32767 / threshold,
    )
    neurons = nir.IF(np.full(5, 1000.0), np.full(5, threshold))
    network = chain(nir.Affine(weight.T, bias), neurons, width=6, act=5)
    convention = Convention(1e-3, "subtract", spikes="many", floor=floor)
    raster = rng.integers(0, 2, (1, 20, 6)).astype(np.uint8)
    program = compile_program(Artifact(network, None, convention), chip("speck2f"))
    found = trace(program, raster)["n2"]
    w, b = np.rint(weight * scale), np.rint(bias * scale)
    top = np.rint(threshold * scale)
    v = np.zeros(5)
    for row, spikes, membrane in zip(raster[0], found.spikes[0], found.membrane[0], strict=True):
        v = v + row @ w + b
        n = (v > 0) * np.trunc(v / top)
        v = v - n * top
        v = v if floor == "none" else np.maximum(v, -top)
        np.testing.assert_array_equal(spikes, n)
        np.testing.assert_array_equal(membrane, v)


def test_truenorth_by_hand():
    # weights 5 and -4, leak 2 toward 0 after the spikes, threshold 5
    #
    # t   spikes   sum   then leak    fires
    # 0   1 0      5     3
    # 1   0 1      -1    1            the leak steps over 0
    # 2   0 1      -3    -1
    # 3   1 0      4     2
    # 4   1 0      7     5 >= 5       reset to 0, or less 5
    # 5   1 0      5     3
    program = one_layer("truenorth", [[5], [-4]], threshold=5, leak=2)
    raster = [[1, 0], [0, 1], [0, 1], [1, 0], [1, 0], [1, 0]]
    assert ran(program, raster)[:2] == ([3, 1, -1, 2, 0, 3], [0, 0, 0, 0, 1, 0])
    subtracting = one_layer("truenorth", [[5], [-4]], threshold=3, leak=2, reset="subtract")
    # 3 - 3;  -4 + 2;  -6 + 2;  1 - 2;  4 - 2;  7 - 2 - 3
    assert ran(subtracting, raster)[:2] == ([0, -2, -4, -1, 2, 2], [1, 0, 0, 0, 0, 1])


@pytest.mark.parametrize("network", SANAFE, ids=str)
def test_truenorth_equals_sanafe_where_the_leak_comes_first(network):
    """Membranes and spikes of six neurons; SANA-FE delivers a spike one timestep later."""
    recorded = SANAFE[network]
    numbers = {name: np.array(recorded[name]) for name in ("threshold", "bias", "leak")}
    program = one_layer(
        "truenorth",
        recorded["weights"],
        **numbers,
        reset=recorded["reset"],
        leak_order="first" if numbers["leak"].any() else "last",
    )
    raster = np.roll(np.array([recorded["input"]], np.uint8), 1, axis=1)
    raster[:, 0] = 0
    found = trace(program, raster)["layer"]
    assert found.membrane[0].tolist() == recorded["membrane"]
    assert found.spikes[0].tolist() == recorded["spikes"]
    assert found.spikes.any()


def test_odin_by_hand():
    # weights 7, -5 and 6, leak 1 at the start of a timestep, threshold 10; event after event
    #
    # t   events       membrane
    # 0   7            0, 7
    # 1   7 -5 6       6, 13 >= 10: spike, 0;  0 - 5 stops at 0;  6
    # 2   -            5
    # 3   -5 6         4, 0, 6
    program = one_layer("odin", [[7], [-5], [6]], threshold=10, leak=1)
    membrane, spikes, _ = ran(program, [[1, 0, 0], [1, 1, 1], [0, 0, 0], [0, 1, 1]])
    assert membrane == [7, 6, 5, 6]
    assert spikes == [0, 1, 0, 0]


def test_spiker_by_hand():
    # weights 10 and -9, shift 2 rounds down, threshold 12, strictly above
    #
    # t   leak               events        membrane
    # 0   0                  10            10
    # 1   10 - 2 = 8         10 -9         9
    # 2   9 - 2 = 7          10            17 > 12: spike
    # 3   17 - 12 = 5        -9            -4          reset, and no leak
    # 4   -4 + 1 = -3        -             -3          -4 >> 2 = -1
    # 5   -3 + 1 = -2        -             -2          -3 >> 2 = -1
    program = one_layer("spiker", [[10], [-9]], threshold=12, leak=2, reset="subtract")
    raster = [[1, 0], [1, 1], [1, 0], [0, 1], [0, 0], [0, 0]]
    assert ran(program, raster)[:2] == ([10, 9, 17, -4, -3, -2], [0, 0, 1, 0, 0, 0])


def test_copies_of_a_batch_do_not_meet():
    program = one_layer("odin", np.arange(-7, 8)[:, None] * [[1, -1, 1]], threshold=9, leak=1)
    rasters = np.random.default_rng(0).integers(0, 3, (5, 20, 15)).astype(np.uint8)
    together = trace(program, rasters)["layer"]
    for copy in range(5):
        alone = trace(program, rasters[copy : copy + 1])["layer"]
        np.testing.assert_array_equal(together.membrane[copy], alone.membrane[0])
        np.testing.assert_array_equal(together.spikes[copy], alone.spikes[0])
        np.testing.assert_array_equal(together.overflows[copy], alone.overflows[0])
    assert together.spikes.any()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("odin", {"weight_bits": 0}, "weight_bits is 0; choose 1 to 16"),
        ("odin", {"weight_bits": 17}, "weight_bits is 17; choose 1 to 16"),
        ("speck2f", {"weight_bits": 1}, "weight_bits is 1; choose 2 to 16"),
        ("speck2f", {"spikes_max": 256}, "spikes_max is 256; choose 1 to 255"),
        ("speck2f", {"spikes_max": 0}, "spikes_max is 0; choose 1 to 255"),
        ("speck2f", {"floor": 4}, "floor is 4; membranes start from 0"),
        ("speck2f", {"leak": "slow"}, "leak 'slow' is unknown"),
        ("odin", {"adds": "step"}, "checks is 'event' and adds 'step'"),
        ("odin", {"reset_at": "leak"}, "reset_at is 'leak': a reset in place of the leak needs"),
        ("spiker", {"leak_order": "last"}, "reset_at is 'leak'"),
        ("spiker", {"checks": "event"}, "reset_at is 'leak'"),
        ("spiker", {"spikes_max": 2}, "reset_at is 'leak'"),
        ("odin", {"queue": "full"}, "queue 'full' is unknown. Choose 'off' or 'on'"),
        ("odin", {"queue": "on", "leak_order": "last"}, "queue is 'on': it holds single events"),
        ("truenorth", {"queue": "on"}, "queue is 'on', and the chip's queue has no entries"),
        ("odin", {"queue_entries": -1}, "queue_entries is -1; choose 0 to 65536"),
        ("odin", {"queue_entries": 65537}, "queue_entries is 65537; choose 0 to 65536"),
        ("odin", {"host": "stream"}, "host 'stream' is unknown"),
    ],
)
def test_an_impossible_arithmetic_is_refused(name, options, message):
    with pytest.raises(ChipError, match=message):
        chip(name, **options)


@pytest.mark.parametrize(
    ("name", "options", "weights", "biases", "threshold", "leak"),
    [
        # two's complement, or a magnitude where axons have the sign; a bias without a register is
        # a weight; what is compared with ">" has to be below the largest membrane
        ("speck2f", {}, (-128, 127), (-128, 127), (1 << 15) - 1, 0),
        ("truenorth", {}, (-256, 255), (-256, 255), (1 << 18) - 1, 255),
        ("odin", {}, (-7, 7), (-7, 7), 255, 127),
        ("tinyodin", {}, (-8, 7), (-8, 7), 2047, 127),
        ("spiker", {}, (-16, 15), (-16, 15), (1 << 15) - 2, 15),
        ("odin", {"weight_bits": 5, "bias_bits": 3}, (-31, 31), (-4, 3), 255, 127),
        ("odin", {"membrane": 8, "leak_bits": 7}, (-7, 7), (-7, 7), 127, 127),
        ("odin", {"membrane": 7, "leak_bits": 7}, (-7, 7), (-7, 7), 63, 63),
        ("odin", {"threshold_bits": 4, "fires": "above"}, (-7, 7), (-7, 7), 15, 127),
    ],
)
def test_bits_say_how_large_numbers_are(name, options, weights, biases, threshold, leak):
    rules = chip(name, **options).arithmetic
    assert (rules.weight_range, rules.bias_range) == (weights, biases)
    assert (rules.threshold_max, rules.leak_max) == (threshold, leak)


@pytest.mark.parametrize(
    ("name", "bits", "own", "thresholds", "reached"),
    [
        ("speck2f", 16, True, (1, 32767), True),
        ("truenorth", 20, False, (1, 262143), True),
        ("odin", 9, True, (1, 255), True),
        ("spiker", 16, True, (1, 32766), False),
    ],
)
def test_what_design_rules_ask_of_the_arithmetic(name, bits, own, thresholds, reached):
    arithmetic = chip(name).arithmetic
    assert arithmetic.state_bits == (bits,)
    assert arithmetic.own_weights is own
    assert arithmetic.threshold_range == thresholds
    assert arithmetic.spikes_at_threshold is reached
