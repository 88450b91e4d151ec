"""The script `./spike`: which extras it installs when, played with a stand-in for pip."""

import shutil
import subprocess

import pytest

from tests.paths import ROOT


@pytest.fixture
def checkout(tmp_path):
    """A checkout with a virtual environment whose programs only write down how they are called."""
    home = tmp_path / "a checkout"
    (home / ".venv/bin").mkdir(parents=True)
    shutil.copy(ROOT / "spike", home)
    (home / "spikedeploy/zoo/hexapod").mkdir(parents=True)
    (home / "spikedeploy/zoo/hexapod/sparse.nir").touch()
    (home / "pyproject.toml").write_text("version 1")
    (home / "constraints.txt").write_text("numpy==2")
    for program in ("pip", "spikedeploy", "python", "mkdocs"):
        file = home / ".venv/bin" / program
        file.write_text(f'#!/bin/sh\necho "{program} $PWD $*" >> "{home}/calls"\n')
        file.chmod(0o755)
    return home


def spike(home, *words, cwd=None):
    """Run the script; what it called since the last time."""
    calls = home / "calls"
    calls.unlink(missing_ok=True)
    done = subprocess.run(
        [home / "spike", *words], cwd=cwd, capture_output=True, text=True, check=False
    )
    lines = calls.read_text().splitlines() if calls.exists() else []
    return done, [line.split(" ")[0] for line in lines], lines


@pytest.mark.parametrize(
    ("verb", "extra"),
    [
        ("demo", ""),
        ("compare", ""),
        ("train", "[train]"),
        ("export", "[train]"),
        ("export hexapod/sparse --to c", ""),
        ("export hexapod/sparse --to verilog", ""),
        ("export hexapod/sparse --to nir", "[train]"),
        ("export last --to c", "[train]"),
        ("tune", "[tune]"),
        ("serve", "[serve]"),
        ("test", "[dev]"),
    ],
)
def test_the_first_call_installs_what_the_verb_needs(verb, extra, checkout):
    _, programs, lines = spike(checkout, *verb.split())
    assert programs[0] == "pip"
    assert lines[0].endswith(f"-c {checkout}/constraints.txt -e {checkout}{extra}")
    assert programs[-1] == ("python" if verb == "test" else "spikedeploy")


@pytest.mark.parametrize("words", ["docs --help", "docs -h", "test --help", "test -h"])
def test_help_of_what_the_script_does_itself_installs_and_runs_nothing(words, checkout):
    done, programs, _ = spike(checkout, *words.split())
    assert (done.returncode, done.stderr, programs) == (0, "", [])
    assert done.stdout.startswith(f"Usage: {checkout}/spike {words.split()[0]}")
    assert ("--fpga" in done.stdout) == words.startswith("test")


