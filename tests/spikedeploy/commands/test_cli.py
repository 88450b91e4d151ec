"""The command line: what people see, what machines read, and how it fails."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from spikedeploy import cli, zoo
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program as compiled
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.trainers.config import MlpConfig, PopsanConfig
from spikedeploy.user_errors import one_line
from tests import toy_stroll_env
from tests.networks import popsan
from tests.paths import GOLDEN

VERBS = [verb for verbs in cli.COMMANDS.values() for verb in verbs]


@pytest.mark.parametrize("verb", VERBS)
def test_every_command_explains_itself(verb, command):
    code, out, _ = command(verb, "--help")
    assert code == 0
    assert "--json" in out


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


def test_emulate_writes_every_spike_and_counts_them(command, tmp_path):
    artifact = popsan()
    save(artifact, tmp_path / "p.nir")
    raster = (np.random.default_rng(0).random((5, 30)) < 0.3).astype(np.uint8)
    np.save(tmp_path / "raster.npy", raster)
    words = ("emulate", tmp_path / "p.nir", "--input", tmp_path / "raster.npy", "--chip", "loihi1")
    code, out, _ = command(*words, "-o", tmp_path / "out.npz", "--json")
    found = json.loads(out)
    expected = trace(compiled(artifact, chip("loihi1")), raster[None])
    with np.load(tmp_path / "out.npz") as arrays:
        assert set(arrays) == {*expected, "output"}
        assert arrays["output"].shape == (5, 2)
        for name, layer in expected.items():
            assert arrays[name].dtype == np.uint8
            np.testing.assert_array_equal(arrays[name], layer.spikes[0])
    assert code == 0
    assert found["spikes"] == sum(int(layer.spikes.sum()) for layer in expected.values()) > 0
    assert found["sops"] > 0
    assert found["neuron_updates"] > 0
    assert found["convention"]["reset"] == "zero"
    assert found["clock"] == "free, 3 chip timesteps more an inference"
    _, out, _ = command(*words, "-o", tmp_path / "out.npz", "--force")
    assert found["clock"] in " ".join(out.split())
    assert found["energy_j"].keys() == {"davies2018", "sanafe", "horowitz45-int8"}


def test_emulate_without_an_output_counts_and_writes_nothing(command, tmp_path):
    save(popsan(), tmp_path / "p.nir")
    np.save(tmp_path / "in.npy", (np.random.default_rng(0).random((5, 30)) < 0.3).astype(np.uint8))
    words = ("emulate", tmp_path / "p.nir", "--input", tmp_path / "in.npy", "--chip", "loihi1")
    before = sorted(tmp_path.iterdir())
    code, out, _ = command(*words)
    assert code == 0
    assert "wrote" not in out
    assert "sums of outputs" in out
    found = json.loads(command(*words, "--json")[1])
    for layer in found["layers"].values():
        assert f"{layer['spikes']:,}" in out
        assert f"{layer['sops']:,}" in out
    assert sorted(tmp_path.iterdir()) == before
    code, _, err = command("emulate", tmp_path / "p.nir", "--chip", "loihi1")
    assert code == 2
    assert "--input FILE" in err


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((2, 3, 4)), r"shape \(1, 2, 3, 4\) with its batch; node 'input' takes"),
        (np.full((5, 30), 2), "0 or 1"),
        (np.array([{}], dtype=object), "not a .npy or .npz file with plain arrays"),
    ],
)
def test_emulate_refuses_what_is_no_raster(array, message, command, tmp_path):
    save(popsan(), tmp_path / "p.nir")
    np.save(tmp_path / "bad.npy", array, allow_pickle=True)
    words = ("emulate", tmp_path / "p.nir", "--input", tmp_path / "bad.npy", "--chip", "loihi1")
    code, _, err = command(*words, "-o", tmp_path / "out.npz")
    assert code == 2
    assert re.search(message, err)
    assert not (tmp_path / "out.npz").exists()


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


def test_a_resumed_run_keeps_its_seed(command):
    code, _, err = command("train", "smoke", "--resume", "last", "--seed", 3)
    assert code == 2
    assert "leave --seed out" in err


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


def test_policies_that_cannot_be_opened_for_one_reason_are_one_line(command, monkeypatch):
    said = "nir 0.9.0 is installed, and spikedeploy needs nir >=1.0.8,<2"
    for module in ("runtime.requirements", "user_errors"):
        monkeypatch.setattr(f"spikedeploy.{module}.wrong_requirements", lambda **_: iter([said]))
    monkeypatch.setattr("spikedeploy.zoo.names", lambda: ["a/one", "a/two", "a/three"])
    raised = iter([ImportError("x"), AttributeError("y"), ModuleNotFoundError("z", name="nir.z")])

    def fail(name):
        raise next(raised)

    monkeypatch.setattr("spikedeploy.commands.listings._opened", fail)
    code, out, _ = command("doctor", "--json")
    failed = [(f["name"], f["detail"]) for f in json.loads(out) if f["ok"] is False]
    assert code == 1
    assert failed[0] == ("version", said)
    assert failed[-1] == ("a/one and 2 others", "not opened, see above")
    assert "a/two" not in out


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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", "nowhere.nir"), "no policy at 'nowhere.nir'"),
        (("run", "gait", "--env", "hexapd"), "did you mean 'hexapod'?"),
        (("run", "stroll/popsan", "--chip", "loihi9"), "did you mean 'loihi2' or 'loihi1'"),
        (("compare", "stroll", "--seed", "0"), "evaluation starts at 10000"),
        (("train", "hexapod-sax"), "hexapod-sac"),
        (("visualize", "."), "metrics.csv"),
        (("export", "nowhere", "--to", "nir"), "nowhere"),
    ],
)
def test_an_error_that_users_can_act_on_is_one_line_and_exit_code_2(
    words, message, command, stroll
):
    code, out, err = command(*words)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert message in err


@pytest.mark.parametrize(
    "words", [(), ("walk",), ("run",), ("compare", "hexapod", "--episodes", "0"), ("envs", "--xml")]
)
def test_wrong_usage_is_exit_code_2(words, command):
    assert command(*words)[0] == 2


def test_a_bug_keeps_its_traceback():
    assert one_line(KeyError("x")) is None
    assert one_line(ModuleNotFoundError("No module named 'spikedeploy.x'", name="x")) is None


TRACE = GOLDEN / "lava_A_popsan_decays.json"


def test_verify_names_a_file_once_that_it_cannot_read(command, tmp_path):
    network, missing = tmp_path / "net.nir", tmp_path / "missing.json"
    network.write_bytes(b"\x89HDF\r\n")
    code, out, _ = command("verify", network, missing)
    assert code == 2
    assert out.splitlines() == [
        f"✗ {network}: not replayed: this is not a text file. A trace is JSON, as docs/traces.md "
        "shows.",
        f"✗ {missing}: not replayed: No such file or directory",
    ]


def test_verify_replays_the_traces_of_a_folder(command):
    code, out, _ = command("verify", GOLDEN / "speck", "--json")
    assert (code, len(json.loads(out))) == (0, 3)


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
