"""The benchmarks start: what they measure is too slow and too noisy for a test."""

import subprocess
import sys

import pytest

from tests.paths import ROOT

FOLDER = ROOT / "benchmarks"
SCRIPTS = [p for p in sorted(FOLDER.glob("*.py")) if '__name__ == "__main__"' in p.read_text()]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_benchmark_starts_from_anywhere(script, tmp_path):
    command = [sys.executable, str(script), "--help"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert script.name in ended.stdout
