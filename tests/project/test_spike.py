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


def let_pip_fail(home, pattern="*"):
    """Let pip fail where its words match, with a line on stdout."""
    pip = home / ".venv/bin/pip"
    pip.write_text(pip.read_text() + f'case "$*" in {pattern}) echo "no luck"; exit 1 ;; esac\n')


@pytest.mark.parametrize(
    ("verb", "extra"),
    [
        ("demo", ""),
        ("train", "[train]"),
        ("export hexapod/sparse --to c", ""),
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


@pytest.mark.parametrize("words", ["docs --help", "test -h"])
def test_help_of_what_the_script_does_itself_installs_and_runs_nothing(words, checkout):
    done, programs, _ = spike(checkout, *words.split())
    assert (done.returncode, done.stderr, programs) == (0, "", [])
    assert done.stdout.startswith(f"Usage: {checkout}/spike {words.split()[0]}")


def test_help_of_the_lab_needs_no_package():
    done = subprocess.run([ROOT / "spike", "lab"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("usage: python -m lab NAME")
    assert done.stderr == ""


def test_the_second_call_installs_nothing_unless_the_project_changed(checkout):
    spike(checkout, "train")
    assert spike(checkout, "train")[1] == ["spikedeploy"]
    assert spike(checkout, "demo")[1] == ["spikedeploy"]  # train holds what demo needs
    assert spike(checkout, "test")[1] == ["pip", "pip", "python"]
    assert spike(checkout, "test", "--fpga")[1] == ["pip", "python"]
    assert spike(checkout, "test", "--fpga")[1] == ["python"]
    for file in ("pyproject.toml", "constraints.txt"):
        (checkout / file).write_text("another version")
        assert spike(checkout, "demo")[1] == ["pip", "spikedeploy"]


@pytest.mark.parametrize(
    ("words", "called"),
    [
        ([], "spikedeploy {tmp} --help"),
        (["run", "my file.nir", "-x"], "spikedeploy {tmp} run my file.nir -x"),
        (["test", "-x"], "python {home} -m pytest -n 2 --dist worksteal -x"),
        (["docs"], "mkdocs {home} build --strict"),
        (["test", "--peers", "norse"], "python {home} -m lab live-peers norse"),
        (["lab", "clocks", "--page"], "python {home} -m lab clocks --page"),
        (["test", "--fpga", "-x"], "python {home} -m pytest -n 2 --dist worksteal --fpga -x"),
    ],
)  # fmt: skip
def test_words_reach_what_they_are_for(words, called, checkout, tmp_path):
    _, _, lines = spike(checkout, *words, cwd=tmp_path)
    assert lines[-1] == called.format(home=checkout, tmp=tmp_path)


def test_hints_name_the_script_as_it_was_called(checkout):
    program = checkout / ".venv/bin/spikedeploy"
    program.write_text(f'#!/bin/sh\necho "$SPIKEDEPLOY_COMMAND" >> "{checkout}/calls"\n')
    assert spike(checkout, "runs")[2][-1] == str(checkout / "spike")


@pytest.mark.parametrize(
    ("words", "fails", "programs", "says"),
    [
        (["train"], '*" -c "*', ["pip", "pip", "spikedeploy"], "not all tested versions"),
        (["test"], "*xylosim*", ["pip", "pip", "python"], "xylosim cannot be built"),
        (["test", "--fpga"], "*fpga*", ["pip", "pip", "pip", "python"], "those of the system"),
    ],
)
def test_what_cannot_be_installed_is_said_and_done_without(words, fails, programs, says, checkout):
    let_pip_fail(checkout, fails)
    done, called, _ = spike(checkout, *words)
    assert (done.returncode, called) == (0, programs)
    assert says in done.stderr
    assert "no luck" in (checkout / ".venv/install.log").read_text()


def test_a_failed_installation_shows_its_log_and_is_tried_again(checkout):
    works = (checkout / ".venv/bin/pip").read_text()
    let_pip_fail(checkout)
    done, programs, _ = spike(checkout, "demo")
    assert done.returncode != 0
    assert "no luck" in done.stderr
    assert "spikedeploy" not in programs
    (checkout / ".venv/bin/pip").write_text(works)
    assert spike(checkout, "demo")[1] == ["pip", "spikedeploy"]
