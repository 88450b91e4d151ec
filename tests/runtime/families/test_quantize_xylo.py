"""NIR for Xylo: what the quantisers make of numbers that can be worked out by hand."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import NEVER
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, graph, lif, popsan
from tests.xylo_networks import network

CONVENTION = Convention(1e-3, reset="subtract", spikes="many")
ONCE = Convention(1e-3, reset="subtract")
A2 = chip("xylo-a2")
CHANNEL = Quantisation("channel")
BUILD = {"alpha": 0.5, "beta": 0.75, "threshold": 1.0}


def two_layers(first, second, neurons=cuba, bias=(0, 0), convention=CONVENTION, **options):
    """1 input -> 2 hidden -> 1 output, with thresholds 1; currents keep 1/2, membranes 3/4."""
    build = BUILD | options if neurons is cuba else {}
    nodes = [
        nir.Affine(np.array(first, float), np.array(bias, float)),
        neurons(2, **build),
        nir.Linear(np.array(second, float)),
        neurons(1, **build),
    ]
    return Artifact(chain(*nodes, width=1, act=1), None, convention)


def compiled(artifact, quantisation=PLAIN, **options):
    return compile_program(artifact, A2, quantisation, **options)


def shifted(bits):
    return Quantisation(weight_shift=bits)


# weights onto the hidden and the output neuron, options, choice, what becomes of both layers.
# Currents on Xylo have decayed before they are used: 0.5 becomes 0.5 / (1 - 1/2) = 1
BY_HAND = {
    "the largest hidden weight is 127, and outputs have a scale of their own": (
        # -0.25 * 127 = -31.75; 2 * 31.75 = 63.5, to even; 127 / 4 = 31.75
        [[0.5], [-0.125]], [[2, 1]], {}, PLAIN,
        {"weight": [[127, -32]], "threshold": [127, 127], "scale": 1 / 127},
        {"weight": [[127], [64]], "threshold": [32]},
    ),
    "each channel has a scale of its own": (
        [[0.5], [-0.125]], [[2, 1]], {}, CHANNEL,
        {"weight": [[127, -127]], "threshold": [127, 508], "scale": [1 / 127, 1 / 508]}, {},
    ),
    "fractions can be dropped": (
        [[0.5], [-0.125]], [[2, 1]], {}, Quantisation(rounding="truncate"),
        {"weight": [[127, -31]]}, {},
    ),
    "a weight shift makes states finer and leaves the weights": (
        [[0.5], [0.1]], [[2, 1]], {}, Quantisation(weight_shift=3),
        {"weight": [[127 << 3, 25 << 3]], "threshold": [127 << 3] * 2, "scale": 1 / 127 / 8}, {},
    ),
    "a threshold beyond 16 bits rescales everything": (
        # 1 * 127 / 0.002 = 63500 would not fit; with 32767 the weight is 0.002 * 32767 = 65.5;
        # outputs are as they were: 127 / 2
        [[0.001], [0.0005]], [[1, 1]], {}, PLAIN,
        {"weight": [[66, 33]], "threshold": [32767, 32767]}, {"threshold": [64]},
    ),
    "a bias is what it comes to through the current": (
        # 0.1 / (1 - 1/2) = 0.2 in every timestep; the largest weight, 1 / (1/2) = 2, is 127
        [[1], [1]], [[1, 1]], {"bias": [0.1, -0.3]}, PLAIN,
        {"voltage_bias": [13, -38], "bias": [0, 0]}, {},
    ),
    "a spike of a neuron without current still adds up to its weight": (
        # keeps 7/8 in both; the shortest current gives 1/2, 1/4, ... of the weight, in all 1
        [[1], [1]], [[1, 1]], {"neurons": lambda n: lif(n, 8e-3, 8.0)}, PLAIN,
        {"weight": [[127, 127]], "threshold": [127, 127], "current_decay": [[1, 1]]}, {},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BY_HAND)
def test_by_hand(case):
    first, second, options, choice, *expected = BY_HAND[case]
    program = compiled(two_layers(first, second, **options), choice)
    for layer, values in zip(program.layers, expected, strict=True):
        for name, wanted in values.items():
            found = layer.synapses[0].weight if name == "weight" else getattr(layer, name)
            np.testing.assert_allclose(found, wanted, rtol=1e-9, err_msg=name)
    if "bias" in options:
        assert any(r.startswith("layer 'n2'") and "added to the membrane" in r
                   for r in program.remarks)  # fmt: skip
    if "neurons" in options:
        assert any("no synaptic current" in remark for remark in program.remarks)


@pytest.mark.parametrize(
    ("ratio", "dash"), [(1, 1), (1.4, 1), (2.8, 1), (2.9, 2), (5.6, 2), (5.7, 3), (40000, 15)]
)
def test_a_dash_is_the_rounded_logarithm_of_the_time_constant(ratio, dash):
    # a current's dash is at least 1: with 0 nothing would be left of an event
    program = compiled(two_layers([[1], [1]], [[1, 1]], alpha=1 - 1 / ratio))
    assert program.layers[0].current_decay.tolist() == [[dash, dash]]


@pytest.mark.parametrize(
    ("ratio", "dashes"),
    [(0.3, (1, 0)), (2.8, (1, 1)), (2.9, (2, 2)), (11.3, (3, 3)), (11.4, (4, 4))],
)
def test_the_exponential_integrator_has_the_same_dashes_and_membranes_may_forget_at_once(
    ratio, dashes
):
    # keeps exp(-1/ratio) of itself, which is less than 1 - 1/ratio would be
    nodes = [nir.Linear(np.ones((1, 1))), cuba(1), nir.Linear(np.ones((1, 1))), cuba(1)]
    for node in nodes[1::2]:
        node.tau_syn[:] = node.tau_mem[:] = ratio * 1e-3
    convention = replace(CONVENTION, integrator="exponential")
    hidden, _ = compiled(Artifact(chain(*nodes, width=1, act=1), None, convention)).layers
    assert (hidden.current_decay[0, 0], hidden.membrane_decay[0]) == dashes


def test_spike_counts_follow_the_float_graph():
    rng = np.random.default_rng(0)
    artifact = network(rng, [12, 40, 30, 8], ["leaking"] * 3, loops={1}, delay=1)
    for node in artifact.graph.nodes.values():
        if isinstance(node, nir.CubaLIF):
            # powers of two, so that only rounding differs; no output above 1 spike a timestep
            node.tau_syn[:], node.w_in[:] = 4e-3, 4.0
            node.tau_mem[:], node.r[:] = 8e-3, 8.0
            node.v_leak[:] *= 0.1
            node.v_threshold[:] = 4.0
    artifact = replace(artifact)
    raster = (rng.random((1, 400, 12)) < 0.2).astype(np.uint8)
    expected = FloatGraph(artifact).run(raster)
    program = compiled(artifact, replace(CHANNEL, weight_shift=2), limits=False)
    machine = Machine(program, trace=True)
    machine.infer(raster)
    for name in ("l1", "l2"):
        found = machine.recordings[name].spikes
        assert found.max() > 1
        rates, wanted = found.mean(axis=1), expected[name].mean(axis=1)
        assert np.abs(rates - wanted).mean() < 0.1 * wanted.mean()


# populations, order and time


def test_layers_before_the_last_are_hidden_and_the_last_is_the_output():
    rng = np.random.default_rng(0)
    program = compiled(network(rng, [4, 5, 6, 3], ["cuba"] * 3, loops={2}))
    assert program.output_apart
    wires = {a.name: [(s.source, s.delay) for s in a.synapses] for a in program.layers}
    assert wires == {"l1": [("input", 0)], "l2": [("l1", 1), ("l2", 1)], "l3": [("l2", 1)]}
    assert [layer.start for layer in program.layers] == [0, 1, 2]


def test_a_bias_behind_the_first_layer_starts_all_layers_at_once():
    rng = np.random.default_rng(0)
    biased = network(rng, [4, 5, 6, 3], ["cuba"] * 3, biased=True)
    program = compiled(biased)
    assert [layer.start for layer in program.layers] == [0, 0, 0]
    assert any(r.startswith("layer 'l2' has a bias") for r in program.remarks)


def test_a_convention_with_delay_is_what_xylo_does():
    rng = np.random.default_rng(0)
    program = compiled(network(rng, [4, 5, 6, 3], ["cuba"] * 3, biased=True, delay=1))
    assert program.lags == ((1,), (1,), (1,))
    assert not any("at once" in remark for remark in program.remarks)


def test_the_slowest_path_says_when_a_layer_starts():
    nodes = {name: nir.Linear(np.ones((1, 1))) for name in "abcd"}
    nodes |= {name: cuba(1, **BUILD) for name in ("l1", "l2", "l3")}
    nodes |= {"input": nir.Input(np.array([1])), "output": nir.Output(np.array([1]))}
    edges = "input->a, a->l1, l1->b, b->l2, l1->c, c->l3, l2->d, d->l3, l3->output"
    program = compiled(Artifact(graph(edges, **nodes), None, CONVENTION))
    [remark] = [r for r in program.remarks if "at once" in r]
    assert remark == (
        "'l1' -> 'l3' would need a delay of 2 on Xylo; all layers start at once, and outputs come "
        "2 rows late"
    )


def test_a_skip_from_the_input_is_heard_at_once():
    rng = np.random.default_rng(0)
    program = compiled(network(rng, [4, 5, 6, 3], ["cuba"] * 3, skip=True))
    assert dict((s.source, s.delay) for s in program.layer("l2").synapses) == {"input": 0, "l1": 1}
    assert any("'l2' -> 'l1' would need a delay of 0" in r for r in program.remarks)


def test_two_maps_from_one_source_become_one_matrix():
    nodes = {
        "input": nir.Input(np.array([1])), "output": nir.Output(np.array([1])),
        "a": nir.Linear(np.array([[1.0]])), "b": nir.Linear(np.array([[0.5]])),
        "l1": cuba(1, 0.5, 0.75), "c": nir.Linear(np.array([[1.0]])), "l2": cuba(1, 0.5, 0.75),
    }  # fmt: skip
    edges = "input->a, input->b, a->l1, b->l1, l1->c, c->l2, l2->output"
    program = compiled(Artifact(graph(edges, **nodes), None, CONVENTION))
    [synapses] = program.layer("l1").synapses
    assert synapses.weight.tolist() == [[127]]
    assert program.layer("l1").threshold.tolist() == [21]  # 0.5 * 127 / 3


def single():
    return Artifact(chain(nir.Linear(np.ones((2, 3))), cuba(2), width=3, act=2), None, CONVENTION)


def recurrent_output():
    return network(np.random.default_rng(0), [4, 5, 3], ["cuba"] * 2, loops={2})


@pytest.mark.parametrize("build", [single, recurrent_output])
def test_an_output_that_is_no_output_population_is_refused_or_read_as_hidden(build):
    with pytest.raises(RuleError, match=r"^rule outputs: .* is no output population of xylo-a2"):
        compiled(build())
    program = compile_program(build(), chip("xylo-a2", read="any"))
    machine = Machine(program)
    spikes = machine.infer(np.full((1, 20, program.width), 15, np.uint8))
    assert spikes.max() > 1  # as a hidden neuron may


def integrating():
    nodes = [nir.Linear(np.ones((2, 3))), nir.IF(np.full(2, 1e3), np.ones(2))]
    return Artifact(chain(*nodes, nir.Linear(np.ones((2, 2))), cuba(2), width=3, act=2),
                    None, CONVENTION)  # fmt: skip


@pytest.mark.parametrize(
    ("artifact", "message"),
    [
        (popsan(), "reset 'zero': a spike on xylo-a2 can only do 'subtract'"),
        (integrating(), "rule decay-range: .* a membrane that keeps 1 of itself"),
        (
            two_layers([[1], [1]], [[0.00001, 0]], threshold=1e9),
            "^rule weight-bits: .* every weight becomes 0",
        ),
        (
            two_layers([[1], [1]], [[1, 1]], convention=ONCE, threshold=0),
            "^rule threshold-range: .* 0; a membrane",
        ),
    ],
    ids=["reset", "integrator", "weights", "zero"],
)
def test_what_xylo_cannot_do_is_refused_by_name(artifact, message):
    with pytest.raises(RuleError, match=message):
        compiled(artifact)


def test_spikes_above_are_taken_with_a_remark():
    artifact = two_layers([[1], [1]], [[1, 1]])
    [remark] = compiled(replace(artifact, convention=ONCE)).remarks
    assert "spike at their threshold and above, up to 31 times" in remark
    assert compiled(artifact).remarks == ()


@pytest.mark.parametrize(
    ("name", "choice", "message"),
    [
        ("xylo-a2", shifted(16), "weight_shift is 16; choose 0 to 15"),
        ("xylo-a2", shifted(-1), "weight_shift is -1; choose 0 to 15"),
        ("loihi1", shifted(1), "weight_shift is 1; on loihi1 only"),
        ("spinnaker2", CHANNEL, "granularity is 'channel'; on spinnaker2 only rounding"),
    ],
)
def test_choices_that_a_chip_does_not_have_are_refused(name, choice, message):
    artifact = replace(two_layers([[1], [1]], [[1, 1]]), convention=ONCE)
    with pytest.raises(ConfigError, match=message):
        compile_program(popsan() if name == "loihi1" else artifact, chip(name), choice)


def with_hidden(**fields):
    """The network of two layers, whose hidden neurons differ in these numbers."""
    artifact = two_layers([[1], [1]], [[1, 1]])
    for name, values in fields.items():
        getattr(artifact.graph.nodes["n2"], name)[:] = values
    return replace(artifact)


def remarks_on_time(artifact):
    return [r for r in compiled(artifact).remarks if "time constant" in r]


def test_a_time_constant_that_is_off_by_a_hundredth_is_remarked_on():
    # that of the neuron that is off most, beside one that is exact
    [remark] = remarks_on_time(with_hidden(tau_mem=[4e-3, 5e-3]))
    assert remark == (
        "layer 'n2': the membrane's time constant of 5 timesteps becomes 4, a power of two"
    )
    [remark] = remarks_on_time(with_hidden(tau_syn=[2e-3, 1.9e-3]))
    assert "the current's time constant of 1.9 timesteps becomes 2," in remark
    assert not remarks_on_time(with_hidden(tau_mem=[4e-3, 4.03e-3]))
    assert not remarks_on_time(with_hidden())


def test_one_threshold_that_is_lost_is_enough_to_refuse():
    with pytest.raises(RuleError, match=r"^rule threshold-range"):
        compiled(with_hidden(v_threshold=[1.0, 1e-3]))


def test_hidden_layers_share_the_scale_of_the_one_that_needs_the_smallest():
    for first, second in ((0.5, 0.25), (0.25, 0.5)):
        nodes = [nir.Linear(np.full((1, 1), first)), cuba(1, **BUILD)]
        nodes += [nir.Linear(np.full((1, 1), second)), cuba(1, **BUILD)]
        nodes += [nir.Linear(np.ones((1, 1))), cuba(1, **BUILD)]
        layers = compiled(Artifact(chain(*nodes, width=1, act=1), None, CONVENTION)).layers
        # 127 / (0.5 / (1 - 1/2))
        assert [a.threshold.tolist() for a in layers] == [[127], [127], [64]]


def test_a_neuron_has_two_currents_and_a_membrane_of_16_bits():
    arithmetic = A2.arithmetic
    assert arithmetic.state_bits == (16, 16, 16)
    assert chip("xylo-imu").arithmetic.state_bits == (16, 16)
    assert arithmetic.threshold_range == (1, 32767)
    assert arithmetic.describe().weights == "8 bits with the sign"


def test_a_readout_of_xylo_fills_its_weights_and_never_spikes():
    nodes = [nir.Linear(np.ones((2, 1))), cuba(2, **BUILD)]
    readout = nir.LI(tau=np.full(1, 4e-3), r=np.full(1, 4.0), v_leak=np.zeros(1))
    nodes += [nir.Linear(np.array([[1.0, 0.5]])), readout]
    for bits in (0, 15):
        program = compiled(Artifact(chain(*nodes, width=1, act=1), None, CONVENTION), shifted(bits))
        last = program.layers[-1]
        assert last.synapses[0].weight.tolist() == [[127 << bits], [64 << bits]]
        assert last.threshold.tolist() == [NEVER]
    raster = np.full((1, 9, 1), 15, np.uint8)
    found = trace(program, raster)[last.name]
    assert found.membrane.any()
    assert not found.spikes.any()
