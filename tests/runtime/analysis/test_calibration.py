"""Calibration: what is chosen on a recording holds on that recording."""

from copy import copy
from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.analysis.calibration import tune_to_float, with_calibrated_headroom
from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.analysis.tuned import tuned_artifact
from spikedeploy.runtime.artifact.artifact import Artifact, digest, load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import UNTUNED, Quantisation, Tuning
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from tests.networks import crowd, ends, named_chain, popsan, unit_lif


def some(axons, of=600, timesteps=6):
    raster = np.zeros((1, timesteps, of), np.uint8)
    raster[:, :, :axons] = 1
    return raster


def weight_of(quantisation):
    program = compile_program(crowd(), chip("loihi1"), quantisation)
    return int(program.layers[0].synapses[0].weight[0, 0])


@pytest.mark.parametrize("granularity", ["layer", "channel"])
def test_with_calibrated_headroom_the_ledger_counts_no_saturation(granularity):
    found = with_calibrated_headroom(crowd(), chip("loihi1"), some(600), Quantisation(granularity))
    machine = Machine(compile_program(crowd(), chip("loihi1"), found))
    machine.infer(some(600))
    assert machine.ledger.total("saturation") == 0
    # lava lets the accumulator pass: 2**23 / (600 * 64) = 218.4 of the current, and 2% to be found
    assert 214 <= weight_of(found) <= 218


def test_headroom_is_taken_only_where_the_recording_needs_it():
    found = with_calibrated_headroom(crowd(), chip("loihi1"), some(500))
    # 500 * 255 * 64 = 8,160,000 < 2**23
    assert weight_of(found) == 255
    assert found == Quantisation()


def test_tuning_brings_every_layer_nearer_or_leaves_it():
    artifact, low = popsan(), chip("loihi1", weight_bits=3)
    rng = np.random.default_rng(0)
    raster = (rng.random((20, 5, 30)) < 0.3).astype(np.uint8)
    found = tune_to_float(artifact, low, raster, Quantisation(rounding="truncate"))
    before = drift(artifact, low, raster, Quantisation(rounding="truncate"))
    after = drift(artifact, low, raster, found)
    assert after.layers[0].distance < 0.9 * before.layers[0].distance
    assert found.tuning_for("n2") != UNTUNED
    assert "'n2': reach" in found.describe()


def test_a_chip_of_another_arithmetic_is_not_calibrated():
    with pytest.raises(RuleError, match="ideal: calibration chooses scales"):
        tune_to_float(crowd(), chip("ideal"), some(1))


def mapped():
    """Convolution, pool and dense maps with gains of their own, before LIF neurons."""
    rng = np.random.default_rng(0)
    kernel = nir.Conv2d((8, 8), rng.normal(size=(2, 1, 3, 3)), 1, 1, 1, 1, rng.normal(size=2))
    flat = nir.Flatten({"input": np.array([2, 4, 4])}, 0, -1)
    nodes = {
        "conv": kernel,
        "seen": unit_lif(2, 8, 8, gain=6.0),
        "pool": nir.SumPool2d(np.array([2, 2]), np.array([2, 2]), np.array([0, 0])),
        "flat": flat,
        "dense": nir.Linear(rng.normal(size=(5, 32))),
        "out": nir.LIF(*(np.full(5, v) for v in (4e-3, 3.0, 0.0, 1.3, 0.0))),
    }
    return Artifact(named_chain((1, 8, 8), 5, **nodes), None, Convention(1e-3))


def looped(shared=False):
    """Two layers, the first with weights back to itself, or both behind one map."""
    rng = np.random.default_rng(1)
    nodes = {
        **ends(6, 4),
        "in": nir.Linear(rng.normal(size=(4, 6))),
        "a": unit_lif(4),
        "back": nir.Linear(rng.normal(size=(4, 4))),
        "to_b": nir.Affine(rng.normal(size=(4, 4)), rng.normal(size=4)),
        "b": unit_lif(4),
    }
    edges = [("input", "in"), ("in", "a"), ("a", "back"), ("back", "a"), ("a", "to_b")]
    edges += [("to_b", "b"), ("b", "output"), *([("in", "b")] if shared else [])]
    return Artifact(nir.NIRGraph(nodes, edges, type_check=False), None, Convention(1e-3))


