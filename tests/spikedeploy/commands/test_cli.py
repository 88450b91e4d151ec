"""The command line: what people see, what machines read, and how it fails."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from spikedeploy import cli, zoo
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.trainers.config import MlpConfig, PopsanConfig
from spikedeploy.user_errors import one_line
from tests import toy_stroll_env
from tests.paths import GOLDEN

VERBS = [verb for verbs in cli.COMMANDS.values() for verb in verbs]


def test_no_arguments_print_the_help(command):
    _, out, err = command()
    assert all(verb in out + err for verb in VERBS)


@pytest.mark.parametrize(
    ("verb", "field", "name"),
    [
        ("envs", "name", "hexapod"),
        ("chips", "name", "ideal"),
        ("recipes", "name", "hexapod-popsan"),
        ("policies", "name", "gait"),
        ("policies", "name", "stroll/popsan"),
    ],
)
def test_what_exists_is_listed_for_people_and_for_machines(verb, field, name, command, stroll):
    assert name in command(verb)[1]
    _, out, err = command(verb, "--json")
    assert name in [row[field] for row in json.loads(out)]
    assert err == ""


def test_compare_writes_its_report(command, stroll):
    words = ("compare", "stroll", "--episodes", 2, "--workers", 1)
    code, out, _ = command(*words, "--json", "-o", "out")
    document = json.loads(out)
    assert code == 0
    names = {path.name for path in (stroll / "out").iterdir()}
    assert names == {"report.json", "report.html", "report.md", "returns.png", "energy.png"}
    assert json.loads((stroll / "out/report.json").read_text())["rows"] == document["rows"]


def test_compare_first_shows_one_table_of_80_columns(command, stroll):
    _, out, _ = command("compare", "stroll", "--episodes", 2, "--workers", 1)
    lines = [line.strip() for line in out.splitlines()]
    start = next(at for at, line in enumerate(lines) if line.startswith("policy "))
    head, _, *rows = lines[start : lines.index("", start)]
    assert head.split() == ["policy", "return", "of", "ANN", "success", "operations", "energy"]
    assert len(rows) == 4  # sac, popsan in float and on loihi1, gait
    assert all(len(line) <= 80 for line in [head, *rows])
    assert "What the others earn: the float ANN" in " ".join(out.split())
    assert "by horowitz45-int8" in out
    assert not any("sanafe" in line for line in [head, *rows])


def test_run_prints_one_line_of_verdict_and_all_tables_when_asked(command, stroll):
    _, out, _ = command("run", "stroll/popsan", "--episodes", 2)
    *wrapped, clock, energy, hint = out[out.index("popsan · loihi1: return ") :].splitlines()
    said = " ".join(line.strip() for line in wrapped)
    assert energy.startswith("Energy: ")
    assert clock == "Clock: free (popsan · loihi1)."
    assert "[" not in said
    assert "in 2 episodes, too few for an interval, " in said
    assert "SOPs a control step" in said
    assert said.endswith("by horowitz45-int8.")
    assert hint.endswith("--tables all")
    assert "What does an inference cost?" not in out
    _, out, _ = command("run", "stroll/popsan", "--episodes", 2, "--tables", "all")
    assert "What does an inference cost?" in out
    assert out.splitlines()[-len(wrapped) - 2 :] == [*wrapped, clock, energy]


def test_export_writes_whether_membranes_are_kept(command, stroll):
    run = toy_stroll_env.run_folder(stroll / "runs", PopsanConfig(hidden=(6,), populations=3))
    words = ("export", run, "--observations", 30, "--state", "kept", "--to")
    assert command(*words, "nir")[0] == 0
    assert load(run / "policy.nir").convention.state == "kept"
    code, _, err = command(*words, "onnx")
    assert code == 2
    assert "only a .nir file has membranes to keep" in err


def test_export_fails_with_exit_code_1_when_a_check_does(command, stroll, monkeypatch):
    from spikedeploy.exporters.check import ParityCheck

    run = toy_stroll_env.run_folder(stroll / "runs", MlpConfig(hidden=(6,)))
    monkeypatch.setattr(
        "spikedeploy.shipping.export_run.check",
        lambda *_: [ParityCheck("actions", False, "0.5 off")],
    )
    code, out, _ = command("export", run, "--to", "onnx")
    assert code == 1
    assert "✗ actions: 0.5 off" in out


def test_visualize_draws_the_curves_of_runs(command, stroll):
    run = toy_stroll_env.run_folder(stroll / "runs", MlpConfig(hidden=(4,)))
    _, out, _ = command("visualize", run, "-o", "curves.png", "--json")
    (curve,) = json.loads(out)["curves"]
    assert curve["name"] == run.name
    assert (curve["unit"], curve["signal"]) == ("environment steps", "validation")
    assert (curve["steps"], curve["returns"]) == ([5.0], [3.0])
    assert (stroll / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_visualize_says_in_a_sentence_that_a_run_has_no_metrics(command, stroll):
    run = toy_stroll_env.run_folder(stroll / "runs", MlpConfig(hidden=(4,)))
    moved = run.rename(stroll / "moved")
    assert command("visualize", "moved", "-o", "curves.png")[0] == 0
    (moved / "metrics.csv").unlink()
    code, _, err = command("visualize", "moved", "-o", "curves.png")
    assert (code, "moved/metrics.csv is missing: a run has its returns there" in err) == (2, True)
    os.mkfifo(moved / "metrics.csv")
    code, _, err = command("visualize", "moved", "-o", "curves.png")
    assert (code, "moved/metrics.csv is no plain file" in err) == (2, True)
    (moved / "config.json").unlink()
    (moved / "metrics.csv").unlink()
    assert command("visualize", "moved", "-o", "curves.png")[0] == 2
    code, _, err = command("visualize", run.name, "-o", "curves.png")
    assert (code, "is no run folder" in err) == (2, True)


def test_train_writes_a_run_folder_and_prints_it(command, tmp_path):
    words = ("train", "smoke", "--set", "steps=120", "--set", "validation.every=120")
    code, out, _ = command(*words, "--seed", 2, "--runs", tmp_path / "runs", "--json")
    assert code == 0
    run = Path(json.loads(out)["run"])
    assert run.name.startswith("smoke-s2-")
    assert 'http-equiv="refresh"' not in (run / "report.html").read_text()


def test_demo_says_in_a_line_that_nothing_is_shipped(command, monkeypatch, tmp_path):
    monkeypatch.setattr(zoo, "FOLDER", tmp_path)
    monkeypatch.chdir(tmp_path)
    code, out, err = command("demo")
    assert (code, out) == (0, "")
    assert "hexapod-command: no policies are shipped yet" in err


def test_doctor_finds_versions_threads_and_policies(command, stroll):
    code, out, _ = command("doctor", "--json")
    findings = {finding["name"]: finding for finding in json.loads(out)}
    assert findings["numpy"]["detail"] == np.__version__
    assert findings["stroll/popsan"]["ok"]
    assert "cores" in findings["threads"]["detail"]
    assert code == (0 if findings["rendering"]["ok"] else 1)


@pytest.mark.parametrize("make", [Path.touch, Path.mkdir])
def test_what_lies_at_the_name_of_a_shipped_policy_hides_it_from_no_list(make, command, stroll):
    (stroll / "stroll").mkdir()
    make(stroll / "stroll/popsan")
    code, out, _ = command("policies", "--json")
    assert code == 0
    files = {row["name"]: row["file"] for row in json.loads(out)}
    assert files["stroll/popsan"] == str(stroll / "zoo/stroll/popsan.nir")
    assert command("policies", "stroll/popsan")[0] == 0
    findings = {found["name"]: found for found in json.loads(command("doctor", "--json")[1])}
    assert findings["stroll/popsan"]["detail"] == "opens, kind snn"


def test_a_bug_keeps_its_traceback():
    assert one_line(KeyError("x")) is None
    assert one_line(ModuleNotFoundError("No module named 'spikedeploy.x'", name="x")) is None


TRACE = GOLDEN / "lava_A_popsan_decays.json"


def test_verify_tells_the_first_difference_and_goes_on(command, tmp_path):
    record = json.loads(TRACE.read_text())
    record["v"][17][2] += 64
    other, broken = tmp_path / "other.json", tmp_path / "broken.json"
    other.write_text(json.dumps(record))
    broken.write_text("{")
    code, out, _ = command("verify", other, broken, tmp_path / "missing.json", TRACE, "--json")
    assert code == 1
    differs, torn, missing, equal = json.loads(out)
    difference = differs["difference"]
    assert [difference[key] for key in ("step", "neuron", "quantity")] == [17, 2, "membrane"]
    assert difference["expected"] == difference["found"] + 64
    assert "not JSON" in torn["error"]
    assert "No such file" in missing["error"]
    assert [each["equal"] for each in (differs, torn, missing, equal)] == [False] * 3 + [True]
