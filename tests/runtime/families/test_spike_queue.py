"""ODIN's queue as an option of the chip: networks whose spikes go from neuron to neuron on it."""

from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.exporters.c.refusals import check_program
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.running_network import run_network
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.faults import faults
from tests.networks import chain, graph
from tests.rtl_reference import ODIN, odin_trace

WIDTH, FIRST, SECOND = 6, 8, 5


def integrators(*thresholds):
    return nir.IF(np.full(len(thresholds), 1000.0), np.array(thresholds, float))


def layered(seed=0, loop=False):
    """Two layers of whole weights, which ODIN takes as they are; the largest is 7."""
    rng = np.random.default_rng(seed)
    sign = np.where(np.arange(WIDTH) % 3 == 2, -1.0, 1.0)
    first = rng.integers(0, 8, (FIRST, WIDTH)) * sign
    second = rng.integers(0, 8, (SECOND, FIRST)) * np.where(np.arange(FIRST) % 4 == 3, -1.0, 1.0)
    first[0, 0] = second[0, 0] = 7.0
    back = -rng.integers(0, 4, (FIRST, SECOND)) * 1.0
    back[0, 0] = -7.0
    nodes = {
        "input": nir.Input(np.array([WIDTH])),
        "w1": nir.Linear(first),
        "a": integrators(*rng.integers(10, 30, FIRST)),
        "w2": nir.Linear(second),
        "b": integrators(*rng.integers(10, 30, SECOND)),
        "w3": nir.Linear(back),
        "output": nir.Output(np.array([SECOND])),
    }
    edges = "input->w1, w1->a, a->w2, w2->b, b->output" + (", b->w3, w3->a" if loop else "")
    if not loop:
        del nodes["w3"]
    return Artifact(graph(edges, **nodes), None, Convention(1e-3))


def raster(batch=3, steps=30, seed=1):
    return (np.random.default_rng(seed).random((batch, steps, WIDTH)) < 0.5).astype(np.uint8)


def crossbar(program):
    """Thresholds and weights of all neurons side by side, for the plain model."""
    a, b = program.layers
    rec = np.zeros((FIRST + SECOND,) * 2, int)
    weights = np.zeros((WIDTH, FIRST + SECOND), int)
    onto_first = {synapses.source: synapses.weight for synapses in a.synapses}
    weights[:, :FIRST] = onto_first["input"]
    rec[FIRST:, :FIRST] = onto_first.get("b", 0)
    rec[:FIRST, FIRST:] = b.synapses[0].weight
    thr = [*a.threshold.tolist(), *b.threshold.tolist()]
    return {"thr": thr, "leak": [0] * len(thr), "weights": weights.tolist(), "rec": rec.tolist()}


@pytest.mark.parametrize("host", ["wait", "step"])
@pytest.mark.parametrize("loop", [False, True])
def test_layers_and_loops_equal_a_plain_model_of_the_closed_loop(loop, host):
    program = compile_program(layered(loop=loop), chip("odin", queue="on", host=host))
    found = trace(program, raster())
    for copy, rows in enumerate(raster()):
        expected = odin_trace(ODIN, **crossbar(program), inputs=rows.tolist(), host=host)
        membrane = np.concatenate([found[n].membrane[copy] for n in ("a", "b")], axis=1)
        spikes = np.concatenate([found[n].spikes[copy] for n in ("a", "b")], axis=1)
        assert membrane.tolist() == expected["v"]
        assert spikes.tolist() == expected["s"]
    assert found["b"].spikes.any()


def test_without_the_queue_the_host_relays_and_check_says_so():
    off, on = (compile_program(layered(), chip("odin", queue=q)) for q in ("off", "on"))
    assert any("relayed by the host (queue 'off')" in remark for remark in off.remarks)
    assert any("go through the chip's queue" in remark for remark in on.remarks)
    assert "relayed by the host" in check(layered(), chip("odin")).results[-1].note
    looped = compile_program(layered(loop=True), chip("odin", queue="on"))
    assert any("one timestep sooner than in the file" in remark for remark in looped.remarks)
    one = Artifact(chain(nir.Linear(np.eye(3)), integrators(1, 1, 1), width=3, act=3), None,
                   Convention(1e-3))  # fmt: skip
    assert not any("relayed" in remark for remark in compile_program(one, chip("odin")).remarks)