def in_float32(artifact):
    nodes = {name: copy(node) for name, node in artifact.graph.nodes.items()}
    for node in nodes.values():
        for name, value in vars(node).items():
            if isinstance(value, np.ndarray) and value.dtype == np.float64:
                setattr(node, name, value.astype(np.float32))
    graph = nir.NIRGraph(nodes, artifact.graph.edges, type_check=False)
    return replace(artifact, graph=graph)


def integers(artifact, on, quantisation):
    program = compile_program(artifact, on, quantisation)
    return [
        array
        for layer in program.layers
        for array in (layer.threshold, layer.bias, *(s.weight for s in layer.synapses))
    ]


@pytest.mark.parametrize(
    "quantisation",
    [
        Quantisation(),
        Quantisation("channel", "truncate"),
    ],
    ids=["layer", "channel"],
)
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("build", [popsan, mapped, looped])
def test_a_file_of_what_was_tuned_becomes_the_integers_that_were_measured(
    build, precision, quantisation, tmp_path
):
    artifact, on = build(), chip("loihi1", weight_bits=5)
    artifact = in_float32(artifact) if precision == "float32" else artifact
    layers = list(compile_program(artifact, on, quantisation).spiking)
    for ratio, factor in ((1.15, 1.0), (1.0, 0.85), (1.75, 1.05), (3.0, 1.2)):
        tuning = {layer.name: Tuning(ratio, factor) for layer in layers}
        tuned = replace(quantisation, tuned=tuning)
        found = tuned_artifact(artifact, on, "loihi1:weight_bits=5", tuned)
        assert found is not None, (ratio, factor)
        save(found, tmp_path / "tuned.nir")
        read = load(tmp_path / "tuned.nir")
        wanted, got = integers(artifact, on, tuned), integers(read, on, quantisation)
        assert all(map(np.array_equal, wanted, got))
        assert not all(map(np.array_equal, wanted, integers(artifact, on, quantisation)))
        assert "for loihi1:weight_bits=5: " in read.tuned
        assert digest(artifact) in read.tuned
        assert f"thresholds times {factor:.3g}" in read.tuned


def test_a_file_keeps_where_a_policy_is_from_and_says_that_it_is_another(tmp_path):
    artifact = popsan()
    tuned = Quantisation(tuned={"n2": Tuning(2.0, 1.1)})
    found = tuned_artifact(artifact, chip("loihi1"), "loihi1", tuned)
    save(found, tmp_path / "tuned.nir")
    read = load(tmp_path / "tuned.nir")
    assert (read.provenance.env, read.provenance.seed) == ("spikedeploy/Hexapod-v0", 3)
    assert read.provenance.sha256 == digest(read) != digest(artifact)
    assert read.tuned.startswith("by drift --tune for loihi1: ")
    # the given policy stays as it was
    assert artifact.tuned == ""
    assert digest(artifact) == digest(popsan())


def test_what_no_file_can_say_is_none():
    on = chip("loihi1")
    below = Quantisation(tuned={"n2": Tuning(0.8)})
    assert tuned_artifact(popsan(), on, "loihi1", below) is None
    clipped, raised = ({"b": Tuning(*factors)} for factors in ((2.0, 1.0), (1.0, 1.1)))
    both = looped(shared=True)  # to clip the weights of one layer would clip those of the other
    assert tuned_artifact(both, on, "loihi1", Quantisation(tuned=clipped)) is None
    assert tuned_artifact(both, on, "loihi1", Quantisation(tuned=raised)) is not None


def test_tuning_for_a_file_leaves_out_what_it_cannot_say():
    artifact, low = popsan(), chip("loihi1", weight_bits=3)
    raster = (np.random.default_rng(0).random((20, 5, 30)) < 0.3).astype(np.uint8)
    found = tune_to_float(artifact, low, raster, possible=lambda tried: False)
    assert all(each == UNTUNED for each in found.tuned.values())
