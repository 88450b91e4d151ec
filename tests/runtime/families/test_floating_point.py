"""SpiNNaker2: whole weights and float32 states, which is approximate and says so."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import ChipError, RuleError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFloat32
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, lif, popsan

CHIP = chip("spinnaker2")


def test_the_largest_weight_of_a_population_becomes_127_and_everything_else_follows():
    artifact = popsan()
    layer = compile_program(artifact, CHIP).layers[0]
    weight = artifact.graph.nodes["n1"].weight.T
    scale = 127 / np.abs(weight).max()
    np.testing.assert_array_equal(layer.synapses[0].weight, np.rint(weight * scale))
    np.testing.assert_allclose(layer.threshold, 0.5 * scale, rtol=1e-6)
    np.testing.assert_allclose(layer.bias, artifact.graph.nodes["n1"].bias * scale, rtol=1e-6)
    assert layer.threshold.dtype == layer.bias.dtype == layer.current_decay.dtype == np.float32
    assert layer.scale == pytest.approx(1 / scale)


def test_its_states_are_those_of_a_plain_loop_in_float32():
    program = compile_program(popsan(), CHIP)
    layer = program.layers[0]
    raster = (np.random.default_rng(0).random((1, 12, 30)) < 0.3).astype(np.uint8)
    found = trace(program, raster)[layer.name]
    assert found.membrane.dtype == np.float32
    n = 3
    current = membrane = np.float32(0)
    for t in range(12):
        arrived = np.float32(int(raster[0, t] @ layer.synapses[0].weight[:, n].astype(int)))
        current = layer.current_decay[n] * current + (layer.bias[n] + arrived)
        membrane = layer.membrane_decay[n] * membrane + current
        spikes = membrane > layer.threshold[n]
        membrane = np.float32(0) if spikes else membrane
        assert (found.current[0, t, n], found.membrane[0, t, n]) == (current, membrane)
        assert found.spikes[0, t, n] == spikes
    assert found.spikes[0, :, n].any()


def test_the_model_with_delays_takes_a_skip_past_a_layer_and_the_one_without_refuses_it():
    walker = load(zoo.path("hexapod/sparse-gated"))
    (readout,) = compile_program(walker, chip("spinnaker2-lif")).layers[-1:]
    assert {s.source: s.delay for s in readout.synapses} == {"input": 2, "lif1": 1}
    with pytest.raises(RuleError, match=r"rule delay: .* of 2 timesteps; spinnaker2 has at most 1"):
        compile_program(walker, CHIP)


def test_the_model_with_delays_has_weights_of_15_and_delays_of_7_at_most():
    on = chip("spinnaker2-lif")
    weights = [s.weight for layer in compile_program(popsan(), on).layers for s in layer.synapses]
    assert {int(np.abs(weight).max()) for weight in weights} == {15}

    def delayed(steps):
        delay = nir.Delay(np.full(4, steps * 1e-3))
        nodes = [lif(4, tau=2e-3, r=1.0, threshold=0.5), delay, nir.Linear(np.eye(4))]
        return Artifact(
            chain(*nodes, lif(4, tau=2e-3, r=1.0, threshold=0.5), width=4, act=4),
            None,
            Convention(1e-3),
        )

    assert compile_program(delayed(6), on).layers
    with pytest.raises(RuleError, match=r"rule delay: .*spinnaker2-lif has at most 7"):
        compile_program(delayed(8), on)


@pytest.mark.parametrize(
    ("weight", "threshold", "message"),
    [
        # 127 / 1e-3 * 1e36 > 3.4e38
        (
            1e-3,
            1e36,
            "rule threshold-range: layer 'n2': threshold 1e.36 is 1.27e.41 beside .* whole",
        ),
        (1e-310, 1.0, "rule weight-bits: layer 'n2': the largest weight is 1e-310"),
    ],
)
def test_what_float32_cannot_hold_is_refused_by_layer(weight, threshold, message):
    nodes = nir.Linear(np.full((1, 1), weight)), lif(1, tau=1e-3, r=1.0, threshold=threshold)
    artifact = Artifact(chain(*nodes, width=1, act=1), None, Convention(1e-3))
    with pytest.raises(RuleError, match=message):
        compile_program(artifact, CHIP, limits=False)


def test_weights_have_two_to_sixteen_bits():
    assert [CubaFloat32(bits).weight_max for bits in (2, 16)] == [1, 32767]
    for bits in (1, 17):
        with pytest.raises(ChipError, match=f"weight_bits is {bits}; choose 2 to 16"):
            CubaFloat32(bits)


@pytest.mark.parametrize(("spikes", "fires"), [("reached", True), ("above", False)])
def test_ideal_neurons_spike_at_their_threshold_where_the_convention_says_so(spikes, fires):
    nodes = nir.Linear(np.ones((2, 1))), nir.IF(np.full(2, 1000.0), np.array([1.0, 2.0]))
    convention = Convention(1e-3, spikes=spikes)
    artifact = Artifact(chain(*nodes, width=1, act=2), None, convention)
    program = compile_program(artifact, chip("ideal"))
    raster = np.ones((1, 4, 1), np.uint8)
    found = trace(program, raster)["n2"].spikes
    np.testing.assert_array_equal(found, FloatGraph(artifact).run(raster)["n2"])
    assert bool(found[0, 0, 0]) == fires


def test_numbers_are_described_in_a_few_words():
    assert CHIP.arithmetic.describe() == ("CuBa-LIF", "8 bits with the sign", "float32")
    assert chip("ideal").arithmetic.describe() == ("CuBa-LIF", "float64", "float64")
    split = chip("loihi1").arithmetic
    assert split.describe()[:2] == ("CuBa-LIF", "8 bits and sign")
    mixed = replace(split, sign_mode="mixed")
    assert mixed.describe()[:2] == ("CuBa-LIF", "8 bits with the sign")
    assert split.threshold_range == (64, 131071 << 6)
    assert split.state_bits == (24, 24)
