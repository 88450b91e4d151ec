"""`check --against`: the float twin and what the author's framework recorded."""

import json
import runpy
import sys

import nir
import numpy as np
import pytest
from typer.testing import CliRunner

from spikedeploy.cli import app
from tests.networks import chain, cuba
from tests.paths import ROOT

EXPORTS = ROOT / "tests/golden/exports"
LEAKY = EXPORTS / "snntorch_leaky.nir"


def check(*words):
    return CliRunner().invoke(app, ["check", *map(str, words)], env={"COLUMNS": "200"})


def against(network, recording, *words):
    return check(EXPORTS / f"{network}.nir", "--against", EXPORTS / f"{recording}.npz", *words)


def test_an_equal_recording_is_said_to_be_equal():
    found = against("snntorch_leaky", "snntorch_leaky_default", "--from", "snntorch")
    assert found.exit_code == 0
    assert "your framework = our float: equal, 1,200 outputs, 332 spikes" in found.stdout
    assert "assumed: reset by subtraction, delayed" in found.stdout


@pytest.mark.parametrize(
    ("network", "recording", "words", "cause"),
    [
        ("snntorch_leaky", "snntorch_leaky_default", [], "--reset subtract-delayed"),
        ("snntorch_leaky", "snntorch_leaky_zero", ["--from", "snntorch"], "--reset zero"),
        ("snntorch_leaky", "snntorch_leaky_subtract", ["--from", "snntorch"], "--reset subtract"),
        ("snntorch_leaky", "snntorch_leaky_zero", ["--delay", "1"], "--delay 0"),
        ("norse_lifboxcell", "norse_lifboxcell", ["--from=norse", "--dt=2e-3"], "--dt 0.001"),
        ("spikingjelly_lif_slow", "spikingjelly_lif_slow", [], "--from spikingjelly"),
        (
            "snntorch_synaptic",
            "snntorch_synaptic_default",
            ["--delay", "1"],
            "--reset subtract-delayed and --delay 0",
        ),
    ],
)
def test_the_likeliest_cause_is_named(network, recording, words, cause):
    found = against(network, recording, *words)
    assert found.exit_code == 1
    assert "your framework ≠ our float: inference 0, timestep " in found.stdout
    assert f"likeliest cause: {cause}" in found.stdout


def test_a_threshold_that_is_reached_is_told_from_one_that_is_passed(tmp_path):
    # V = x, which is the threshold
    recorded, node = tmp_path / "a.npz", cuba(1, alpha=0.0, beta=0.5, threshold=1.0)
    nir.write(tmp_path / "a.nir", chain(nir.Linear(np.ones((1, 1))), node, width=1, act=1))
    np.savez(recorded, input=np.array([[1], [0], [0]]), output=np.array([[1], [0], [0]]))
    found = check(tmp_path / "a.nir", "--against", recorded)
    assert "likeliest cause: --spikes reached, with which all are equal" in found.stdout


def test_a_file_that_cannot_be_read_alone_is_read_as_each_tool_writes_it():
    found = against("norse_lifcell", "norse_lifcell")
    assert found.exit_code != 0
    assert "With --from norse your framework = our float: equal." in str(found.exception)


def test_without_a_cause_the_nearest_option_is_named(tmp_path):
    with np.load(EXPORTS / "snntorch_leaky_default.npz") as arrays:
        inputs, outputs = arrays["input"], arrays["output"].copy()
    outputs[150, 2] ^= 1
    np.savez(tmp_path / "a.npz", input=inputs, output=outputs, membrane=outputs)
    found = check(LEAKY, "--against", tmp_path / "a.npz", "--reset", "zero", "--json")
    report = json.loads(found.stdout)
    assert report["cause"] == []
    assert report["nearest"] == {"option": "--reset subtract-delayed", "differ": 1}
    assert report["unread"] == ["membrane"]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"input": (5, 12)}, "holds the arrays input; needed are `input` and `output`"),
        ({"input": (5, 11), "output": (5, 6)}, r"input has shape \(5, 11\); node 'input' needs"),
        ({"input": (5, 12), "output": (5, 7)}, r"output has shape \(5, 7\)"),
        ({"input": (5, 12), "output": (4, 6)}, r"input has \(B, T\) = \(1, 5\), output \(1, 4\)"),
        ({"input": (5, 1, 12), "output": (5, 1, 6)}, "5 inferences of one timestep"),
    ],
)
def test_wrong_keys_and_shapes_are_named(arrays, message, tmp_path):
    np.savez(tmp_path / "a.npz", **{name: np.zeros(shape) for name, shape in arrays.items()})
    found = check(LEAKY, "--against", tmp_path / "a.npz", "--from", "snntorch")
    with pytest.raises(type(found.exception), match=message):
        raise found.exception


NEEDS = {
    "snntorch": "snntorch.export_nir",
    "norse": "norse.torch",
    "spikingjelly": "spikingjelly.activation_based.nir_exchange",
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("tool", NEEDS)
def test_an_example_exports_what_check_finds_equal(tool, tmp_path, monkeypatch):
    reason = f"{tool}'s export is not installed; ./spike test --peers runs its example"
    pytest.importorskip(NEEDS[tool], reason=reason, exc_type=ImportError)
    monkeypatch.setattr(sys, "argv", ["example", str(tmp_path)])
    runpy.run_path(str(ROOT / f"examples/from_{tool}.py"), run_name="__main__")
    found = check(tmp_path / f"{tool}.nir", "--from", tool, "--against", tmp_path / f"{tool}.npz")
    assert "your framework = our float: equal, 400 outputs" in found.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [(("--chip", "loihi1"), "Give one of them"), (("-o", "out"), "SystemExit(2)")],
)
def test_a_recording_goes_without_chips_and_pages(words, said):
    found = against("snntorch_leaky", "snntorch_leaky_default", *words)
    assert said in repr(found.exception)
