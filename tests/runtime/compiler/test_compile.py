"""A graph becomes a program that means the same, or is refused by the rule that it breaks."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.compiler import synapses
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, ends, graph, lif, popsan
from tests.programs import layer

CONVENTION = Convention(1e-3)


def affine(fan_in, size, gain=2.0):
    rng = np.random.default_rng(fan_in + size)
    return nir.Affine(gain * rng.normal(size=(size, fan_in)) / fan_in**0.5, rng.normal(size=size))


def skipping():
    """Two layers, and a connection from the input that skips the first."""
    edges = "input->a, a->l1, l1->b, b->l2, input->c, c->l2, l2->output"
    nodes = {"a": affine(8, 6), "b": affine(6, 5), "c": affine(8, 5), "l1": cuba(6), "l2": cuba(5)}
    return Artifact(graph(edges, **ends(8, 5), **nodes), None, CONVENTION)


def recurrent():
    """A layer connected to itself, and a second one."""
    edges = "input->a, a->l1, l1->r, r->l1, l1->b, b->l2, l2->c, c->output"
    nodes = {
        "a": affine(8, 6), "r": affine(6, 6), "b": affine(6, 5), "c": affine(5, 3),
        "l1": cuba(6), "l2": lif(5, tau=0.004, r=4.0, threshold=0.3),
    }  # fmt: skip
    return Artifact(graph(edges, **ends(8, 3), **nodes), None, CONVENTION)


def integrating():
    """Neurons without leak, with bias, that weights reach only through a Linear node."""
    neurons = nir.IF(np.full(6, 1000.0), np.full(6, 1.0))
    nodes = [nir.Linear(affine(8, 6).weight), neurons]
    return Artifact(chain(*nodes, width=8, act=6), None, CONVENTION)


def with_gains():
    """Neurons whose gains are not 1, and that leak toward something else than 0."""
    values = (0.004, 0.01, 1.7, 0.3, 0.5)
    neurons = nir.CubaLIF(*(np.full(6, v) for v in values), w_in=np.full(6, 2.5))
    return Artifact(chain(affine(8, 6, gain=5.0), neurons, width=8, act=6), None, CONVENTION)


NETWORKS = [popsan, skipping, recurrent, integrating, with_gains]


def changed(artifact, **convention):
    return replace(artifact, convention=replace(artifact.convention, **convention))


def raster(program, batch=3, timesteps=12):
    shape = (batch, timesteps, program.width)
    return (np.random.default_rng(1).random(shape) < 0.3).astype(np.uint8)


@pytest.mark.parametrize("build", NETWORKS)
@pytest.mark.parametrize(
    "convention",
    [
        {},
        {"reset": "subtract"},
        {"integrator": "exponential"},
        {"state": "kept"},
        {"delay": 1},
        {"delay": 1, "state": "kept"},
    ],
    ids=str,
)
def test_the_ideal_chip_equals_the_float_graph(build, convention):
    check_against_float(changed(build(), **convention))


def check_against_float(artifact):
    twin, program = FloatGraph(artifact), compile_program(artifact, chip("ideal"))
    machine = Machine(program, batch=3, trace=True)
    for _ in range(2):
        spikes = raster(program)
        expected = twin.run(spikes)
        output = machine.infer(spikes)
        for name, found in machine.recordings.items():
            np.testing.assert_array_equal(found.spikes, expected[name])
            assert found.spikes.any()
        np.testing.assert_allclose(output, expected["output"], atol=1e-12)


def slow(artifact, bias=1.0):
    """The same network with decays and thresholds that a chip holds exactly, whole weights too."""
    nodes = dict(artifact.graph.nodes)
    for name, node in nodes.items():
        if isinstance(node, nir.Affine) and name != "n7":
            weight = np.round(node.weight * 60).clip(-255, 255)
            weight[0, 0] = 255  # so that the scale is 1
            nodes[name] = nir.Affine(weight, np.round(bias * node.bias * 100).clip(-255, 255))
        if isinstance(node, nir.CubaLIF):
            nodes[name] = cuba(node.r.size, alpha=0.5, beta=0.75, threshold=100.0)
    return replace(artifact, graph=nir.NIRGraph(nodes, artifact.graph.edges))


@pytest.mark.parametrize("build", [popsan, skipping])
def test_staggered_biases_make_a_delaying_chip_mean_the_same(build):
    artifact = slow(build())
    # decays without rounding: what differs then is time alone
    delayed = compile_program(artifact, chip("loihi1"))
    prompt = compile_program(artifact, chip("loihi1", delay=0))
    spikes = raster(delayed)
    first, second = Machine(delayed, 3, trace=True), Machine(prompt, 3, trace=True)
    np.testing.assert_array_equal(first.infer(spikes), second.infer(spikes))
    for name, found in first.recordings.items():
        np.testing.assert_array_equal(found.membrane, second.recordings[name].membrane)
        assert found.spikes.any()


def test_layers_start_when_the_input_can_have_reached_them():
    program = compile_program(popsan(), chip("loihi1"), clock="gated")
    assert [layer.start for layer in program.layers] == [1, 2, 3]
    assert program.steps(5) == 8
    assert program.lags == ((0,), (0,), (0,))
    assert [layer.start for layer in compile_program(popsan(), chip("ideal")).layers] == [0, 0, 0]


def test_gains_are_folded_into_weights_and_biases():
    artifact = with_gains()
    layer = compile_program(artifact, chip("ideal")).layers[0]
    node = artifact.graph.nodes["n1"]
    # (dt / tau_syn) w_in (dt / tau_mem) r
    gain = (1 / 4) * 2.5 * (1 / 10) * 1.7
    np.testing.assert_allclose(layer.synapses[0].weight, node.weight.T * gain)
    np.testing.assert_allclose(layer.bias, node.bias * gain)
    # (dt / tau_mem) v_leak
    np.testing.assert_allclose(layer.voltage_bias, 0.1 * 0.3)


def reset_elsewhere():
    nodes = [affine(8, 6), cuba(6)]
    nodes[1].v_reset = np.full(6, 0.1)
    return Artifact(chain(*nodes, width=8, act=6), None, CONVENTION)


def leaky_between():
    nodes = [affine(8, 6), nir.LI(*(np.full(6, v) for v in (0.01, 1.0, 0.0))), cuba(6)]
    return Artifact(chain(*nodes, width=8, act=6), None, CONVENTION)


def long_loop():
    edges = "input->a, a->l1, l1->b, b->l2, l2->r, r->l1, l2->output"
    nodes = {"a": affine(8, 6), "b": affine(6, 5), "r": affine(5, 6), "l1": cuba(6), "l2": cuba(5)}
    return Artifact(graph(edges, **ends(8, 5), **nodes), None, CONVENTION)


def no_neurons():
    return Artifact(chain(affine(8, 6), width=8, act=6), None, CONVENTION)


@pytest.mark.parametrize(
    ("artifact", "message"),
    [
        (reset_elsewhere(), "layer 'n2': v_reset"),
        (leaky_between(), "node 'n2': LI does not spike, and node 'n3' receives its membranes"),
        (long_loop(), "layers 'l2' -> 'l1': the feedback would have to arrive"),
        (no_neurons(), "node 'output': the output must come from neurons"),
        (changed(popsan(), reset="subtract"), "'subtract': a spike on loihi1 can only do 'zero'"),
        (skipping(), "need a delay of 2 timesteps; loihi1 has at most 1"),
    ],
)
def test_what_a_chip_cannot_do_is_refused_by_name(artifact, message):
    with pytest.raises(RuleError, match=message):
        compile_program(artifact, chip("loihi1", delay_max=1))


def test_a_long_loop_runs_when_every_connection_takes_a_timestep():
    program = compile_program(long_loop(), chip("loihi1"), clock="pipelined")
    assert Machine(program, 3).infer(raster(program)).any()


def test_weights_of_zero_behind_delays_keep_the_shortest():
    late = nir.Delay(np.array([0.0, 0.001, 0.002, 0.0]))
    nodes = [late, nir.Linear(np.zeros((3, 4))), cuba(3)]
    artifact = Artifact(chain(*nodes, width=4, act=3), None, CONVENTION)
    (only,) = compile_program(artifact, chip("ideal")).layers
    assert [synapses.delay for synapses in only.synapses] == [0]


def placed(matrix):
    """A layer whose spikes reach the output through this matrix (act, N)."""
    act, size = np.shape(matrix)
    nodes = [affine(8, size, gain=5.0), cuba(size), nir.Linear(np.array(matrix, float))]
    return Artifact(chain(*nodes, width=8, act=act), None, CONVENTION)


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(3),
        [[1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[1, 0], [0, 2]],
        [[1, 1], [0, 1]],
        [[1, 0, 0], [0, 1, 0]],
        [[1, 0], [0, 1], [0, 0]],
    ],
)
def test_only_the_identity_passes_spikes_on_as_they_are(matrix):
    artifact = placed(matrix)
    program = compile_program(artifact, chip("ideal"))
    assert (program.readout is None) == np.array_equal(matrix, np.eye(3))
    given = raster(program)
    expected = FloatGraph(artifact).run(given)["output"]
    assert expected.any()
    np.testing.assert_allclose(Machine(program, 3).infer(given), expected)


def test_a_spike_cannot_arrive_at_once_at_a_layer_that_came_before():
    weight = np.ones((1, 1))
    wires = (Synapses("input", weight, 0), Synapses("a", weight, 1))
    fine = layer(chip("loihi1").arithmetic, "a", weight, wires, decays=(0, 0), threshold=64)

    def program(delay):
        looped = replace(fine, synapses=(wires[0], replace(wires[1], delay=delay)))
        return Program(chip("ideal"), CONVENTION, "input", 1, (looped,), "a", None)

    assert program(1).lags == ((0, 1),)
    with pytest.raises(RuleError, match=r"^rule delay: layer 'a': the synapses from 'a' deliver"):
        program(0)


def test_finding_a_matrix_may_take_exactly_so_many_multiplications(monkeypatch):
    # 4 kernels of 9 weights at 3 x 3 places, then a pool of one, and what they put out, for each of
    # 25 impulses: two maps without neurons between them
    convolution = nir.Conv2d(
        input_shape=(5, 5), weight=np.ones((4, 1, 3, 3)), stride=1, padding=0, dilation=1,
        groups=1, bias=np.zeros(4),
    )  # fmt: skip
    pool = nir.SumPool2d(np.array([1, 1]), np.array([1, 1]), np.array([0, 0]))
    nodes = [convolution, pool, nir.Flatten({"input": np.array([4, 3, 3])}, 0, -1), cuba(36)]
    artifact = Artifact(chain(*nodes, width=(1, 5, 5), act=36), None, CONVENTION)
    needed = 25 * (4 * 9 * 9 + 36 + 36)
    monkeypatch.setattr(synapses, "_MAX_WORK", needed)
    compile_program(artifact, chip("ideal"))
    monkeypatch.setattr(synapses, "_MAX_WORK", needed - 1)
    with pytest.raises(RuleError, match=f"takes {needed} multiplications; at most {needed - 1}"):
        compile_program(artifact, chip("ideal"))


@pytest.mark.parametrize("asked", [{"spikes": "many"}, {"floor": "zero"}, {"floor": "threshold"}])
def test_a_chip_refuses_the_spikes_and_the_floor_that_it_has_not(asked):
    convention = replace(CONVENTION, reset="subtract")
    artifact = Artifact(chain(affine(8, 6), cuba(6), width=8, act=6), None, convention)
    compile_program(artifact, chip("int"))
    ((name, value),) = asked.items()
    with pytest.raises(RuleError, match=f"^rule convention: .*{name} '{value}'.* on int sends one"):
        compile_program(changed(artifact, **asked), chip("int"))


def test_the_output_is_the_layer_on_the_chip_that_leaves_it_first():
    readout = nir.LI(*(np.full(2, v) for v in (0.01, 1.0, 0.0)))
    nodes = {
        "input": nir.Input(np.array([8])), "first": nir.Output(np.array([6])),
        "second": nir.Output(np.array([2])), "w1": affine(8, 6), "w2": affine(6, 5),
        "w3": affine(5, 2), "l1": cuba(6), "l2": cuba(5), "r": readout,
    }  # fmt: skip
    edges = "input->w1, w1->l1, l1->w2, w2->l2, l2->w3, w3->r, r->second, l1->first"
    artifact = Artifact(graph(edges, **nodes), None, CONVENTION)
    program = compile_program(artifact, chip("loihi1:membrane_output=none"))
    assert [each.name for each in program.host] == ["r"]
    assert program.output == "l1"
