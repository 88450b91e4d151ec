"""What deploys needs no torch: the commands of the README run where training is not installed."""

import os
import subprocess
import sys

import pytest

from tests.paths import ROOT
from tests.waiting import PATIENCE

# a finder that has none of the packages of the extras
BLOCKED = """
import sys


class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "snntorch", "safetensors", "onnx", "optuna", "ray"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Missing())
"""


@pytest.mark.parametrize(
    "words",
    [
        ("run", "kart-grid/sparse", "-o", "{tmp}/page"),
        ("compare", "kart-grid", "kart-grid/sparse", "--episodes", "1", "--workers", "1"),
        ("sweep", "examples/sweep.toml", "--no-run", "-o", "{tmp}/sweep"),
        ("export", "kart-grid/sparse", "--to", "c", "-o", "{tmp}/c"),
        ("check", "examples/net.nir", "--chip", "loihi1"),
    ],
    ids=lambda words: words[0],
)
def test_what_deploys_needs_no_torch(words, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(BLOCKED)
    path = os.pathsep.join([str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")])
    given = [word.format(tmp=tmp_path) for word in words]
    done = subprocess.run(
        [sys.executable, "-m", "spikedeploy", *given],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True,
        timeout=PATIENCE,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
