"""Xylo from the command line: the same commands as for any chip."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.machine import Machine
from tests.xylo_networks import network


@pytest.fixture
def files(tmp_path):
    """A network that says nothing of its convention, and spikes for it."""
    artifact = network(np.random.default_rng(1), [16, 20, 8], ["cuba"] * 2, loops={1})
    nir.write(tmp_path / "net.nir", artifact.graph)
    raster = (np.random.default_rng(0).random((60, 16)) < 0.2).astype(np.uint8)
    np.save(tmp_path / "spikes.npy", raster)
    return tmp_path / "net.nir", tmp_path / "spikes.npy", artifact, raster


def test_emulate_refuses_a_reset_to_zero(files, command, tmp_path):
    net, spikes, *_ = files
    words = ("emulate", net, "--chip", "xylo-a2", "--input", spikes, "-o", tmp_path / "out.npz")
    code, _, err = command(*words)
    assert code == 1
    assert "reset 'zero': a spike on xylo-a2 can only do 'subtract'" in err
    assert "Train with reset 'subtract'" in err
    code, out, _ = command("check", net, "--chip", "xylo-a2")
    assert code == 1
    assert "With --reset subtract: fits, as another network" in out


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
    assert "weight_shift is 4" in err
