"""The commands on event-driven policies: from a recipe to reports of the file."""

import json

import pytest

from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.runtime.artifact.artifact import load
from tests import toy_stroll_env
from tests.delta_policies import delta_policy


@pytest.fixture
def stroll(monkeypatch, tmp_path):
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("spikedeploy.trainers.sparse.sparse._ENV_COPIES", 1)
    return tmp_path


@pytest.fixture(params=[6, 0], ids=["neurons", "linear"])
def event(request, stroll):
    # gated: all spikes of a raster arrive within it
    policy = delta_policy(obs=3, hidden=request.param, left=1.0, clock="gated")
    return to_nir(policy, toy_stroll_env.ORIGIN, stroll / "event.nir")


def test_a_recipe_is_trained_to_a_budget_exported_and_run(command, stroll):
    changes = ("--set", "env.name=stroll", "--set", "teacher=zoo/stroll/sac.onnx")
    code, out, err = command("train", "smoke-sparse", "--budget", "sops=4", *changes, "--json")
    assert (code, err) == (0, "")
    run = json.loads(out)["run"]
    assert json.loads((stroll / run / "config.json").read_text())["budget"] == 4
    code, out, _ = command("export", run, "--to", "nir", "--observations", 30, "--json")
    found = json.loads(out)
    assert (code, found["passed"]) == (0, True)
    assert load(found["path"]).convention.state == "kept"
    code, _, err = command("export", run, "--to", "nir", "--state", "reset")
    assert code == 2
    assert "keeps its states through an episode" in err
    code, out, _ = command("export", run, "--to", "onnx", "--json")  # one step of it
    assert (code, json.loads(out)["passed"]) == (0, True)


@pytest.mark.parametrize("chip", ["float", "loihi1", "loihi2", "loihi1:membrane_output=none"])
def test_a_file_runs_and_says_where_it_is_read(chip, command, event):
    code, out, err = command("run", event, "--chip", chip, "--episodes", 2, "--json")
    linear = "lif1" not in load(event).graph.nodes
    if linear and "none" in chip:
        assert code == 1
        assert "the host would compute everything" in err
        return
    assert code == 0
    found = json.loads(out)
    [row] = found["rows"]
    assert row["input_spikes_per_inference"] > 0
    assert row["sops_per_inference"] > 0
    assert (row["sparsity"] is None) == linear
    remarks = [each for of in found["remarks"].values() for each in of]
    assert any("readout 'readout'" in each for each in remarks) == (chip != "float")


def test_drift_compares_what_spikes_and_the_actions(command, event):
    for options in ((), ("--quantise", "channel")):
        code, out, _ = command("drift", event, "--steps", 12, *options, "--json")
        found = json.loads(out)
        assert code == 0
        spiking = ["lif1"] if "lif1" in load(event).graph.nodes else []
        assert [layer["name"] for layer in found["layers"]] == spiking
        assert found["output"]["kind"] == "action"
        assert 0 < found["output"]["rms"] < 0.5
        # the network is gated and keeps its states, and layers of the chip run free
        assert [rung["name"] for rung in found["rungs"]][:2] == ["clock", "weights"]
