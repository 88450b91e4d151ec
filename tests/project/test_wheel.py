"""The wheel: what lands in site-packages, and nothing else."""

import subprocess
import sys
from zipfile import ZipFile

import pytest

from tests.paths import ROOT

FOLDERS = {"spikedeploy", "envs", "runtime", "trainers", "exporters"}

pytest.importorskip("setuptools")


def tracked():
    """The files of the source tree, those that git ignores left out."""
    done = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        pytest.skip("not a git checkout")
    return [line for line in done.stdout.splitlines() if (ROOT / line).is_file()]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel that is built from a copy of the tree."""
    copy, out = tmp_path_factory.mktemp("tree"), tmp_path_factory.mktemp("wheel")
    for line in tracked():
        if line.split("/")[0] in FOLDERS | {"pyproject.toml", "LICENSE", "README.md"}:
            (copy / line).parent.mkdir(parents=True, exist_ok=True)
            (copy / line).write_bytes((ROOT / line).read_bytes())
    (copy / "README.md").touch()
    build = f"from setuptools import build_meta; build_meta.build_wheel({str(out)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=copy, capture_output=True, check=True)
    (path,) = out.glob("*.whl")
    with ZipFile(path) as file:
        yield file


def installed(line):
    """Where a file of the repository is in the wheel."""
    return line if line.startswith("spikedeploy/") else f"spikedeploy/{line}"


def test_the_only_top_level_name_is_spikedeploy(wheel):
    found = {name.split("/")[0] for name in wheel.namelist()}
    assert {name for name in found if not name.endswith(".dist-info")} == {"spikedeploy"}


@pytest.mark.parametrize("folder", sorted(FOLDERS))
def test_every_module_and_data_file_of_a_folder_is_in_the_wheel(folder, wheel):
    expected = {installed(line) for line in tracked() if line.startswith(f"{folder}/")}
    assert expected
    assert expected <= set(wheel.namelist())


def test_the_wheel_says_that_it_is_typed(wheel):
    assert "spikedeploy/py.typed" in wheel.namelist()


def test_the_wheel_installs_the_command(wheel):
    (name,) = (name for name in wheel.namelist() if name.endswith("entry_points.txt"))
    text = wheel.read(name).decode()
    assert "spikedeploy = spikedeploy.cli:main" in text
