"""A layer that one large number makes coarse says so, with the option that helps, and no other."""

import re
from pathlib import Path

import nir
import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.emulation.raster_emulation import emulate_artifact
from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.convention import Convention

CASE = Path(__file__).parents[2] / "golden" / "outliers"
CHANNEL = Quantisation("channel")
OPTION = "--quantise channel may help"
ROW, COLUMN = "divide the neuron's", "make its weights smaller"
CHIPS = {"loihi1": "zero", "spiker": "zero", "spinnaker2": "zero"}


def test_the_case_of_an_outlier_row_is_a_remark_and_its_option_mends_it():
    artifact = load(CASE / "rows.nir", dt=1e-3, reset="zero")
    raster = np.load(CASE / "x.npy")
    found = {
        name: emulate_artifact(artifact, on, raster, None, **options)
        for name, on, options in (
            ("float", "float", {}),
            ("layer", "loihi1", {}),
            ("channel", "loihi1", {"quantisation": CHANNEL}),
        )
    }
    spikes = {name: each.spikes for name, each in found.items()}
    assert [int(spikes["float"][layer].sum()) for layer in "ab"] == [920, 561]
    differ = {
        name: [int((spikes[name][a] != spikes["float"][a]).sum()) for a in "ab"] for name in spikes
    }
    assert differ == {"float": [0, 0], "layer": [344, 183], "channel": [12, 8]}
    (remark,) = [line for line in found["layer"].remarks if "layer 'a'" in line]
    assert "the largest weight is 92.1 x the others', in neuron 0" in remark
    assert remark.endswith(OPTION)
    assert not any("others'" in line for line in found["channel"].remarks)
    assert drift(artifact, chip("loihi1"), raster[None]).remarks == (remark,)
    assert any(
        remark in result.note for result in check(artifact, chip("loihi1")).results_of("compile")
    )


RNG = np.random.default_rng(0)
INPUT, LOOP = RNG.normal(0, 0.3, (12, 20)), RNG.normal(0, 0.3, (12, 12))
ONES = np.ones(12)


def times(values, place, factor=60.0):
    """The values with those at a place many times as large."""
    found = values.copy()
    found[place] *= factor
    return found


def network(weight, threshold=ONES, bias=None, loop=None):
    """Neurons behind a matrix, and behind one of their own spikes."""
    neurons = nir.LIF(np.full(12, 5e-3), np.full(12, 5.0), np.zeros(12), threshold, np.zeros(12))
    first = nir.Linear(weight) if bias is None else nir.Affine(weight, bias)
    nodes = {"w": first, "a": neurons}
    edges = [("input", "w"), ("w", "a"), ("a", "output")]
    if loop is not None:
        nodes["loop"] = nir.Linear(loop)
        edges += [("a", "loop"), ("loop", "a")]
    ends = {
        "input": nir.Input({"input": np.array([20])}),
        "output": nir.Output({"output": np.array([12])}),
    }
    return nir.NIRGraph({**ends, **nodes}, edges)


def kernels(factor):
    """Neurons behind a convolution, of which one channel is large."""
    weight = times(np.random.default_rng(1).normal(0, 0.3, (4, 2, 3, 3)), 1, factor)
    first = nir.Conv2d((6, 6), weight, 1, 1, 1, 1, np.zeros(4))
    shape = (4, 6, 6)
    threshold = times(np.ones(shape), 1, factor)
    neurons = nir.IF(np.ones(shape), threshold, np.zeros(shape))
    ends = {
        "input": nir.Input({"input": np.array([2, 6, 6])}),
        "output": nir.Output({"output": np.array(shape)}),
    }
    edges = [("input", "w"), ("w", "a"), ("a", "output")]
    return nir.NIRGraph({**ends, "w": first, "a": neurons}, edges)


# what the remark says on a chip with a scale for each neuron, and on one without
NETWORKS = {
    "none": (network(INPUT), "", ""),
    "a row": (network(times(INPUT, 3), times(ONES, 3)), OPTION, ROW),
    "a row 20 times": (network(times(INPUT, 3, 20), times(ONES, 3, 20)), OPTION, ROW),
    "a row 3 times": (network(times(INPUT, 3, 3), times(ONES, 3, 3)), "", ""),
    "three rows": (network(times(INPUT, slice(3)), times(ONES, slice(3))), OPTION, ROW),
    "one weight": (network(times(INPUT, (2, 7), 400)), OPTION, ROW),
    "a column": (network(times(INPUT, (slice(None), 5))), COLUMN, COLUMN),
    "a row of a loop": (network(INPUT, times(ONES, 3), loop=times(LOOP, 3)), OPTION, ROW),
    "a column of a loop": (
        network(INPUT, loop=times(LOOP, (slice(None), 2))),
        COLUMN,
        COLUMN,
    ),
}


@pytest.mark.parametrize("on", CHIPS)
@pytest.mark.parametrize("name", NETWORKS)
def test_each_outlier_is_named_with_what_helps_on_the_chip(name, on):
    made, with_option, without = NETWORKS[name]
    wanted = with_option if "granularity" in chip(on).arithmetic.choices else without
    artifact = Artifact(made, None, Convention(1e-3, CHIPS[on]))
    program = compile_program(artifact, chip(on), limits=False)
    assert [wanted in line for line in program.outliers] == [True] * bool(wanted)
    assert set(program.outliers) <= set(program.remarks)
    if wanted == OPTION:
        assert not compile_program(artifact, chip(on), CHANNEL, limits=False).outliers


@pytest.mark.parametrize(
    ("made", "on", "wanted"),
    [
        (network(INPUT, bias=times(np.full(12, 0.01), 4, 6000)), "loihi1", "largest bias"),
        (network(INPUT, times(ONES, 4, 3e4)), "loihi1", "largest threshold"),
        (kernels(60.0), "loihi1", OPTION),
        (kernels(60.0), "speck2f", ROW),
        (kernels(1.0), "speck2f", ""),
    ],
)
def test_biases_thresholds_and_channels_of_kernels_can_be_outliers(made, on, wanted):
    artifact = Artifact(made, None, Convention(1e-3, chip(on).resets[0]))
    found = compile_program(artifact, chip(on), limits=False).outliers
    assert [wanted in line for line in found] == [True] * bool(wanted)


def test_a_row_divided_as_the_remark_says_is_the_same_in_float_and_no_outlier():
    weight, threshold = times(INPUT, 3), times(ONES, 3)
    before = Artifact(network(weight, threshold), None, Convention(1e-3))
    (remark,) = compile_program(before, chip("spiker"), limits=False).outliers
    factor = 1 / float(re.search(r"threshold by ([0-9.]+)", remark)[1])
    divided = network(times(weight, 3, factor), times(threshold, 3, factor))
    after = Artifact(divided, None, Convention(1e-3))
    assert not compile_program(after, chip("spiker"), limits=False).outliers
    raster = (np.random.default_rng(2).random((50, 20)) < 0.2).astype(np.uint8)
    runs = [emulate_artifact(each, "float", raster, None) for each in (before, after)]
    np.testing.assert_array_equal(*(run.spikes["a"] for run in runs))


@pytest.mark.parametrize("name", [n for n in zoo.names() if zoo.path(n).suffix == ".nir"])
def test_no_shipped_policy_has_an_outlier_on_its_chip(name):
    artifact = load(zoo.path(name))
    on = chip(artifact.trained_for or "loihi1")
    assert not compile_program(artifact, on, limits=False).outliers
