"""The guard: a stranger's package under one of our names is named, not imported by accident."""

import subprocess
import sys
from pathlib import Path

import pytest

from spikedeploy import SIBLINGS, stranger

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("name", SIBLINGS)
def test_our_own_packages_are_no_strangers(name):
    assert stranger(name) is None


def test_a_package_from_elsewhere_is_a_stranger(tmp_path):
    assert Path(stranger("envs", home=tmp_path)) == ROOT / "envs"


def test_a_package_that_is_missing_is_nowhere(tmp_path):
    assert stranger("no_such_package", home=tmp_path) == "nowhere"


def test_importing_spikedeploy_beside_a_stranger_says_who_it_is(tmp_path):
    (tmp_path / "runtime.py").write_text("")
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import spikedeploy"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert f"finds that name at {tmp_path / 'runtime.py'}" in done.stderr
    assert "environment of its own" in done.stderr
