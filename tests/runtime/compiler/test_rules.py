"""Each design rule, by a network that just keeps it and one that just breaks it."""

import json
from dataclasses import fields, replace
from itertools import pairwise

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy import zoo
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import CHIPS, Limits, chip
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.compiler.rules import RULES, evaluate, place
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError, SpikedeployError
from tests.graded import one_neuron
from tests.networks import chain, cuba, ends, graph, lif, popsan
from tests.paths import ROOT
from tests.runtime.graph.test_generated_graphs import graphs

CONVENTION = Convention(1e-3)
LOIHI = chip("loihi1")


def integrate(*shape):
    return nir.IF(*(np.full(shape, v) for v in (1000.0, 1.0)))


def linear(fan_in, size, there=1):
    """A map in which each source reaches `there` neurons."""
    weight = np.zeros((size, fan_in))
    weight[:there] = 1.0
    return nir.Linear(weight)


def feed(*nodes, width, act, **convention):
    return Artifact(chain(*nodes, width=width, act=act), None, replace(CONVENTION, **convention))


def one(fan_in=3, size=2, neurons=None, **convention):
    """A single layer."""
    layer = neurons or cuba(size)
    size = layer.v_threshold.size
    return feed(nir.Linear(np.ones((size, fan_in))), layer, width=fan_in, act=size, **convention)


def xylo(inputs=4, hidden=4, outputs=2, there=1):
    nodes = linear(inputs, hidden), lif(hidden), linear(hidden, hidden, there), lif(hidden)
    last = linear(hidden, outputs), lif(outputs)
    return feed(*nodes, *last, width=inputs, act=outputs, reset="subtract")


def reached(targets, sources):
    """Hidden neurons of which so many receive inputs, and so many project to outputs."""
    hidden = 200
    first, last = np.zeros((hidden, 2)), np.zeros((2, hidden))
    first[:targets], last[:, :sources] = 1.0, 1.0
    nodes = nir.Linear(first), lif(hidden), nir.Linear(last), lif(2)
    return feed(*nodes, width=2, act=2, reset="subtract")


def sized(layers):
    """So many layers of two integrators."""
    nodes = [node for _ in range(layers) for node in (nir.Linear(np.ones((2, 2))), integrate(2))]
    return feed(*nodes, width=2, act=2)


def looped(loop):
    nodes = {
        "a": nir.Linear(np.ones((2, 2))),
        "r": nir.Linear(np.ones((2, 2))),
        "n": cuba(2),
        "input": nir.Input(np.array([2])),
        "output": nir.Output(np.array([2])),
    }
    back = "n->r, r->n" if loop else "input->r, r->n"
    return Artifact(graph(f"input->a, a->n, {back}, n->output", **nodes), None, CONVENTION)


def delayed(timesteps):
    nodes = nir.Linear(np.ones((2, 2))), nir.Delay(np.full(2, timesteps * 1e-3)), cuba(2)
    return feed(*nodes, width=2, act=2)


def membrane(tau):
    return one(neurons=lif(2, tau=tau, r=tau / 1e-3))


