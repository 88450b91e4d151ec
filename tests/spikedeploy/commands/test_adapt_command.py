"""`adapt` as typed: the file, the verdict, what stops it and what goes on."""

import json
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import spikedeploy as sd  # noqa: E402
from spikedeploy.trainers import adapt as adapting  # noqa: E402
from tests.paths import ROOT  # noqa: E402

NET = ROOT / "examples" / "net.nir"
NEAREST = "the network resets by 'subtract', which loihi1 does not; trained is the nearest"
QUICK = ("--dt", "1e-3", "--epochs", "2", "--batch", "8")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a network, samples for it, and labels."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(NET, "net.nir")
    takes, puts = (
        next(iter(nodes.values())).input_type["input"]
        for graph in [sd.load("net.nir", dt=1e-3).artifact.graph]
        for nodes in (graph.inputs, graph.outputs)
    )
    rng = np.random.default_rng(0)
    np.save("raster.npy", (rng.random((20, 12, *takes)) < 0.5).astype(np.uint8))
    np.save("labels.npy", rng.integers(puts[0], size=20))
    return tmp_path


def adapt(command, *words, chip="loihi1"):
    return command("adapt", "net.nir", "--for", chip, "--input", "raster.npy", *QUICK, *words)


def test_it_writes_a_file_that_fits_and_prints_the_scores(folder, command):
    code, out, err = adapt(command, "--labels", "labels.npy")
    assert code == 0, err
    assert "4 samples held out of 20" in out
    for line in ("float ", "float weights on loihi1", "adapted to loihi1", "✓ loihi1"):
        assert line in out
    assert "wrote net.loihi1.nir" in out
    assert sd.load("net.loihi1.nir").check("loihi1").passed
    assert sorted(path.name for path in folder.iterdir()) == [
        "labels.npy", "net.loihi1.nir", "net.nir", "raster.npy",
    ]  # fmt: skip


def test_as_json_it_has_scores_and_verdict_and_a_second_time_the_file_is_its_own(folder, command):
    for _ in range(2):
        code, out, err = adapt(command, "--json")
        assert code == 0, err
    found = json.loads(out)
    assert found["samples"] == {"trained": 16, "held_out": 4}
    assert found["float"]["agreement"] == 1
    assert found["float"]["accuracy"] is None
    assert found["check"]["passed"]
    assert found["path"] == "net.loihi1.nir"
    assert {"before", "after", "updates", "finished"} <= found.keys()


def test_ctrl_c_in_training_keeps_a_checkpoint_and_resume_ends_with_the_same_file(
    folder, command, monkeypatch
):
    assert adapt(command, "-o", "whole.nir")[0] == 0
    step = adapting._Training._step

    def stopping(self, in_epoch):
        self._stopped.requested = 2  # SIGINT
        return step(self, in_epoch)

    with monkeypatch.context() as patch:
        patch.setattr(adapting._Training, "_step", stopping)
        code, out, err = adapt(command)
    assert (code, out) == (130, "")
    assert "stopped after 1 updates; --resume goes on" in err
    assert "Traceback" not in err
    code, _, err = adapt(command)
    assert code == 2
    assert "--resume goes on with it" in err
    code, _, err = adapt(command, "--resume", "--seed", "1")
    assert code == 2
    assert "begun with another seed" in err
    assert adapt(command, "--resume")[0] == 0
    first, second = (sd.load(name).artifact for name in ("whole.nir", "net.loihi1.nir"))
    assert adapting.digest(first) == adapting.digest(second)
    assert not list(folder.glob("*checkpoint*"))


@pytest.mark.parametrize("place", ["_float_outputs", "_clip"])
def test_ctrl_c_before_training_writes_nothing(place, folder, command, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(adapting._Training, place, stop)
    code, _, err = adapt(command)
    assert code == 130
    assert "nothing was trained, nothing is written" in err
    assert len(list(folder.iterdir())) == 3


def test_inputs_are_never_overwritten(folder, command):
    for name in ("net.nir", "raster.npy", "labels.npy"):
        before = (folder / name).read_bytes()
        code, _, err = adapt(command, "--labels", "labels.npy", "-o", name, "--force")
        assert code == 2
        assert "is the input" in err
        assert (folder / name).read_bytes() == before
    shutil.copy("net.nir", "other.nir")
    code, _, err = adapt(command, "-o", "other.nir")
    assert code == 2
    assert "--force" in err


def test_what_does_not_fit_is_named_before_training_and_trained_with_limits_off(folder, command):
    code, _, err = adapt(command, chip="xylo-a2:inputs=1")
    assert code in (1, 2)
    assert len(err.strip().splitlines()) == 1
    assert not list(folder.glob("net.*.nir"))


def test_a_reset_that_the_chip_lacks_is_named_in_a_line_of_its_own(folder, command):
    code, _, err = adapt(command, "--reset", "subtract")
    assert code == 0
    assert "\n" + NEAREST in "\n" + err


def test_resume_without_a_checkpoint_is_a_sentence(folder, command):
    code, _, err = adapt(command, "--resume")
    assert code == 2
    assert "there is nothing to resume" in err
