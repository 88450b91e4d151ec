"""Wheel and source distribution: all of it, under one name, which gets on with other packages."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from zipfile import ZipFile

import pytest

from tests.paths import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FOLDERS = {"spikedeploy", "envs", "runtime", "trainers", "exporters"}
LINKED = sorted(FOLDERS - {"spikedeploy"})
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]

pytest.importorskip("setuptools")


def called(*command, cwd):
    """Output of a command that succeeds; modules of the checkout are not on its path."""
    environ = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=environ, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def tracked():
    """Files and links of the source tree, those that git ignores left out."""
    done = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        pytest.skip("not a git checkout")
    lines = done.stdout.splitlines()
    return [line for line in lines if (ROOT / line).is_file() or (ROOT / line).is_symlink()]


def build(kind, tree, out):
    """The distribution that setuptools builds from a source tree."""
    out.mkdir()
    code = f"from setuptools import build_meta; build_meta.build_{kind}({str(out)!r})"
    called(sys.executable, "-c", code, cwd=tree)
    return next(out.iterdir())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("packaging")


@pytest.fixture(scope="module")
def wheel_file(folder):
    """A wheel that is built from a copy of the tree, links included."""
    return build("wheel", checkout(folder / "tree"), folder / "wheel")


@pytest.fixture(scope="module")
def sdist_file(folder):
    """A source distribution of another copy, in which nothing was built before."""
    return build("sdist", checkout(folder / "second tree"), folder / "sdist")


def checkout(copy):
    """A copy of what git knows of the tree."""
    for line in tracked():
        if line.split("/")[0] in FOLDERS | {"pyproject.toml", "LICENSE", "README.md"}:
            (copy / line).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / line, copy / line, follow_symlinks=False)
    return copy


@pytest.fixture(scope="module")
def wheel(wheel_file):
    with ZipFile(wheel_file) as file:
        yield file


@pytest.fixture(scope="module")
def unpacked(sdist_file, folder):
    """The source distribution as a folder."""
    called(sys.executable, "-m", "tarfile", "-e", sdist_file, folder / "unpacked", cwd=folder)
    (tree,) = (folder / "unpacked").iterdir()
    return tree


def installed(line):
    """Where a file of the repository is in the wheel."""
    return line if line.split("/")[0] == "spikedeploy" else f"spikedeploy/{line}"


def test_the_list_of_packages_is_that_of_the_folders():
    inits = [Path(line) for line in tracked() if line.split("/")[0] in FOLDERS]
    folders = [installed(str(path.parent)) for path in inits if path.name == "__init__.py"]
    assert sorted(SETUPTOOLS["packages"]) == sorted(f.replace("/", ".") for f in folders)
    assert SETUPTOOLS["package-dir"] == {f"spikedeploy.{name}": name for name in LINKED}


def test_the_wheels_only_top_level_name_is_spikedeploy(wheel):
    found = {name.split("/")[0] for name in wheel.namelist()}
    assert {name for name in found if not name.endswith(".dist-info")} == {"spikedeploy"}


def test_every_module_and_data_file_is_in_the_wheel(wheel):
    expected = {installed(line) for line in tracked() if line.split("/")[0] in FOLDERS}
    assert expected - {f"spikedeploy/{link}" for link in LINKED} <= set(wheel.namelist())


def test_the_source_distribution_builds_the_same_wheel(unpacked, wheel, folder):
    shutil.copytree(unpacked, folder / "third tree")
    with ZipFile(build("wheel", folder / "third tree", folder / "second wheel")) as other:
        assert set(other.namelist()) == set(wheel.namelist())
        for name in wheel.namelist():
            assert other.read(name) == wheel.read(name), name


@pytest.fixture(scope="module")
def python(wheel_file, folder):
    """Python of a virtual environment into which the wheel was installed, without a network.

    What spikedeploy depends on is seen from there; an editable install of it is not.
    """
    home = folder / "installed"
    called(sys.executable, "-m", "venv", "--without-pip", home, cwd=folder)
    site = next(home.glob("lib/python*/site-packages"))
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", home / "bin/python", "install"]
    called(*pip, "--no-deps", "--no-index", "--force-reinstall", wheel_file, cwd=folder)
    return home / "bin/python"


@pytest.fixture
def project(tmp_path):
    """A project with packages of its own that are called as our folders are."""
    for name in ("envs", "runtime", "trainers", "exporters", "tests"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"WHOSE = 'the project: {name}'\n")
    return tmp_path


def test_a_script_beside_packages_of_the_same_names_uses_both(python, project):
    (project / "script.py").write_text(
        "import envs, runtime, trainers, exporters\n"
        "import spikedeploy\n"
        "from spikedeploy import envs as worlds\n"
        "from spikedeploy.runtime import load\n"
        "from spikedeploy.runtime.chips.chip import chip\n"
        "for module in (envs, runtime, trainers, exporters):\n"
        "    assert module.WHOSE.startswith('the project'), module\n"
        "print(spikedeploy.__file__, chip('loihi1').name, worlds.make('kart-grid'))\n"
    )
    out = called(python, "script.py", cwd=project)
    assert out.startswith(str(python.parents[1]))
    assert "loihi1" in out


def test_the_command_line_runs_beside_packages_of_the_same_names(python, project):
    assert "compare" in called(python, "-m", "spikedeploy", "--help", cwd=project)
    out = called(python.parent / "spikedeploy", "check", "hexapod/popsan", cwd=project)
    assert "loihi1" in out
