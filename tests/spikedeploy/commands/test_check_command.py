"""`spikedeploy check`: exit codes for CI, JSON for machines, tables for people."""

import json
from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.emulation.design_report import report_of
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import CHIPS
from spikedeploy.runtime.compiler.rules import RULES
from tests import toy_stroll_env
from tests.networks import chain, cuba


@pytest.mark.parametrize(
    ("chips", "code"),
    [
        (("loihi1",), 0),
        (("loihi1", "loihi2"), 0),
        (("xylo-a2",), 1),
        (("loihi1", "xylo-a2"), 1),
        (("all",), 0),
        ((), 0),
    ],
)
def test_the_exit_code_is_0_when_all_named_chips_pass_or_one_of_all(chips, code, command):
    options = [word for name in chips for word in ("--chip", name)]
    assert command("check", "kart-grid/snn", *options, "--json")[0] == code


def test_a_chip_without_limits_is_not_the_one_that_passes_all(command, tmp_path):
    # more inputs than Xylo has, currents and neurons without a leak: few chips take both
    nodes = nir.Linear(np.ones((2, 40))), cuba(2), nir.Linear(np.ones((2, 2)))
    neurons = nir.IF(*(np.full(2, v) for v in (1000.0, 1.0)))
    network = chain(*nodes, neurons, width=40, act=2)
    path = tmp_path / "odd.nir"
    nir.write(path, network)
    options = ("--dt", "0.001", "--reset", "subtract")
    code, out, _ = command("check", path, "--chip", "ideal", *options, "--json")
    assert (code, json.loads(out)["passed"]) == (0, True)
    read = load(path, dt=1e-3, reset="subtract")
    found = report_of(str(path), read, ["all"], path, {"dt": 1e-3, "reset": "subtract"})
    alone = replace(
        found, checks=[e for e in found.checks if e.chip.limits is None or not e.passed]
    )
    assert any(each.passed for each in alone.checks)
    assert not alone.passed


def test_people_see_layers_rules_and_the_convention(command):
    _, out, _ = command("check", "hexapod/popsan", "--chip", "loihi1", "--rules")
    assert "dt=0.001 s, reset=zero, integrator=euler" in out
    assert "Layers on loihi1" in out
    assert "394,240" in out
    assert all(rule in out for rule in RULES)


def test_without_rules_people_see_the_verdict_and_what_is_broken(command):
    _, out, _ = command("check", "hexapod/popsan")
    lines = out.splitlines()
    assert len(lines) == len(CHIPS) + 3  # the convention, a line for each chip, a hint
    free = "✓ loihi1: 15 cores, clock free, 3 chip timesteps more an inference"
    assert free in lines
    assert "weight-bits" not in out
    code, out, _ = command("check", "hexapod/popsan", "--chip", "xylo-a2")
    assert code == 1
    broken = "node 'lif1' has 512 synapses of a spike; xylo-a2 has at most 64. Prune it."
    assert f"✗ rule fan-out: {broken}" in out
    assert out.splitlines()[-2].startswith("✗ xylo-a2: breaks ")
    assert command("check", "hexapod/popsan", "--chip", "loihi1")[1].splitlines()[2:] == [
        free,
        "All rules: --rules",
    ]


@pytest.mark.parametrize(
    "words",
    [
        ["--chip", "loihi1,loihi1:clock=gated"],
        ["--chip", "loihi1", "--chip", "loihi1:clock=gated"],
    ],
)
def test_chips_keep_their_options_and_say_by_which_clock_they_run(words, command):
    _, out, _ = command("check", "kart-grid/snn", *words)
    assert out.splitlines()[2:4] == [
        "✓ loihi1: 4 cores, clock free, 2 chip timesteps more an inference",
        "✓ loihi1:clock=gated: 4 cores, clock gated, assumed, 2 chip timesteps more an inference",
    ]


def test_a_network_that_lacks_its_reset_alone_is_told_with_which_one_it_fits(command):
    code, out, _ = command("check", "examples/net.nir", "--chip", "xylo-a2")
    assert (code, "breaks reset. With --reset subtract: fits, as another network" in out) == (
        1,
        True,
    )
    assert command("check", "examples/net.nir", "--chip", "xylo-a2", "--reset", "subtract")[0] == 0
    _, out, _ = command("check", "kart-grid/snn", "--chip", "xylo-a2")  # which breaks more
    assert "With --reset" not in out


def test_a_policy_of_another_chip_is_sent_there_and_not_given_another_reset(command):
    words = ("chips/CartPole-v1/xylo-a2", "--chip", "loihi1")
    code, out, _ = command("check", *words)
    assert code == 1
    assert "Run it on xylo-a2, for which it was trained." in out
    assert "--reset" not in out
    code, _, err = command("run", *words)
    assert code == 1
    assert "trained for xylo-a2: run it there." in err
    assert "--reset" not in err


@pytest.mark.parametrize(
    ("reference", "options", "message"),
    [
        ("nothing", (), "no network at 'nothing'"),
        ("hexapod/sac", (), "does not spike"),
        ("kart-grid/snn", ("--chip", "loihi3"), "there is no chip 'loihi3'"),
        ("kart-grid/snn", ("--chip", ","), "--chip names none"),
        ("README.md", (), "not an HDF5 file"),
    ],
)
def test_what_cannot_be_checked_is_one_line(reference, options, message, command):
    code, out, err = command("check", reference, *options)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert message in err


@pytest.fixture
def crowded(monkeypatch, tmp_path):
    """A shipped policy for the stroll whose layers no core of Loihi holds."""
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    monkeypatch.chdir(tmp_path)
    few = CHIPS["loihi1"].read_text().replace("axons_in = { value = 4096", "axons_in = { value = 1")
    (tmp_path / "few.toml").write_text(few)
    monkeypatch.setitem(CHIPS, "loihi1", tmp_path / "few.toml")


@pytest.mark.usefixtures("crowded")
def test_run_and_compare_refuse_what_does_not_fit_and_play_it_without_limits(command):
    words = ("run", "stroll/popsan", "--chip", "loihi1", "--json")
    code, _, err = command(*words)
    assert code == 1
    assert "rule axons-in" in err
    code, out, _ = command(*words, "--limits", "off")
    assert code == 0
    assert json.loads(out)["rows"][0]["returns"]
    words = ("compare", "stroll", "stroll/popsan", "--episodes", 1, "--workers", 1, "--json")
    code, out, _ = command(*words, "--limits", "off")
    assert code == 0
    assert [row["limits"] for row in json.loads(out)["rows"] if row["chip"] == "loihi1"] == [False]
