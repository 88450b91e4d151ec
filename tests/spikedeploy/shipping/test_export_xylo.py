"""`export --to xylo`: a specification that computes what the emulated chip does."""

import json

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from spikedeploy.exporters.to_xylo import compare_spikes, document, specification
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import RuleError
from tests.xylo_networks import network, random_networks

STEPS = 60


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Two hidden layers, one of them recurrent, and biases."""
    monkeypatch.chdir(tmp_path)
    artifact = network(
        np.random.default_rng(1), [6, 12, 5, 4], ["cuba"] * 3, loops={1}, biased=True
    )
    save(artifact, tmp_path / "net.nir")
    return artifact


def program_of(artifact):
    try:
        return compile_program(artifact, chip("xylo-a2"), limits=False)
    except RuleError:  # a threshold or all weights of a layer that come out as 0
        reject()


def test_the_file_has_the_arguments_of_rockpool_and_says_where_layers_and_timesteps_are(
    command, file
):
    words = ("export", "net.nir", "--to", "xylo", "--chip", "xylo-a2", "-o", "xylo.json")
    code, out, _ = command(*words)
    assert code == 0
    assert "21,000 compared, all equal" in out
    with open("xylo.json") as text:
        found = json.load(text)
    spec = {name: np.array(value) for name, value in found["specification"].items()}
    assert spec["weights_in"].shape == (6, 17, 1)
    assert spec["weights_rec"].shape == (17, 17, 1)
    assert spec["weights_out"].shape == (17, 4)
    assert found["hidden_layers"] == {"l1": 0, "l2": 12}
    assert (found["output_layer"], found["chip"], found["dt"]) == ("l3", "xylo-a2", 1e-3)
    assert {name for name in spec if name.endswith("_out")} == {
        "weights_out", "dash_mem_out", "dash_syn_out", "threshold_out", "bias_out",
        "weight_shift_out",
    }  # fmt: skip
    assert command(*words)[0] == 0  # its own file is written anew


def test_a_changed_number_of_the_specification_is_found(file):
    program = program_of(file)
    for name in ("threshold", "dash_mem", "bias_hidden"):
        spec = specification(program)
        spec[name] = [number + 3 for number in spec[name]]
        assert not compare_spikes(program, spec, 200).passed


@settings(max_examples=15)
@given(random_networks())
def test_specifications_of_random_networks_compute_the_same_spikes(artifact):
    program = program_of(artifact)
    check = compare_spikes(program, specification(program), STEPS)
    assert check.passed, check.detail


@settings(max_examples=15)
@given(random_networks(), st.integers(0, 2**32 - 1))
def test_xylosim_computes_from_the_specification_what_the_emulated_chip_does(artifact, seed):
    reason = "xylosim is not installed: it needs a C++ compiler"
    pytest.importorskip("xylosim.v2", reason=reason, exc_type=ImportError)
    from lab.peers.traces.xylosim import record

    program = program_of(artifact)
    written = json.loads(json.dumps(document(program, specification(program))))
    raster = (np.random.default_rng(seed).random((STEPS, program.width)) < 0.4).astype(np.uint8)
    output = program.layer(program.output)
    wait = output.start - written["late"]
    played = np.zeros((program.steps(program.rows(STEPS)) + wait, program.width), np.int64)
    played[wait : wait + STEPS] = raster
    found = record(
        {"params": as_xylosim(written["specification"]), "input_counts": played.tolist()}
    )
    expected = trace(program, raster[None])
    for layer in program.layers:
        apart = layer.name == program.output
        first = 0 if apart else written["hidden_layers"][layer.name]
        names = ("v_mem_out", "out_spikes") if apart else ("v_mem", "hidden_spikes")
        window = slice(layer.start, layer.start + STEPS), slice(first, first + layer.size)
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
