"""Files that end in readouts, on the command line: check, emulate, drift, and a robot's loop."""

import json

import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import save
from tests.readouts import ACTIONS, events, network


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for kind in ("second", "only"):
        save(network(kind), tmp_path / f"{kind}.nir")
    np.save(tmp_path / "raster.npy", events()[0])
    return tmp_path


def told(command, *arguments):
    code, out, err = command(*arguments)
    assert (code, err) == (0, ""), err
    return out


def emulated(command, file, chip_name, *more):
    return told(
        command, "emulate", file, "--chip", chip_name, "--input", "raster.npy", "-o", "o.npz", *more
    )


@pytest.mark.parametrize("file", ["second.nir", "only.nir"])
def test_emulate_reports_readouts_apart_from_spiking_layers(command, files, file):
    found = json.loads(emulated(command, file, "loihi1", "--json"))
    assert "fast" in found["readouts"]
    assert not found["readouts"].keys() & found["layers"].keys()
    each = [*found["layers"].values(), *found["readouts"].values()]
    assert sum(layer["sops"] for layer in each) == found["sops"]
    assert found["readouts"]["fast"]["messages"] >= 25 * ACTIONS
    assert found["host"] is None
    assert any("net spikes over a heaviest synapse" in remark for remark in found["remarks"])
    twin = json.loads(emulated(command, file, "float", "--json"))
    if file == "only.nir":  # no spike of a hidden neuron that rounding could move
        assert twin["sops"] == found["sops"]
    assert np.load("o.npz")["output"].shape == (25, ACTIONS)


def test_emulate_counts_what_the_host_computes(command, files):
    found = json.loads(emulated(command, "second.nir", "loihi1:membrane_output=none", "--json"))
    # a membrane, and a current with its membrane, of three neurons each, in 25 timesteps
    assert found["host"]["multiplications"] == 25 * 3 * ACTIONS
    assert found["host"]["additions"] > 0
    text = emulated(command, "second.nir", "loihi1:membrane_output=none")
    assert f"{25 * 3 * ACTIONS} multiplications" in text


def test_check_tells_the_range_and_the_way_out(command, files):
    text = told(command, "check", "second.nir", "--chip", "loihi1", "--rules")
    assert "the membranes of 3 neurons leave loihi1" in text
    assert "readout 'fast': its leaks do not bound what it adds up" in text
    (found,) = json.loads(told(command, "check", "second.nir", "--chip", "loihi2", "--json"))[
        "chips"
    ]
    assert found["membrane_output"] == "graded"
    assert found["passed"]


@pytest.mark.parametrize("file", ["second.nir", "only.nir"])
def test_drift_has_a_table_of_readouts(command, files, file):
    text = told(command, "drift", file, "--chip", "loihi1", "--input", "raster.npy")
    assert "Readouts" in text
    assert "filled" in text
    found = json.loads(told(command, "drift", file, "--input", "raster.npy", "--json"))
    assert "fast" in json.dumps(found)