def convolved(size, kernel, stride=1, features=2, padding=0, dilation=1):
    """A convolution of a square image."""
    kernel = (kernel, kernel) if isinstance(kernel, int) else kernel
    weight = np.ones((features, 1, *kernel))
    node = nir.Conv2d((size, size), weight, stride, padding, dilation, 1, np.zeros(features))
    reach = (dilation * (k - 1) + 1 for k in kernel)
    shape = (features, *((size + 2 * padding - each) // stride + 1 for each in reach))
    nodes = {"c": node, "n": integrate(*shape), **ends([1, size, size], shape)}
    edges = list(pairwise(["input", "c", "n", "output"]))
    # nir 1.0.8 takes all kernels for square ones
    return Artifact(nir.NIRGraph(nodes, edges, type_check=False), None, CONVENTION)


def pooled(*pools, size=16, behind=False):
    """Neurons, pools (extent, stride) and a convolution of 1 x 1, or pools behind it."""
    extents, nodes = [size], []
    for kernel, stride in pools:
        axes = np.array([[kernel] * 2, [stride] * 2, [0, 0]])
        nodes.append(nir.SumPool2d(*axes))
        extents.append((extents[-1] - kernel) // stride + 1)
    convolution = nir.Conv2d(None, np.ones((1, 1, 1, 1)), 1, 0, 1, 1, np.zeros(1))
    nodes.insert(len(nodes) * (not behind), convolution)
    first = nir.Conv2d(None, np.ones((1, 1, 1, 1)), 1, 0, 1, 1, np.zeros(1))
    nodes = [first, integrate(1, size, size), *nodes, integrate(1, *[extents[-1]] * 2)]
    names = [f"n{k}" for k in range(len(nodes))]
    edges = list(pairwise(["input", *names, "output"]))
    made = {
        **dict(zip(names, nodes, strict=True)),
        **ends([1, size, size], [1, *[extents[-1]] * 2]),
    }
    return Artifact(nir.NIRGraph(made, edges), None, CONVENTION)


def flattened(*extents):
    """A linear map of maps of such extents."""
    size = int(np.prod(extents))
    nodes = {
        "flat": nir.Flatten({"input": np.array([1, *extents])}, 0, -1),
        "w": nir.Linear(np.ones((2, size))),
        "n": integrate(2),
    }
    edges = "input->flat, flat->w, w->n, n->output"
    return Artifact(graph(edges, **nodes, **ends([1, *extents], 2)), None, CONVENTION)


def heard_by(layers):
    """A layer presynaptic to so many others, whose spikes meet in the last."""
    nodes = ends(2, 2)
    nodes |= {name: integrate(2) for name in ("a", "z")}
    edges = ["input->wa", "wa->a", "z->output", "wz->z"]
    nodes |= {name: nir.Linear(np.ones((2, 2))) for name in ("wa", "wz")}
    for k in range(layers):
        nodes |= {f"w{k}": nir.Linear(np.ones((2, 2))), f"n{k}": integrate(2)}
        edges += [f"a->w{k}", f"w{k}->n{k}", f"n{k}->wz"]
    return Artifact(graph(", ".join(edges), **nodes), None, CONVENTION)


def signed(weight):
    return feed(nir.Linear(np.array(weight, float)), integrate(2), width=2, act=2)


def opposing(sign):
    """A neuron that excites one layer, and another with weights of this sign."""
    nodes = ends(2, 2) | {name: integrate(2) for name in ("a", "b", "c", "z")}
    nodes |= {name: nir.Linear(np.eye(2)) for name in ("wa", "wb", "bz", "cz")}
    nodes["wc"] = nir.Linear(sign * np.eye(2))
    edges = "input->wa, wa->a, a->wb, wb->b, a->wc, wc->c, b->bz, bz->z, c->cz, cz->z, z->output"
    return Artifact(graph(edges, **nodes), None, CONVENTION)


def values(number):
    weight = np.arange(1.0, number + 1)[None]
    return feed(nir.Linear(weight), integrate(1), width=number, act=1)


def reset_to(level):
    neurons = cuba(2)
    neurons.v_reset = np.full(2, level)
    return one(neurons=neurons)


def limited(**limits):
    """Loihi 1 with other limits."""
    return replace(LOIHI, limits=replace(LOIHI.limits, **limits))


BIASED = nir.Affine(np.ones((2, 4096)), np.ones(2))

# rule, chip, a network that just keeps it, one that just breaks it
BOUNDARIES = [
    ("primitive", "speck2f", one(neurons=integrate(2)), one(neurons=lif(2))),
    ("primitive", "xylo-a2", one(neurons=lif(2)), one(neurons=integrate(2))),
    ("reset", "loihi1", one(), one(reset="subtract")),
    ("reset", "xylo-imu", one(reset="subtract"), one()),
    ("reset", "loihi2", reset_to(0.0), reset_to(0.1)),
    ("graded", "loihi2", one_neuron(), None),
    ("graded", "loihi1", one(), one_neuron()),
    ("neurons", "xylo-a2", xylo(hidden=500), xylo(hidden=501)),
    ("neurons", "xylo-a3", xylo(hidden=496), xylo(hidden=497)),
    ("neurons", "xylo-imu", xylo(hidden=248), xylo(hidden=249)),
    ("neurons", "odin", one(size=256), one(size=257)),
    ("neurons", "speck2f", convolved(32, 1, features=64), convolved(32, 1, features=65)),
    ("fan-in", "truenorth", one(256), one(257)),
    ("fan-in", "odin", one(256), one(257)),
    ("fan-out", "xylo-a2", xylo(hidden=65, there=64), xylo(hidden=65, there=65)),
    ("fan-out", "odin", one(size=256), one(size=257)),
    # half of the hidden neurons reach 128 or 129 each, the other half only outputs
    ("fan-out-mean", "xylo-a3", xylo(hidden=200, there=128), xylo(hidden=200, there=129)),
    ("inputs", "xylo-a2", xylo(inputs=16), xylo(inputs=17)),
    ("inputs", "odin", one(256), one(257)),
    ("outputs", "xylo-a2", xylo(outputs=8), xylo(outputs=9)),
    ("outputs", "xylo-a3", xylo(hidden=40, outputs=32), xylo(hidden=40, outputs=33)),
    ("outputs", "xylo-imu", xylo(hidden=40, outputs=16), xylo(hidden=40, outputs=17)),
    # kernels of 512 features: 128 x 512 are the 64 Ki entries of the largest memory
    ("synaptic-memory", "speck2f", one(128, 512, integrate(512)), one(129, 512, integrate(512))),
    ("synaptic-memory", "spinnaker2", one(1 << 17, 1, lif(1)), one((1 << 17) + 1, 1, lif(1))),
    ("axons-in", "loihi1", one(4096), feed(BIASED, cuba(2), width=4096, act=2)),
    ("axons-in", "truenorth", one(256), one(257)),
    ("cores", "speck2f", sized(9), sized(10)),
    ("axon-types", "truenorth", values(4), values(5)),
    ("input-targets", "xylo-a3", reached(128, 1), reached(129, 1)),
    ("output-sources", "xylo-imu", reached(1, 128), reached(1, 129)),
    ("kernel", "speck2f", convolved(20, 16), convolved(20, 17)),
    ("kernel", "speck2f", convolved(20, 2, stride=8), convolved(20, 2, stride=3)),
    ("kernel", "speck2f", convolved(20, 15, padding=7), convolved(20, 15, padding=8)),
    ("kernel", "speck2f", convolved(20, 3), convolved(20, (3, 2))),
    ("kernel", "speck2f", convolved(20, 3), convolved(20, 3, dilation=2)),
    ("kernel", "speck2f", flattened(16, 16), flattened(16, 17)),
    ("pool", "speck2f", pooled((4, 4)), pooled((3, 3))),
    ("pool", "speck2f", pooled((2, 2), (2, 2)), pooled((2, 2), (2, 2), (2, 2))),
    ("pool", "speck2f", pooled((2, 2)), pooled((2, 1))),
    ("layer-order", "speck2f", pooled((2, 2)), pooled((2, 2), behind=True)),
    ("shape", "speck2f", convolved(128, 2, 2, features=1), convolved(129, 4, 4, features=1)),
    ("shape", "speck2f", convolved(65, 2, features=1), convolved(66, 2, features=1)),
    ("shape", "speck2f", convolved(2, 2, features=1024), convolved(2, 2, features=1025)),
    ("destinations", "speck2f", heard_by(2), heard_by(3)),
    ("sign", "odin", signed([[1, -1], [2, 0]]), signed([[1, -1], [2, 1]])),
    ("sign", "odin", opposing(1.0), opposing(-1.0)),
    ("recurrence", "loihi1", looped(True), None),
    ("recurrence", limited(recurrence=False), looped(False), looped(True)),
    ("delay", "loihi1", delayed(63), delayed(64)),
    ("decay-range", "loihi1", membrane(1.001e-3), membrane(1e-3)),
    ("decay-range", "xylo-a2", membrane(2.0**16 * 1e-3), membrane(2.01 * 2.0**15 * 1e-3)),
    ("decay-range", "speck2f", one(neurons=integrate(2)), membrane(10.0)),
    (
        "threshold-range",
        "loihi1",
        one(neurons=cuba(2, threshold=0.502 / 255)),
        one(neurons=cuba(2, threshold=0.5 / 255)),
    ),
    (
        "weight-bits",
        "loihi1",
        one(neurons=cuba(2, threshold=262141.0)),
        one(neurons=cuba(2, threshold=262142.0)),
    ),
    ("convention", "loihi1", one(spikes="reached"), one(spikes="many", reset="subtract")),
    ("convention", "loihi1", one(), one(floor="zero")),
    # two cores of one neuron each, presynaptic to two cores
    (
        "axons-out",
        limited(neurons_per_core=1, axons_out=2, input_cores=False),
        feed(linear(2, 2), cuba(2), linear(2, 2, 2), cuba(2), width=2, act=2),
        feed(linear(2, 2), cuba(2), linear(2, 3, 3), cuba(3), width=2, act=3),
    ),
    (
        "cores",
        limited(neurons_per_core=1, cores=2, alone=True, input_cores=False),
        one(size=2),
        one(size=3),
    ),
    (
        "chips",
        limited(neurons_per_core=1, cores=2, alone=True, input_cores=False),
        one(size=2),
        one(size=3),
    ),
]


def statuses(artifact, on, rule):
    found = evaluate(place(artifact, on))
    return {result.status for result in found if result.rule == rule}


@pytest.mark.parametrize(("rule", "on", "keeps", "breaks"), BOUNDARIES)
def test_a_rule_holds_up_to_its_limit_and_no_further(rule, on, keeps, breaks):
    on = chip(on) if isinstance(on, str) else on
    assert statuses(keeps, on, rule) & {"pass", "not applicable"}
    assert not statuses(keeps, on, rule) & {"fail", "unknown"}
    assert breaks is None or "fail" in statuses(breaks, on, rule)


def test_every_rule_has_a_boundary():
    assert {rule for rule, *_ in BOUNDARIES} == set(RULES)


def test_a_loop_of_readouts_is_not_the_hosts():
    nodes = {"w1": linear(2, 2), "fire": integrate(2), "w2": linear(2, 2), "back": linear(2, 2)}
    nodes["sum"] = nir.I(np.ones(2))
    way = ["input", "w1", "fire", "w2", "sum", "output"]
    edges = [*pairwise(way), ("sum", "back"), ("back", "sum")]
    looped = Artifact(nir.NIRGraph({**ends(2, 2), **nodes}, edges), None, CONVENTION)
    found = evaluate(place(looped, chip("truenorth")))
    assert ("sum", "fail") in {
        (each.node, each.status) for each in found if each.rule == "primitive"
    }


def test_what_breaks_a_rule_is_refused_by_its_name_with_the_limit_and_the_way_out():
    assert compile_program(popsan(), LOIHI).layers
    artifact = feed(BIASED, cuba(2), width=4096, act=2)
    message = (
        "rule axons-in: node 'n2' has 4,097 sources of a core; loihi1 has at most 4,096. .*--limits"
    )
    with pytest.raises(RuleError, match=message):
        compile_program(artifact, LOIHI)
    program = compile_program(artifact, LOIHI, limits=False)
    assert program.layers[0].synapses[0].weight.shape == (4096, 2)


def test_all_rules_that_a_network_breaks_are_named():
    with pytest.raises(RuleError, match=r"^rule inputs: .* It breaks outputs too, which `check`"):
        compile_program(one(fan_in=17, size=9, reset="subtract"), chip("xylo-a2"))


def test_a_network_of_several_chips_passes_with_a_remark_where_chips_can_be_joined():
    few = {"neurons_per_core": 1, "cores": 2, "input_cores": False}
    (found,) = check(one(size=5), limited(**few)).results_of("chips")
    assert (found.status, found.found) == ("pass", 3)
    assert "more than one chip" in found.note
    assert not check(one(size=5), limited(**few, alone=True)).passed


@pytest.mark.parametrize("name", [name for name in CHIPS if chip(name).limits])
def test_every_limit_has_a_source(name):
    limits = chip(name).limits
    given = {f.name for f in fields(Limits) if getattr(limits, f.name) not in (None, ())}
    no = {name for name in ("input_cores", "axon_signs") if not getattr(limits, name)}
    by_definition = {"sources", *no}
    assert given - by_definition <= set(limits.sources)
    assert all(limits.sources.values())
    assert set(limits.sources) <= {field.name for field in fields(Limits)}


NETWORKS = [f"{path.parent.name}/{path.stem}" for path in zoo.policies() if path.suffix == ".nir"]


@pytest.mark.parametrize(
    ("policy", "name"),
    [(policy, "loihi1") for policy in NETWORKS]
    + [("hexapod/sparse", name) for name in CHIPS if name != "loihi1"],
)
def test_every_node_of_a_shipped_policy_is_judged_by_every_rule(policy, name):
    artifact, on = load(zoo.path(policy)), chip(name)
    found = check(artifact, on)
    json.dumps([result.as_json() for result in found.results], allow_nan=False)
    if on.limits is None:
        return
    node_rules = [name for name, rule in RULES.items() if not rule.network]
    judged_ = {(result.rule, result.node) for result in found.results}
    assert {(rule, node) for rule in node_rules for node in artifact.graph.nodes} <= judged_
    assert {result.rule for result in found.results} == {*RULES, "compile"}
    if found.passed:
        compile_program(artifact, on)
    elif name.startswith("loihi"):
        failed = {result.rule for result in found.results if result.failed}
        # neurons of brian2's model have no voltage bias
        assert (name, failed) == ("loihi1-brian2", {"compile"})
        assert "/sparse" in policy


@pytest.mark.parametrize("name", ["speck2f", "odin", "tinyodin", "truenorth"])
def test_a_leak_that_a_chip_has_not_is_answered_with_beta_1(name):
    leaky = one(neurons=lif(2), reset="subtract-delayed")
    found = {each.rule: each for each in check(leaky, chip(name)).results if each.failed}
    assert all("beta=1" in found[rule].remedy for rule in ("primitive", "decay-range"))
    # snnTorch's default reset is the chip's where nothing leaks, if it subtracts
    subtracts = "subtract" in chip(name).resets
    assert ("With beta=1 it passes" in found["reset"].remedy) == subtracts


def test_sources_of_both_signs_are_counted_in_words():
    (found,) = (e for e in check(signed([[1, -1], [2, 1]]), chip("odin")).results if e.failed)
    assert found.found == "1 of 2 sources with both positive and negative weights"


@settings(max_examples=24)
@given(graphs(), st.sampled_from(list(CHIPS)), st.sampled_from(["zero", "subtract"]))
def test_a_generated_graph_is_judged_or_refused_by_our_errors(network, name, reset):
    try:
        found = check(Artifact(network, None, replace(CONVENTION, reset=reset)), chip(name))
    except SpikedeployError:
        return
    json.dumps([result.as_json() for result in found.results], allow_nan=False)
    for result in found.results:
        if result.failed and result.rule != "compile":
            assert result.remedy
            assert result.rule in result.describe(name)


@settings(max_examples=40)
@given(
    st.floats(-8, 8),
    st.floats(0, 6),
    st.sampled_from(["euler", "exponential"]),
    st.sampled_from(["loihi1", "loihi1-brian2", "loihi1-nengo", "loihi2"]),
)
def test_rules_on_arithmetic_refuse_all_that_the_compiler_refuses(power, slow, integrator, name):
    neurons = lif(2, tau=1e-3 * 10**slow, r=10**slow, threshold=10**power)
    artifact = one(neurons=neurons, integrator=integrator)
    rules = ("weight-bits", "threshold-range", "decay-range")
    found = check(artifact, chip(name))
    refused = [result for result in found.results if result.rule in rules and result.failed]
    if found.results_of("compile")[0].failed:
        assert refused


DOCUMENTED = (
    "inputs", "neurons", "outputs", "fan_in", "fan_out", "fan_out_mean", "input_targets",
    "output_sources", "cores", "neurons_per_core", "axons_in", "axons_out", "weight_values",
)  # fmt: skip


@pytest.mark.parametrize("field", DOCUMENTED)
def test_the_documented_limits_are_those_of_the_datasheets(field):
    page = (ROOT / "docs" / "check.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("|")]
    (heads,) = [row for row in rows if row[0] == "loihi1"]
    (cells,) = [row[1:] for row in rows if row[0] == field.replace("_", " ")]
    for name, cell in zip(heads, cells, strict=True):
        limit = getattr(chip(name).limits, field)
        assert cell == ("–" if limit is None else f"{limit:,}")


# what the compiler alone finds: biases that no neuron can have and a network too large to unroll;
# all else that it refuses has the name of a rule
COMPILER_RULES = ("bias", "clock", "matrix")


def test_every_rule_is_documented():
    page = (ROOT / "docs" / "check.md").read_text(encoding="utf-8")
    assert all(f"`{rule}`" in page for rule in (*RULES, *COMPILER_RULES, "compile"))
