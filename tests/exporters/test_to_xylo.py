"""Rockpool's specification of a Xylo computes what the emulated chip does."""

import json

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from spikedeploy.exporters.to_xylo import places, specification
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.traces.fields import Fields
from spikedeploy.runtime.traces.layered import xylo_trace
from tests.xylo_networks import network, random_networks

STEPS = 60


def program_of(artifact):
    try:
        return compile_program(artifact, chip("xylo-a2"), limits=False)
    except RuleError:  # a threshold or all weights of a layer that come out as 0
        reject()


def wait_of(program):
    """Timesteps that an input waits, so that layers start together."""
    synapses = [each for layer in program.layers for each in layer.synapses]
    return next(each.delay for each in synapses if each.source == program.input)


def spikes_by(program, spec, timesteps):
    """Spikes of every layer, of the program and by a specification that is read as a trace."""
    raster = (np.random.default_rng(0).random((1, timesteps, program.width)) < 0.3).astype(np.uint8)
    wait, steps = wait_of(program), program.steps(program.rows(timesteps))
    played = np.zeros((steps, program.width), np.uint8)
    played[wait : wait + timesteps] = raster[0, : steps - wait]
    renamed = {("bias" if name == "bias_hidden" else name): rows for name, rows in spec.items()}
    silent = [[0] * len(spec["threshold_out"])] * steps
    record = {**renamed, "input_counts": played.tolist(), "out_spikes": silent}
    read = xylo_trace(Fields({"params": record}, "the specification"), program.chip.name)
    ran, wanted = trace(read.program, read.raster), trace(program, raster)
    first = {**places(program.layers[:-1]), program.output: 0}
    for layer in program.layers:
        rows = ran["output" if layer.name == program.output else "hidden"].spikes[0]
        own = slice(first[layer.name], first[layer.name] + layer.size)
        found = rows[layer.start : layer.start + timesteps, own]
        yield found, wanted[layer.name].spikes[0]


def test_the_specification_has_the_arguments_of_rockpool_and_each_of_them_counts():
    rng = np.random.default_rng(1)
    program = program_of(network(rng, [6, 12, 5, 4], ["cuba"] * 3, loops={1}, biased=True))
    spec = {name: np.array(value) for name, value in specification(program).items()}
    assert spec["weights_in"].shape == (6, 17, 1)
    assert spec["weights_rec"].shape == (17, 17, 1)
    assert spec["weights_out"].shape == (17, 4)
    assert places(program.layers[:-1]) == {"l1": 0, "l2": 12}
    assert {name for name in spec if name.endswith("_out")} == {
        "weights_out", "dash_mem_out", "dash_syn_out", "threshold_out", "bias_out",
        "weight_shift_out",
    }  # fmt: skip
    for name in ("threshold", "dash_mem", "bias_hidden"):
        changed = specification(program)
        changed[name] = [number + 3 for number in changed[name]]
        assert any((one != other).any() for one, other in spikes_by(program, changed, 200))


@settings(max_examples=8)
@given(random_networks())
def test_specifications_of_random_networks_compute_the_same_spikes(artifact):
    program = program_of(artifact)
    for found, wanted in spikes_by(program, specification(program), STEPS):
        np.testing.assert_array_equal(found, wanted)


@settings(max_examples=8)
@given(random_networks(), st.integers(0, 2**32 - 1))
def test_xylosim_computes_from_the_specification_what_the_emulated_chip_does(artifact, seed):
    reason = "xylosim is not installed: it needs a C++ compiler"
    pytest.importorskip("xylosim.v2", reason=reason, exc_type=ImportError)
    from lab.peers.traces.xylosim import record

    program = program_of(artifact)
    written = json.loads(json.dumps(specification(program)))
    raster = (np.random.default_rng(seed).random((STEPS, program.width)) < 0.4).astype(np.uint8)
    wait, first = wait_of(program), places(program.layers[:-1])
    played = np.zeros((program.steps(program.rows(STEPS)) + wait, program.width), np.int64)
    played[wait : wait + STEPS] = raster
    found = record({"params": as_xylosim(written), "input_counts": played.tolist()})
    expected = trace(program, raster[None])
    for layer in program.layers:
        apart = layer.name == program.output
        start = 0 if apart else first[layer.name]
        names = ("v_mem_out", "out_spikes") if apart else ("v_mem", "hidden_spikes")
        window = slice(layer.start, layer.start + STEPS), slice(start, start + layer.size)
        membrane, spikes = (np.array(found[name])[window] for name in names)
        np.testing.assert_array_equal(spikes, expected[layer.name].spikes[0])
        np.testing.assert_array_equal(membrane, expected[layer.name].membrane[0])


def as_xylosim(spec):
    """A specification as `record` takes it."""
    size, outputs = len(spec["threshold"]), len(spec["threshold_out"])
    return {
        **spec,
        "weight_shift": [spec[f"weight_shift_{name}"] for name in ("in", "rec", "out")],
        "aliases": [],
        "bias": spec.get("bias_hidden", [0] * size),
        "bias_out": spec.get("bias_out", [0] * outputs),
        "dash_syn_2": spec.get("dash_syn_2", [0] * size),
    }