def wide(neurons=40):
    """One input that makes all neurons spike at once, each onto one."""
    return Artifact(
        chain(
            nir.Linear(np.full((neurons, 1), 7.0)), integrators(*[7] * neurons),
            nir.Linear(np.full((1, neurons), 7.0)), integrators(40), width=1, act=1,
        ),
        None,
        Convention(1e-3),
    )  # fmt: skip


def test_spikes_that_find_the_queue_full_are_lost_and_counted():
    machine = Machine(compile_program(wide(), chip("odin", queue="on")), trace=True)
    machine.infer(np.ones((1, 3, 1), np.uint8))
    # 40 spikes at once, of which 31 fit beside the input's event: 9 are lost, three times
    ledger = machine.ledger
    assert ledger.by_layer("lost_spike") == {"n2": 27, "n4": 0}
    assert ledger.by_layer("spike_out")["n2"] == 120
    assert ledger.by_layer("spike_in") == {"n2": 3, "n4": 93}
    assert ledger.by_layer("sop") == {"n2": 120, "n4": 93}
    # 31 times 7, from 0 to 42 at most
    assert machine.recordings["n4"].spikes.sum(axis=(0, 2)).tolist() == [5, 5, 5]
    assert Machine(compile_program(wide(), chip("odin"))).ledger.total("lost_spike") == 0


def test_steps_are_the_timesteps_of_an_inference():
    program = compile_program(layered(loop=True), chip("odin", queue="on"))
    whole, stepped = Machine(program, 3).infer(raster()), Machine(program, 3)
    rows = [stepped.step(raster()[:, t]) for t in range(30)]
    np.testing.assert_array_equal(whole, np.stack(rows, axis=1))


def test_a_bias_is_an_event_after_the_inputs():
    nodes = nir.Affine(np.eye(2) * 7, np.array([0.0, 3.0])), integrators(14, 5)
    network = Artifact(chain(*nodes, width=2, act=2), None, Convention(1e-3))
    rows = np.ones((1, 4, 2), np.uint8)
    first, second = (
        trace(compile_program(network, chip("odin", queue=queue)), rows)["n2"]
        for queue in ("off", "on")
    )
    np.testing.assert_array_equal(first.membrane, second.membrane)
    np.testing.assert_array_equal(first.spikes, second.spikes)


def test_neurons_that_keep_each_other_spiking_are_refused():
    program = compile_program(wide(4), chip("odin", queue="on"))
    a, b = program.layers
    loop = replace(b.synapses[0], source="n4", weight=np.full((1, 1), 7, np.int16), delay=1)
    endless = replace(b, synapses=(*b.synapses, loop), threshold=np.array([7]))
    with pytest.raises(RuleError, match="rule queue: the chip is not done after 16384 events"):
        trace(replace(program, layers=(a, endless)), np.ones((1, 1, 1), np.uint8))


def test_what_has_no_queue_is_refused_in_a_sentence():
    program = compile_program(layered(), chip("odin", queue="on"))
    with pytest.raises(ConfigError, match="supported by interpreter alone"):
        Machine(program, backend="numba")
    with pytest.raises(ConfigError, match="rule queue"):
        check_program(program)
    with pytest.raises(ConfigError, match="queue is 'on' and delay 1"):
        compile_program(layered(), chip("odin", queue="on", delay=1))
    with pytest.raises(ConfigError, match="queue is 'on': lost and spurious spikes"):
        run_network(layered(), chip("odin", queue="on"), faults=faults(["lost-spikes=0.1"]))