@pytest.mark.parametrize("words", [["lab"], ["lab", "--help"]])
def test_help_of_the_lab_needs_no_package(words):
    done = subprocess.run([ROOT / "spike", *words], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("usage: python -m lab NAME")
    assert done.stderr == ""


def test_the_second_call_installs_nothing(checkout):
    spike(checkout, "train")
    assert spike(checkout, "train")[1] == ["spikedeploy"]
    assert spike(checkout, "demo")[1] == ["spikedeploy"]  # train holds what demo needs
    assert spike(checkout, "test")[1] == ["pip", "pip", "python"]
    assert spike(checkout, "test")[1] == ["python"]


@pytest.mark.parametrize("file", ["pyproject.toml", "constraints.txt"])
def test_a_changed_project_is_installed_again(file, checkout):
    spike(checkout, "demo")
    (checkout / file).write_text("another version")
    assert spike(checkout, "demo")[1] == ["pip", "spikedeploy"]


@pytest.mark.parametrize(
    ("words", "called"),
    [
        ([], "spikedeploy {tmp} --help"),
        (["test", "-x"], "python {home} -m pytest -n 2 --dist worksteal -x"),
        (["docs"], "mkdocs {home} build --strict"),
        (["test", "--peers", "norse"], "python {home} -m lab live-peers norse"),
        (["lab", "drift", "-o", "x.md"], "python {home} -m lab drift -o x.md"),
        (["test", "--fpga", "-x"], "python {home} -m pytest -n 2 --dist worksteal --fpga -x"),
    ],
)
def test_words_that_are_not_of_the_command_line_run_in_the_checkout(
    words, called, checkout, tmp_path
):
    _, _, lines = spike(checkout, *words, cwd=tmp_path)
    assert lines[-1] == called.format(home=checkout, tmp=tmp_path)


def test_the_tools_of_fpgas_are_installed_once_and_for_their_tests_alone(checkout):
    spike(checkout, "test")
    assert spike(checkout, "test")[1] == ["python"]
    _, programs, lines = spike(checkout, "test", "--fpga")
    assert programs == ["pip", "python"]
    assert lines[0].endswith(f"install -e {checkout}[fpga]")
    assert spike(checkout, "test", "--fpga")[1] == ["python"]


def test_the_suite_runs_where_the_tools_of_fpgas_cannot_be_installed(checkout):
    spike(checkout, "test")
    pip = checkout / ".venv/bin/pip"
    pip.write_text(pip.read_text() + "exit 1\n")
    done, programs, _ = spike(checkout, "test", "--fpga")
    assert (done.returncode, programs) == (0, ["pip", "python"])
    assert "those of the system are used" in done.stderr


def test_where_a_tested_version_is_missing_others_are_installed_and_that_is_said(checkout):
    pip = checkout / ".venv/bin/pip"
    fails = """case $* in *" -c "*) echo "no matching distribution"; exit 1 ;; esac\n"""
    pip.write_text(pip.read_text() + fails)
    done, programs, lines = spike(checkout, "train")
    assert done.returncode == 0
    assert programs == ["pip", "pip", "spikedeploy"]
    assert lines[1].endswith(
        f"install --no-compile --disable-pip-version-check -e {checkout}[train]"
    )
    assert "not all tested versions" in done.stderr
    assert "doctor" in done.stderr
    assert "no matching distribution" in (checkout / ".venv/install.log").read_text()


def test_words_reach_the_command_line_unchanged_from_any_folder(checkout, tmp_path):
    _, _, lines = spike(checkout, "run", "my file.nir", "--episodes", "2", cwd=tmp_path)
    assert lines[-1] == f"spikedeploy {tmp_path} run my file.nir --episodes 2"


def test_hints_name_the_script_as_it_was_called(checkout):
    program = checkout / ".venv/bin/spikedeploy"
    program.write_text(f'#!/bin/sh\necho "$SPIKEDEPLOY_COMMAND" >> "{checkout}/calls"\n')
    assert spike(checkout, "runs")[2][-1] == str(checkout / "spike")


def test_the_suite_runs_without_xylosim_where_it_cannot_be_built(checkout):
    pip = checkout / ".venv/bin/pip"
    fails = """case $* in *xylosim*) echo "no compiler"; exit 1 ;; esac\n"""
    pip.write_text(pip.read_text() + fails)
    done, programs, lines = spike(checkout, "test")
    assert programs == ["pip", "pip", "python"]
    assert lines[1].endswith(f"-e {checkout}[xylosim]")
    assert "xylosim cannot be built" in done.stderr
    assert "no compiler" in (checkout / ".venv/install.log").read_text()
    assert done.returncode == 0


def test_a_failed_installation_shows_its_log_and_is_tried_again(checkout):
    pip = checkout / ".venv/bin/pip"
    works = pip.read_text()
    pip.write_text("#!/bin/sh\necho no network here\nexit 1\n")
    done, programs, _ = spike(checkout, "demo")
    assert done.returncode != 0
    assert "no network here" in done.stderr
    assert programs == []
    pip.write_text(works)
    assert spike(checkout, "demo")[1] == ["pip", "spikedeploy"]
