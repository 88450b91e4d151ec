"""Sigma-delta neurons on `ideal` and Loihi 2."""

from dataclasses import replace

import numpy as np
import pytest

from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.chips.layer import LayerState
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.cuba.neurons import float_sigma_delta, sigma_delta
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.metrics.energy import energy, energy_table
from spikedeploy.runtime.metrics.neurobench import neurobench
from spikedeploy.runtime.metrics.traffic import host_work
from tests.float_layers import float_layer
from tests.graded import GRADED, INPUT, OUTPUT, SIGMA, delta_network, one_neuron, rasters

GRADED_CHIPS = ("ideal", "loihi2")


def on(artifact, name, batch=1, **options):
    return Machine(compile_program(artifact, chip(name), clock="gated"), batch, **options)


def test_a_neuron_on_ideal_by_hand():
    machine = on(one_neuron(), "ideal", trace=True)
    assert machine.infer(INPUT)[0, :, 0].tolist() == OUTPUT
    seen = machine.recordings["sd1"]
    assert seen.spikes[0, :, 0].tolist() == GRADED
    assert seen.membrane[0, :, 0].tolist() == SIGMA


@pytest.mark.parametrize("threshold", [1e-20, 1e-300])
def test_graded_spikes_beyond_whole_numbers_are_clipped_and_counted(threshold):
    artifact = one_neuron()
    neuron = replace(artifact.sigma_delta["sd1"], threshold=np.array([threshold]))
    artifact = replace(artifact, sigma_delta={"sd1": neuron})
    machine = on(artifact, "ideal", trace=True)
    machine.infer(INPUT)
    sent = machine.recordings["sd1"].spikes
    np.testing.assert_array_equal(sent, FloatGraph(artifact).run(INPUT)["sd1"])
    assert np.abs(sent).max() == 2**53
    assert machine.ledger.total("saturation") > 0


@pytest.mark.parametrize("hidden", [(10,), (10, 6)])
@pytest.mark.parametrize("state", ["kept", "reset"])
def test_ideal_equals_the_float_graph(hidden, state):
    artifact = delta_network(hidden=hidden, state=state)
    raster = rasters()
    machine = on(artifact, "ideal", 3, trace=True)
    trace = FloatGraph(artifact).run(raster)
    np.testing.assert_allclose(machine.infer(raster), trace["output"], atol=1e-12)
    for name in artifact.sigma_delta:
        np.testing.assert_array_equal(machine.recordings[name].spikes, trace[name])
    assert min(trace["sd1"].min(), -trace["sd1"].max()) < -1  # signed, and more than one


@pytest.mark.parametrize("name", GRADED_CHIPS)
def test_parts_steps_and_batches_equal_the_whole(name):
    artifact, raster = delta_network(), rasters()
    whole = on(artifact, name, 3).infer(raster)
    parts = on(artifact, name, 3)
    found = [parts.infer(raster[:, at : at + 10]) for at in range(0, 40, 10)]
    np.testing.assert_allclose(np.concatenate(found, 1), whole, atol=1e-12)
    for k in range(3):
        np.testing.assert_allclose(on(artifact, name).infer(raster[k : k + 1])[0], whole[k])
    # a step is as late as the layers that it passes
    stepped = on(artifact, name, 3)
    late = sum(layer.start for layer in stepped.program.layers[-1:])
    rows = [stepped.step(row) for row in np.moveaxis(raster, 1, 0)]
    np.testing.assert_allclose(np.stack(rows[late:], 1), whole[:, : 40 - late], atol=1e-12)


def test_the_ledger_counts_messages_and_multiplications_by_hand():
    machine = on(one_neuron(), "ideal")
    machine.infer(INPUT)
    ledger = machine.ledger
    # 4 input spikes with a fan-out of 1; 3 graded spikes, of 3, -2 and -1, with a fan-out of 1
    assert ledger.by_layer("sop") == {"sd1": 4, "readout": 3}
    assert ledger.by_layer("graded_sop") == {"sd1": 0, "readout": 3}
    assert ledger.by_layer("spike_out") == {"sd1": 3, "readout": 0}
    # 3 of the 5 neuron-timesteps were not silent
    assert ledger.sparsity == pytest.approx(2 / 5)
    # of 7 synaptic operations 3 multiply: they cost what a multiply-accumulate does
    plain = replace(ledger, counts=ledger.counts.copy())
    plain.counts[:, :, EVENTS.index("graded_sop")] = 0
    table = energy_table("horowitz45-int8")
    more = 3 * (table.joules["mac"] - table.joules["sop"])
    assert energy(ledger, table) - energy(plain, table) == pytest.approx(more)
    # a table that has no price for them takes each for a synaptic operation
    assert energy(ledger, energy_table("davies2018")) == energy(plain, energy_table("davies2018"))


@pytest.mark.parametrize("name", sorted(set(CHIPS) - {"ideal", "loihi2"}))
@pytest.mark.parametrize("limits", [True, False])
def test_other_chips_refuse_by_the_rule(name, limits):
    with pytest.raises(RuleError, match=r"rule (graded|reset|convention)"):
        compile_program(one_neuron(), chip(name), limits=limits)


