"""A policy in C walks as the runtime's does, and no machine code is loaded unasked."""

import subprocess

import numpy as np
import pytest

from spikedeploy.exporters.c.packaging import write_texts
from spikedeploy.exporters.c.to_c import policy_in_c
from spikedeploy.policies import native
from spikedeploy.policies.native import NativeController, permit
from spikedeploy.policies.registry import find
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError, ObservationError
from tests.c_builds import COMPILERS, STRICT, needs_c
from tests.networks import event_driven, spiking_mlp

LOIHI = chip("loihi1", clock="gated")


def library(artifact, folder):
    """libpolicy.so of a policy."""
    codec = artifact.codec
    seen = np.zeros((4, codec.encoder.observed))
    write_texts(policy_in_c(compile_program(artifact, LOIHI), codec, seen, "").text, folder)
    words = [COMPILERS[0], *STRICT, "-O1", "-fPIC", "-shared", "-o", "libpolicy.so", "policy.c"]
    subprocess.run([*words, "codec.c", "-lm"], cwd=folder, check=True)
    return folder / "libpolicy.so"


@needs_c
@pytest.mark.parametrize("make", [event_driven, spiking_mlp])
def test_c_acts_as_the_runtime(tmp_path, make):
    artifact = make()
    controller, runtime = (
        NativeController(library(artifact, tmp_path)),
        SpikingController(artifact, LOIHI),
    )
    seen = np.cumsum(np.random.default_rng(0).normal(0, 0.3, (30, controller.observed)), axis=0)
    controller.reset(0)
    runtime.reset(0)
    acted = [controller.act(row) for row in seen]
    np.testing.assert_allclose(acted, [runtime.act(row) for row in seen], atol=1e-12)
    np.testing.assert_array_equal(controller.replay(seen), acted)


@needs_c
def test_wrong_observations_are_refused(tmp_path):
    controller = NativeController(library(event_driven(), tmp_path))
    with pytest.raises(ObservationError, match="shape"):
        controller.act(np.zeros(2))
    with pytest.raises(ObservationError, match="not finite"):
        controller.act(np.array([0.0, np.nan, 0.0]))


def test_machine_code_is_not_loaded_unasked(tmp_path, monkeypatch):
    path = tmp_path / "libpolicy.so"
    path.write_bytes(b"\x7fELF")
    monkeypatch.setattr(native.ctypes, "CDLL", lambda *_: pytest.fail("it was loaded"))
    with pytest.raises(ConfigError, match=r"is machine code.*--native"):
        find(str(path))


def test_what_is_no_policy_is_refused_in_a_sentence(tmp_path):
    path = tmp_path / "libpolicy.so"
    path.write_bytes(b"no ELF")
    permit(path)
    with pytest.raises(ConfigError, match="is no policy in C"):
        find(str(path))
    with pytest.raises(ConfigError, match=r"is called lib<prefix>\.so"):
        NativeController(tmp_path / "policy.so")
