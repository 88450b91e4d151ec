"""Xylo from the command line: the same commands as for any chip."""

import json
from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.machine import Machine
from tests import toy_stroll_env
from tests.networks import popsan
from tests.xylo_networks import network

CHIPS = ["xylo-a2", "xylo-a3", "xylo-imu"]


@pytest.fixture
def files(tmp_path):
    """A network that says nothing of its convention, and spikes for it."""
    artifact = network(np.random.default_rng(1), [16, 20, 8], ["cuba"] * 2, loops={1})
    nir.write(tmp_path / "net.nir", artifact.graph)
    raster = (np.random.default_rng(0).random((60, 16)) < 0.2).astype(np.uint8)
    np.save(tmp_path / "spikes.npy", raster)
    return tmp_path / "net.nir", tmp_path / "spikes.npy", artifact, raster


@pytest.mark.parametrize("name", CHIPS)
def test_emulate_plays_a_foreign_network(name, files, command, tmp_path):
    net, spikes, artifact, raster = files
    words = ("emulate", net, "--chip", name, "--reset", "subtract", "--input", spikes)
    code, out, err = command(*words, "-o", tmp_path / "out.npz", "--json")
    assert code == 0, err
    machine = Machine(compile_program(artifact, chip(name)), trace=True)
    expected = machine.infer(raster[None])[0]
    with np.load(tmp_path / "out.npz") as found:
        np.testing.assert_array_equal(found["output"], expected)
        np.testing.assert_array_equal(found["l1"], machine.recordings["l1"].spikes[0])
    document = json.loads(out)
    assert document["sops"] == machine.ledger.total("sop")
    assert any("up to 31 times in a timestep" in remark for remark in document["remarks"])


def test_emulate_refuses_a_reset_to_zero(files, command, tmp_path):
    net, spikes, *_ = files
    words = ("emulate", net, "--chip", "xylo-a2", "--input", spikes, "-o", tmp_path / "out.npz")
    code, _, err = command(*words)
    assert code == 1
    assert "reset 'zero': a spike on xylo-a2 can only do 'subtract'" in err
    assert "give it as an option (--reset subtract)" in err
    code, out, _ = command("check", net, "--chip", "xylo-a2")
    assert code == 1
    assert "give it (--reset subtract)" in out


def test_a_policy_on_xylo_acts_in_its_environment(command, monkeypatch, tmp_path):
    toy_stroll_env.install(monkeypatch)
    policy = popsan()
    convention = replace(policy.convention, reset="subtract")
    save(
        replace(policy, convention=convention, provenance=toy_stroll_env.ORIGIN),
        tmp_path / "policy.nir",
    )
    words = (tmp_path / "policy.nir", "--chip", "xylo-a2", "--env", "stroll", "--json")
    code, _, err = command("run", *words)
    assert code == 1
    assert "rule inputs: the network has 30 inputs; xylo-a2 has at most 16" in err
    code, out, err = command("run", *words, "--limits", "off")
    assert code == 0, err
    (row,) = json.loads(out)["rows"]
    assert row["chip"] == "xylo-a2"
    assert row["sops_per_inference"] > 0
    assert row["sparsity"] is None  # neurons of Xylo spike several times in a timestep


def test_emulate_shifts_the_weights_of_a_xylo(files, command, tmp_path):
    net, spikes, artifact, raster = files
    words = ("emulate", net, "--reset", "subtract", "--input", spikes, "-o", tmp_path / "out.npz")
    code, _, err = command(*words, "--chip", "xylo-a2", "--weight-shift", "4")
    assert code == 0, err
    program = compile_program(artifact, chip("xylo-a2"), Quantisation(weight_shift=4))
    with np.load(tmp_path / "out.npz") as found:
        np.testing.assert_array_equal(found["output"], Machine(program).infer(raster[None])[0])
    code, _, err = command(*words, "--chip", "int", "--weight-shift", "4")
    assert code == 2
    assert "weight_shift is 4: int has no shift" in err
