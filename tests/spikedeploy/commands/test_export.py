"""`export`: what each format refuses, in a sentence with a rule or option; nothing is written."""

from dataclasses import replace

import pytest

from spikedeploy.runtime.artifact.artifact import save
from tests.networks import event_driven, popsan

SPARSE, GATED = "hexapod/sparse", "kart-steer/sparse-gated"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The folder that commands run in, with files of networks."""
    monkeypatch.chdir(tmp_path)
    artifact = event_driven()
    origin = replace(artifact.provenance, env="own_module:Env")
    save(replace(artifact, provenance=origin), "policy.nir")
    save(replace(popsan(), codec=None), "net.nir")
    return tmp_path


REFUSED = {
    "c": {
        "name it, as in -o": [("policy.nir",), ("hexapod/linear",)],
        "is no spiking policy": [("hexapod/gait", "-o", "out")],
        "no such file": [("kept.nir", "-o", "out")],
        "computes Gather": [("hexapod/fourier", "-o", "out")],
        "leave --chip and": [("hexapod/linear", "-o", "out", "--chip", "loihi1")],
        "written beside it": [
            ("hexapod/linear", "-o", "out", "--prefix", "host_i16"),
            ("policy.nir", "-o", "out", "--prefix", "vectors"),
        ],
        "rule arithmetic": [("policy.nir", "-o", "out", "--chip", "ideal")],
        "there is no chip ''": [("policy.nir", "-o", "out", "--chip", "")],
        "rule": [("policy.nir", "-o", "out", "--chip", "odin")],
        "rule clock": [("policy.nir", "-o", "out", "--chip", "loihi1:clock=free")],
        "has no codec": [("net.nir", "-o", "out", "--chip", "loihi1")],
        "--clock is no option": [("policy.nir", "-o", "out", "--clock", "free")],
        "a header of C": [("policy.nir", "-o", "out", "--prefix", "stdint")],
        "a library of the system": [("policy.nir", "-o", "out", "--prefix", "m")],
    },
    "verilog": {
        "name it, as in -o": [(GATED,)],
        "Did you mean 'icebreaker'": [(GATED, "-o", "out", "--board", "icebraker")],
        "is no spiking policy": [("kart-steer/linear", "-o", "out")],
        "no such file": [("kept.nir", "-o", "out")],
        "has no codec": [("net.nir", "-o", "out")],
        "rule arithmetic": [("policy.nir", "-o", "out", "--chip", "ideal")],
        "rule": [
            ("policy.nir", "-o", "out", "--chip", "xylo-a2"),
            ("policy.nir", "-o", "out", "--chip", "speck2f"),
            ("hexapod/popsan", "-o", "out"),
        ],
        "rule clock": [("policy.nir", "-o", "out", "--chip", "loihi1:clock=free")],
        "iCEstick has": [("hexapod-command/sparse", "-o", "out", "--board", "icestick")],
    },
    "program": {
        "name it, as in -o": [(SPARSE,)],
        "there is no script for odin": [(SPARSE, "-o", "out", "--chip", "odin")],
        "has no codec": [("net.nir", "-o", "out", "--chip", "loihi1")],
        "rule primitive": [("hexapod/sparse-gated", "-o", "out", "--chip", "speck2f")],
        "clock 'gated' updates": [(SPARSE, "-o", "out", "--clock", "gated")],
        "delivers after 1": [("hexapod/sparse-gated", "-o", "out", "--chip", "loihi1-nengo")],
    },
    "nir": {
        "name it, as in -o": [("policy.nir", "--for", "snntorch")],
        "--env is no option": [("policy.nir", "-o", "out.nir", "--env", "x")],
        "--board is no option": [("policy.nir", "-o", "out.nir", "--board", "icestick")],
        "--checkpoint is for a run": [("policy.nir", "-o", "out.nir", "--checkpoint", "last")],
        "above 0": [("policy.nir", "-o", "out.nir", "--dt", "0")],
    },
    "onnx": {
        "--for is no option": [("policy.nir", "-o", "out.onnx", "--for", "snntorch")],
        "--state is for a run": [("policy.nir", "-o", "out.onnx", "--state", "kept")],
    },
    "rust": {"unknown format 'rust'": [("policy.nir", "-o", "out")]},
}
CASES = [(to, said, words) for to in REFUSED for said in REFUSED[to] for words in REFUSED[to][said]]


@pytest.mark.parametrize(("to", "said", "words"), CASES)
def test_what_cannot_be_written_is_refused_and_nothing_is(to, said, words, command, here):
    before = set(here.iterdir())
    code, _, err = command("export", *words, "--to", to)
    assert code in (1, 2), err
    assert said in " ".join(err.split())
    assert "Traceback" not in err
    assert set(here.iterdir()) == before
