"""`verify` of spikes recorded on silicon, in the formats of the NIR paper; no recording is here."""

import json

import nir
import numpy as np
import pytest

from spikedeploy.emulation.raster_emulation import emulate_artifact
from spikedeploy.runtime.artifact.artifact import load as load_artifact
from tests.networks import cuba, graph, lif
from tests.paths import GOLDEN

STEPS, CHANNELS, HIDDEN, CLASSES = 40, 12, 9, 7
LAYER = "lif1.lif"


@pytest.fixture
def braille(tmp_path):
    """The paper's recurrent network, smaller, and an input: (file, raster, its file)."""
    rng = np.random.default_rng(3)
    nodes = {
        "input": nir.Input(np.array([CHANNELS])),
        "fc1": nir.Linear(rng.normal(size=(HIDDEN, CHANNELS))),
        LAYER: cuba(HIDDEN, dt=1e-4),
        "lif1.w_rec": nir.Linear(rng.normal(size=(HIDDEN, HIDDEN)) / 4),
        "fc2": nir.Linear(rng.normal(size=(CLASSES, HIDDEN))),
        "lif2": cuba(CLASSES, dt=1e-4),
        "output": nir.Output(np.array([CLASSES])),
    }
    edges = f"input->fc1, fc1->{LAYER}, {LAYER}->lif1.w_rec, lif1.w_rec->{LAYER}, {LAYER}->fc2"
    nir.write(tmp_path / "net.nir", graph(f"{edges}, fc2->lif2, lif2->output", **nodes))
    raster = (rng.random((STEPS, CHANNELS)) < 0.3).astype(np.uint8)
    return tmp_path / "net.nir", raster, saved(tmp_path / "input.npy", raster)


def saved(path, rows):
    np.save(path, rows)
    return path


def spikes(network, raster, chip="spinnaker2"):
    return emulate_artifact(load_artifact(network, dt=1e-4, reset="zero"), chip, raster).spikes


def verify(command, recording, network, source, *more, chip="spinnaker2"):
    words = ("--network", network, "--chip", chip, "--input", source, "--dt", 1e-4)
    return command("verify", recording, *words, "--reset", "zero", *more)


@pytest.mark.parametrize("read", [lambda rows: rows, np.transpose, np.float64])
def test_spikes_of_a_layer_equal_those_of_the_emulated_chip(command, braille, tmp_path, read):
    network, raster, source = braille
    seen = spikes(network, raster)[LAYER]
    code, out, _ = verify(command, saved(tmp_path / "a.npy", read(seen)), network, source)
    assert code == 0
    assert "layer 'lif1.lif' on spinnaker2, 40 timesteps of 9 neurons: 360 of 360 num" in out
    assert f"{seen.sum()} spikes recorded, {seen.sum()} emulated, {seen.sum()} the same" in out
    assert seen.any()
    source = saved(tmp_path / "none.npy", 0 * raster)
    code, _, said = verify(command, saved(tmp_path / "a.npy", read(0 * seen)), network, source)
    assert code == 2
    assert "no neuron spikes, neither recorded nor emulated: equal, which says nothing" in said


def test_a_missing_and_an_added_spike_are_counted_and_the_first_is_named(
    command, braille, tmp_path
):
    network, raster, source = braille
    seen = spikes(network, raster)[LAYER]
    other = seen.astype(int)
    (t, n), (late, quiet) = np.argwhere(seen)[5], np.argwhere(seen == 0)[-1]
    other[t, n], other[late, quiet] = 0, 1
    recording = saved(tmp_path / "a.npy", other)
    code, out, _ = verify(command, recording, network, source)
    assert code == 1
    assert "358 of 360 numbers agree" in out
    assert f"first difference: timestep {t}, neuron {n}: recorded 0, emulated 1" in out
    (found,) = json.loads(verify(command, recording, network, source, "--json")[1])
    assert (found["agree"], found["common"]) == (358, seen.sum() - 1)
    assert not found["equal"]


def test_one_layer_of_several_is_compared_alone_by_its_name(command, braille, tmp_path):
    network, raster, source = braille
    seen, both = spikes(network, raster), tmp_path / "both.npz"
    np.savez(both, **{LAYER: seen[LAYER], "lif2": 1 - seen["lif2"]})
    code, out, _ = verify(command, both, network, source, "--layer", LAYER)
    assert (code, "'lif2'" in out) == (0, False)
    assert verify(command, both, network, source, "--layer", "lif2")[0] == 1
    code, _, err = verify(command, both, network, source, "--layer", "lif3")
    assert code == 2
    assert f"no array is called 'lif3', as --layer says; it begins with {LAYER}, lif2" in err


