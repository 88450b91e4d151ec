"""`spikedeploy check`: exit codes for CI, JSON for machines, tables for people."""

import json
from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.comparison.lineup import line_up
from spikedeploy.emulation.design_report import design_report, statuses, worst
from spikedeploy.policies.registry import find
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import CHIPS
from spikedeploy.runtime.compiler.rules import RULES
from tests import toy_stroll_env
from tests.networks import chain, cuba, popsan

RULING = {
    "rule": str,
    "node": (str, type(None)),
    "status": str,
    "found": (int, float, str, type(None)),
    "limit": (int, float, str, type(None)),
    "unit": str,
    "remedy": str,
    "note": str,
}
LAYER = {
    "name": str,
    "kind": str,
    "neurons": int,
    "synapses": int,
    "fan_in": int,
    "fan_out": int,
    "cores": int,
    "first": (int, type(None)),
    "block": int,
    "memory": (int, type(None)),
    "axons_in": int,
    "axons_out": int,
    "estimated": bool,
    "utilisation": (dict, type(None)),
}
CHIP = {
    "chip": str,
    "passed": bool,
    "membrane_output": str,
    "clock": (str, type(None)),
    "clock_assumed": (bool, type(None)),
    "timesteps_more": (int, type(None)),
    "timesteps_late": (list, type(None)),
    "fits_with_reset": (str, type(None)),
    "rules": dict,
    "rulings": list,
    "mapping": dict,
    "limits": (dict, type(None)),
}


@pytest.fixture
def wide(tmp_path):
    """A file with more sources than a core of Loihi has axons."""
    artifact = popsan(obs=411)
    path = tmp_path / "wide.nir"
    save(artifact, path)
    return path


def of_shape(found, shape):
    assert found.keys() == shape.keys()
    for key, kind in shape.items():
        assert isinstance(found[key], kind), key


def test_json_has_the_documented_fields(command):
    code, out, err = command("check", "hexapod/popsan", "--json")
    report = json.loads(out)
    assert (code, err) == (0, "")
    assert report.keys() == {"file", "convention", "passed", "chips"}
    assert [each["chip"] for each in report["chips"]] == list(CHIPS)
    for each in report["chips"]:
        of_shape(each, CHIP)
        assert set(each["rules"]) == {*RULES, "compile"}
        for ruling in each["rulings"]:
            of_shape(ruling, RULING)
        for layer in each["mapping"]["layers"]:
            of_shape(layer, LAYER)


def test_json_says_how_many_cores_each_layer_takes(command):
    _, out, _ = command("check", "hexapod/popsan", "--chip", "loihi2", "--json")
    ((chip,), mapping) = json.loads(out)["chips"], json.loads(out)["chips"][0]["mapping"]
    assert chip["passed"]
    assert mapping["cores"] == sum(layer["cores"] for layer in mapping["layers"])
    assert mapping["chips"] == 1
    assert 0 < mapping["utilisation"]["memory"] <= 1


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
    found = design_report(str(path), ["all"], dt=1e-3, reset="subtract")
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


def test_people_see_what_the_compiler_says(command):
    _, out, _ = command("check", "kart-grid/snn", "--chip", "xylo-a2")
    (line,) = [line for line in out.splitlines() if line.startswith("✗ compile: ")]
    assert line.startswith("✗ compile: rule reset: reset 'zero': ")
    assert line.endswith("run in float.")


def test_people_see_rules_by_chips(command):
    _, out, _ = command("check", "hexapod/popsan", "--rules")
    assert "✓ loihi1: 15 cores" in out
    assert "✗ speck2f: breaks primitive, synaptic-memory" in out
    (row,) = [line for line in out.splitlines() if line.startswith(" weight-bits")][:1]
    assert "✗" not in row


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
    assert (code, "compile. With --reset subtract: fits." in out) == (1, True)
    assert command("check", "examples/net.nir", "--chip", "xylo-a2", "--reset", "subtract")[0] == 0
    _, out, _ = command("check", "kart-grid/snn", "--chip", "xylo-a2")  # which breaks more
    assert "With --reset" not in out


def test_a_policy_of_another_chip_is_sent_there_and_not_given_another_reset(command):
    words = ("chips/CartPole-v1/xylo-a2", "--chip", "loihi1")
    code, out, _ = command("check", *words)
    assert code == 1
    assert "Run it on xylo-a2, in whose integers it was trained." in out
    assert "--reset" not in out
    code, _, err = command("run", *words)
    assert code == 1
    assert "trained in the integers of xylo-a2: run it there." in err
    assert "--reset" not in err


def test_a_file_of_another_tool_needs_its_timestep(command, tmp_path):
    path = tmp_path / "foreign.nir"
    nir.write(path, chain(nir.Linear(np.ones((2, 3))), cuba(2, dt=1e-4), width=3, act=2))
    assert command("check", path, "--chip", "loihi1")[0] == 0
    code, out, _ = command("check", path, "--chip", "loihi1", "--dt", "0.00005", "--json")
    assert json.loads(out)["convention"]["dt"] == 5e-5
    assert code == 0


@pytest.mark.parametrize(
    ("reference", "options", "message"),
    [
        ("nothing", (), "no network at 'nothing'"),
        ("hexapod/sac", (), "does not spike"),
        ("kart-grid/snn", ("--chip", "loihi3"), "there is no chip 'loihi3'"),
        ("README.md", (), "not an HDF5 file"),
    ],
)
def test_what_cannot_be_checked_is_one_line(reference, options, message, command):
    code, out, err = command("check", reference, *options)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert message in err


def test_the_worst_ruling_of_a_rule_stands_for_it():
    report = design_report("hexapod/popsan", ["xylo-a2"])
    (found,) = report.checks
    assert statuses(found)["fan-out"] == "fail"
    assert worst(found.of("fan-out")).node == "lif1"
    assert worst([]).status == "not applicable"


def test_emulate_refuses_what_does_not_fit_and_emulates_it_without_limits(command, wide, tmp_path):
    raster = tmp_path / "spikes.npy"
    np.save(raster, np.ones((5, 4110), np.uint8))
    words = ("emulate", wide, "--chip", "loihi1", "--input", raster, "-o", tmp_path / "out.npz")
    code, _, err = command(*words)
    assert code == 1
    assert "rule axons-in: node 'n2' has 4,111 sources of a core" in err
    assert command(*words, "--limits", "off")[0] == 0


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


def test_a_line_up_says_that_limits_are_off(monkeypatch, tmp_path):
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    labels = [entry.label for entry in line_up("stroll", (), ["loihi1"], limits=False)]
    assert "popsan · loihi1, limits off" in labels
    assert "popsan · float" in labels
    assert find("stroll/popsan").limits


def test_shipped_networks_are_read_as_they_were_trained():
    path = zoo.path("hexapod/popsan")
    assert design_report("hexapod/popsan", ["loihi1"]).artifact.convention == load(path).convention
