"""What a shell offers at the tab key."""

import os
import subprocess
import sys

import pytest

from spikedeploy.commands import completion

AT_THE_TAB = """
import sys
sys.argv = ["spikedeploy"]
from spikedeploy import cli
try:
    cli.main()
finally:
    assert not {"torch", "mujoco", "onnxruntime"} & set(sys.modules)
"""


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def offered(line, folder):
    """What bash is offered for the last word of a line."""
    words = line.split(" ")
    asked = {"COMP_WORDS": line, "COMP_CWORD": f"{len(words) - 1}"}
    found = subprocess.run(
        [sys.executable, "-c", AT_THE_TAB],
        env={**os.environ, **asked, "_SPIKEDEPLOY_COMPLETE": "complete_bash"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert not found.stderr
    return found.stdout.split()


def test_a_command_offers_its_words_without_loading_what_is_slow(here):
    assert offered("spikedeploy run hexapod/spa", here) == [
        "hexapod/sparse",
        "hexapod/sparse-gated",
    ]


def test_policies_and_runs_are_offered(here):
    assert completion.policies("hexapod/pops") == ["hexapod/popsan"]
    assert "chips/CartPole-v1/odin" in completion.policies("chips/C")
    (here / "runs/hexa-1").mkdir(parents=True)
    (here / "runs/hexa-1/config.json").touch()
    assert completion.policies("hexa-") == ["hexa-1"]
    assert completion.run_names("") == ["hexa-1", "last"]


def test_chips_recipes_and_environments_are_offered():
    assert completion.chips("xylo-a") == ["xylo-a2", "xylo-a3"]
    assert completion.chips("odin,tiny") == ["odin,tinyodin"]
    assert completion.recipes("hexapod-sac") == ["hexapod-sac"]
    assert completion.environments("hexapod") == ["hexapod", "hexapod-command"]
    assert "CartPole-v1" in completion.environments("Cart")
    assert "CartPole-v1" not in completion.environments("")
    assert completion.trainings("hexapod-c")[-1] == "hexapod-command"