def test_a_neuron_on_loihi2_by_hand():
    program = compile_program(one_neuron(), chip("loihi2"))
    layer = program.layer("sd1")
    # 255 for the weight of 1, and -128 for -1/2 (-127.5, half to even); a state unit is 1 / 16320:
    # threshold 1/2 and bias 1/4 are 8160 and 4080, which is 4080 * 2**0
    assert layer.synapses[0].weight[:, 0].tolist() == [255, -128]
    assert (layer.threshold[0], layer.voltage_bias[0]) == (8160, 4080)
    machine = Machine(program, trace=True)
    output = machine.infer(INPUT)
    seen = machine.recordings["sd1"]
    # sigma  16320  16320   8128    -64   -8256
    # a      20400  20400  12208   4016       0
    # d      20400  -4080 -12272  -4144   -8160      of q  0  3  3  1  1
    # k      floor(2.5 + 0.5) = 3, 0, -floor(1.504 + 0.5) = -2, 0, -1
    assert seen.membrane[0, :, 0].tolist() == [16320, 16320, 8128, -64, -8256]
    assert seen.spikes[0, :, 0].tolist() == GRADED
    np.testing.assert_allclose(output[0, :, 0], OUTPUT)


def test_compile_says_what_sigma_can_hold():
    program = compile_program(one_neuron(), chip("loihi2"))
    # 24 bits of sigma, less the bias of 4080, over 255 * 64: (8388607 - 4080) / 16320
    (found,) = (remark for remark in program.remarks if "sigma-delta layer 'sd1'" in remark)
    assert "hold 513 net spikes" in found
    assert not any("drift" in remark for remark in program.remarks)


def test_the_host_multiplies_weights_by_graded_spikes():
    program = compile_program(one_neuron(), chip("loihi2:membrane_output=none"))
    assert program.layers[0].graded  # stays on the chip, which has no readout now
    machine = Machine(program, trace=True)
    np.testing.assert_allclose(machine.infer(INPUT)[0, :, 0], OUTPUT)
    spikes = {"input": INPUT, "sd1": machine.recordings["sd1"].spikes}
    # 3 graded spikes, a weight each; the readout has neither decay factors nor a bias
    assert (
        host_work(program, spikes)["multiplications"],
        host_work(program, spikes)["additions"],
    ) == (
        3,
        3,
    )


def test_graded_spikes_are_multiply_accumulates_for_neurobench():
    artifact = one_neuron()
    program = compile_program(artifact, chip("ideal"))
    machine = Machine(program, trace=True)
    machine.infer(INPUT)
    spikes = {"input": INPUT, "sd1": machine.recordings["sd1"].spikes}
    found = neurobench(artifact.graph, program, spikes)
    # 3 and -2 multiply, -1 does not; 3 spikes of the input
    assert (
        found["SynapticOperations"]["Effective_MACs"],
        found["SynapticOperations"]["Effective_ACs"],
    ) == (2, 1 + 4)
    assert found["ActivationSparsity"] == pytest.approx(2 / 5)


def test_drift_says_that_it_does_not_compare_graded_spikes():
    with pytest.raises(ConfigError, match=r"sd1.*graded.*spikedeploy compare"):
        drift(one_neuron(), chip("loihi2"), INPUT)


def plain_sigma_delta(fixed, bits, of, n, arrived, sigma, sent):
    """A timestep of one sigma-delta neuron: sigma, what is sent, activity, overflows."""
    bias, threshold = of.voltage_bias[n], of.threshold[n]
    active = sigma != 0 or bias != 0
    if fixed is None:
        drive, sigma, lost = arrived, sigma + arrived, 0
        apart = max(sigma + bias, 0) / threshold - sent
        whole = int(np.sign(apart) * np.floor(abs(apart) + 0.5)) if abs(apart) >= 1 else 0
        return sigma, whole, active or drive != 0, lost

    def held(x, register):
        most = (1 << (register.bits - 1)) - 1
        return (x, 0) if abs(x) <= most else (max(min(x, most), -most), 1)

    drive, first = held(arrived * 64, fixed.accumulator)
    sigma, second = held(sigma + drive, fixed.membrane)
    raised, third = held(sigma + int(bias), fixed.push)
    apart, threshold = max(raised, 0) - sent * int(threshold), int(threshold)
    whole = (2 * abs(apart) + threshold) // (2 * threshold) if abs(apart) >= threshold else 0
    most = (1 << (bits - 1)) - 1
    lost = first + second + third + (whole > most)
    return sigma, min(whole, most) * (1 if apart > 0 else -1), active or drive != 0, lost


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("in_float", [False, True])
def test_a_timestep_equals_that_of_a_plain_loop(seed, in_float):
    rng, size = np.random.default_rng(seed), 5
    narrow = {name: Register(14, "clip") for name in ("accumulator", "membrane", "push")}
    fixed = None if in_float else replace(chip("loihi2").arithmetic, **narrow)
    of = float_layer(rng.integers(-6, 7, (4, size)), "n", threshold=200.0)
    bias = rng.integers(-900, 900, size) * rng.integers(0, 2, size)
    of = replace(of, graded=True, voltage_bias=bias, membrane_decay=np.ones(size, int))
    if not in_float:
        whole = (replace(of.synapses[0], weight=of.synapses[0].weight.astype(np.int16)),)
        of = replace(of, threshold=np.full(size, 200), synapses=whole, bias=np.zeros(size, int))
    state, plain = LayerState.zero(of, 1), [(0, 0)] * size
    for step in range(12):
        spikes = rng.integers(-40, 41, (1, 4)) * (step % 3 > 0)
        arrived = (spikes @ of.synapses[0].weight.astype(int))[0]
        if in_float:
            result = float_sigma_delta(53, of, arrived[None].astype(float), state)
        else:
            result = sigma_delta(fixed, 6, of, arrived[None], state)
        for n, (sigma, sent) in enumerate(plain):
            sigma, graded, active, lost = plain_sigma_delta(
                fixed, 6, of, n, int(arrived[n]), sigma, sent
            )
            plain[n] = sigma, sent + graded
            assert (state.membrane[0, n], state.sent[0, n]) == plain[n]
            found = result.spikes[0, n], result.active[0, n], result.overflows[0, n]
            assert found == (graded, active, lost)
