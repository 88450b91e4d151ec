"""What the commands measure and price: NeuroBench's numbers, memory, energies by chosen tables."""

import json

import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import save
from tests import toy_stroll_env
from tests.networks import popsan


@pytest.fixture
def emulate(tmp_path):
    """The words that play a raster into a small network on Loihi."""
    save(popsan(), tmp_path / "p.nir")
    raster = (np.random.default_rng(0).random((5, 30)) < 0.3).astype(np.uint8)
    np.save(tmp_path / "raster.npy", raster)
    words = ("emulate", tmp_path / "p.nir", "--input", tmp_path / "raster.npy", "--chip", "loihi1")
    return (*words, "-o", tmp_path / "out.npz")


def test_emulate_measures_what_neurobench_does_and_counts_by_layer(command, emulate):
    # NeuroBench knows no timesteps behind the last row, in which layers of a chip run on
    gated = ["loihi1:clock=gated" if word == "loihi1" else word for word in emulate]
    found = json.loads(command(*gated, "--json")[1])
    measures = found["neurobench"]
    assert measures["SynapticOperations"]["Effective_MACs"] == 0
    assert measures["SynapticOperations"]["Effective_ACs"] >= found["sops"]
    assert found["memory"]["n2"]["weight_reads"] > 0
    assert sum(layer["sop"] for layer in found["events"].values()) == found["sops"]
    assert found["latency_s"].keys() == {"davies2018", "sanafe"}
    assert found["static_energy_j"]["sanafe"] == pytest.approx(0.104 * found["latency_s"]["sanafe"])
    out = command(*emulate, "--tables", "all")[1]
    for name in ("Effective_ACs", "ConnectionSparsity", "MembraneUpdates", "Footprint_packed"):
        assert name in out


def test_emulate_prices_by_the_tables_that_are_named(command, emulate):
    words = (*emulate, "--energy", "odin", "--energy", "spinnaker2")
    found = json.loads(command(*words, "--json")[1])
    assert found["energy_j"].keys() == {"odin", "spinnaker2"}
    low, high = found["energy_interval_j"]["odin"]
    assert (low, high) == pytest.approx([found["energy_j"]["odin"] * x / 12.7 for x in (8.43, 54)])
    printed = command(*words)[1]
    assert "J to " in printed
    assert "by odin; say so where you quote it" in printed
    code, _, err = command(*words, "--energy", "odinn")
    assert code == 2
    assert "did you mean 'odin'" in err


def test_run_prices_by_the_tables_that_are_named(command, monkeypatch, tmp_path):
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    monkeypatch.chdir(tmp_path)
    (row,) = json.loads(command("run", "stroll/popsan", "--energy", "reckon", "--json")[1])["rows"]
    # 5.3 pJ a synaptic operation, those of the biases included
    sops = row["sops_per_inference"] + row["bias_sops_per_inference"]
    assert row["energy_per_inference_j"] == {"reckon": pytest.approx(sops * 5.3e-12)}
