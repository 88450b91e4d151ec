"""Every command of the lab starts: what most of them measure is too slow and noisy for a test."""

import subprocess
import sys

import pytest

from lab.__main__ import COMMANDS
from tests.paths import ROOT


def called(*words):
    """A process of `python -m lab`."""
    command = [sys.executable, "-m", "lab", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_starts(name):
    ended = called(name, "--help")
    assert ended.returncode == 0, ended.stderr
    assert f"python -m lab {name}" in ended.stdout


def test_every_command_is_listed():
    found = called().stdout.split()
    assert found[-len(COMMANDS) :] == list(COMMANDS)


def test_an_unknown_command_is_refused_in_a_sentence():
    ended = called("anergy")
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: no 'anergy' in lab; there are tables, ")