def test_counts_of_several_samples_are_compared_without_their_times(command, tmp_path):
    """Speck's: (bins of half a second, samples, channels, height, width)."""
    rng = np.random.default_rng(0)
    nodes = {
        "input": nir.Input(np.array([2, 4, 4])),
        "conv": nir.Conv2d((4, 4), rng.normal(size=(3, 2, 1, 1)), 1, 0, 1, 1, np.zeros(3)),
        "spikes": nir.IF(np.ones((3, 4, 4)), np.ones((3, 4, 4))),
        "output": nir.Output(np.array([3, 4, 4])),
    }
    nir.write(tmp_path / "scnn.nir", graph("input->conv, conv->spikes, spikes->output", **nodes))
    raster = (rng.random((2, 20, 2, 4, 4)) < 0.3).astype(np.uint8)
    words = ("--chip", "speck2f", "--input", saved(tmp_path / "input.npy", raster))
    seen = [
        emulate_artifact(
            load_artifact(tmp_path / "scnn.nir", reset="subtract"), "speck2f", rows
        ).spikes["spikes"]
        for rows in raster
    ]
    bins = np.stack([[rows[:12].sum(axis=0), rows[12:].sum(axis=0)] for rows in seen], axis=1)
    recording = saved(tmp_path / "speck_activity.npy", bins.astype(np.float32))
    more = ("--network", tmp_path / "scnn.nir", "--reset", "subtract")
    code, out, _ = command("verify", recording, *words, *more)
    assert code == 0
    assert "20 timesteps of 48 neurons in 2 samples: 96 of 96 numbers agree" in out
    assert "times are not compared" in out
    assert "limits off" in command("verify", recording, *words, *more, "--limits", "off")[1]


def test_a_shape_of_two_layers_needs_a_name(command, tmp_path):
    nodes = {
        "input": nir.Input(np.array([3])),
        "a": lif(3),
        "fc": nir.Linear(np.eye(3)),
        "b": lif(3),
        "output": nir.Output(np.array([3])),
    }
    nir.write(tmp_path / "net.nir", graph("input->a, a->fc, fc->b, b->output", **nodes))
    source = saved(tmp_path / "input.npy", np.ones((5, 3), np.uint8))
    words = (saved(tmp_path / "r.npy", np.zeros((5, 3))), tmp_path / "net.nir", source)
    code, _, err = verify(command, *words)
    assert code == 2
    assert "--layer" in err
    assert "no neuron spikes" in verify(command, *words, "--layer", "b")[2]
    assert "'c'" in verify(command, *words, "--layer", "c")[2]


ROWS = (STEPS, HIDDEN)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        *((np.full(ROWS, n), "spikes are 0, 1 or counts of them") for n in (0.5, -1, 2**62)),
        (np.full(ROWS, np.uint64(2**64 - 1)), "such as 1.84467e+19; spikes are"),
        (np.zeros(ROWS, complex), "a.npy holds complex numbers; it must hold spikes"),
        (np.zeros(ROWS, "U3"), "holds text"),
        (np.zeros(ROWS, [("a", "i4"), ("b", "f8")]), "holds records, not numbers"),
        (np.zeros(ROWS, "M8[s]"), "holds dates, not numbers"),
        (np.full(ROWS, np.nan), "holds NaN or infinity"),
        (np.zeros((STEPS, 8)), "(40, 8)"),
    ],
)
def test_what_is_no_recording_of_a_layer_is_refused_in_a_sentence(
    rows, said, command, braille, tmp_path
):
    network, _, source = braille
    code, _, err = verify(command, saved(tmp_path / "a.npy", rows), network, source)
    assert (code, said in " ".join(err.split())) == (2, True), err


TRACE = GOLDEN / "lava_A_popsan_decays.json"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((TRACE, "--dt", 1e-3), "--layer"),
        ((TRACE, "--limits", "off"), "--layer"),
        ((TRACE, "--chip", "loihi2"), "a trace needs no options"),
        (("a.npy",), "give --network and --chip and --input too"),
        (("A.NPY",), "give --network and --chip and --input too"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words, said, command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    saved(tmp_path / "a.npy", np.zeros((3, 2)))
    code, _, err = command("verify", *words)
    assert (code, said in " ".join(err.split())) == (2, True), err
