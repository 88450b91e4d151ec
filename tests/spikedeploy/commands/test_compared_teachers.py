"""`compare --teacher`: what `distill` imitates, as a row on the same seeds."""

import json
import shlex
import shutil
import sys
from itertools import pairwise

import pytest

from spikedeploy.policies.registry import find
from spikedeploy.policies.scripts import teacher_candidate
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.onnx_session import OnnxOperators
from tests.paths import ROOT

REACH, LEVELS = "tests.own_env:Reach", "tests.own_env:Levels"
SB3 = ROOT / "tests/golden/sb3"


@pytest.fixture
def rows(command, tmp_path, monkeypatch):
    """Rows of a comparison of two episodes, by policy."""
    monkeypatch.chdir(tmp_path)

    def compared(*words, workers=1):
        numbers = ("--episodes", 2, "--workers", workers, "--json")
        code, out, err = command("compare", *words, *numbers)
        assert code == 0, err
        return {row["policy"]: row for row in json.loads(out)["rows"]}

    return compared


@pytest.mark.parametrize(
    ("env", "teacher", "more", "best"),
    [
        (REACH, "reach", [], 0.0),
        (REACH, "reach_all", ["--disturb", "delay=0"], 0.0),
        (REACH, "reach_scaled", ["--teacher-units", "scaled"], 0.0),
        (LEVELS, "level", [], 5.0),
        (LEVELS, "level_logits", [], 5.0),
    ],
)
def test_a_function_is_a_script_that_acts_in_units_of_the_environment(
    env, teacher, more, best, rows
):
    row = rows(env, "--teacher", f"tests.own_teachers:{teacher}", *more)[
        f"tests.own_teachers:{teacher}"
    ]
    assert row["return_mean"] == pytest.approx(best, abs=1e-4)
    assert (row["kind"], row["training_seeds"], row["macs_dense"]) == ("control", None, None)


def test_workers_play_a_function_of_the_current_folder(rows, tmp_path):
    (tmp_path / "my_level.py").write_text("def act(observation):\n    return observation - 6\n")
    assert rows(LEVELS, "--teacher", "my_level:act", workers=2)["my_level:act"]["returns"] == [5, 5]


def test_an_onnx_file_of_others_acts_in_units_of_the_environment(tmp_path):
    file = shutil.copy(ROOT / "tests/golden/rsl_rl/policy.onnx", tmp_path)
    assert teacher_candidate(str(file)).format == "teacher"
    ours = str(next((ROOT / "spikedeploy/zoo/kart-steer").glob("*.onnx")))
    assert teacher_candidate(ours) == find(ours)
    with pytest.raises(ConfigError, match="says itself how it acts"):
        teacher_candidate(ours, "own")


@pytest.mark.parametrize(
    ("name", "env", "widths"),
    [("ppo", "CartPole-v1", (4, 8, 6, 2)), ("sac", REACH, (4, 8, 6, 2))],
)
def test_operations_of_a_model_of_stable_baselines_are_counted(name, env, widths, rows):
    row = rows(env, "--teacher", SB3 / f"{name}.zip")[name]
    assert row["macs_dense"] == sum(a * b for a, b in pairwise(widths))
    assert row["energy_per_inference_j"]["horowitz45-int8"] == pytest.approx(
        1.55e-12 * row["macs_dense"]
    )


@pytest.mark.parametrize(
    ("names", "shapes", "widths"),
    [
        (("MatMul", "Add", "MatMul"), [(3, 5), (5,), (5, 1)], (3, 5, 1)),
        (("Gemm", "Tanh", "Gemm"), [(5, 3), (5,), (1, 5), (1,)], (3, 5, 1)),
        (("MatMul", "LSTM"), [(3, 5), (1, 20, 5)], (3, 5)),
        (("MatMul",), [(3, 5), (3, 5)], ()),
        (("Gemm", "Gemm"), [(5, 3), (4, 2)], ()),
        (("Tanh",), [], ()),
    ],
)
def test_widths_are_known_where_matrices_fit_one_behind_the_other(names, shapes, widths):
    assert OnnxOperators(names, False, tuple(shapes)).widths == widths
    assert OnnxOperators(names, True, tuple(shapes)).widths == ()


@pytest.mark.parametrize("verb", ["run", "compare"])
def test_only_the_option_has_a_function_run(verb, command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text(
        "import pathlib\npathlib.Path('ran').touch()\ndef act(seen): return 0\n"
    )
    words = ["evil:act", "--env", "CartPole-v1"] if verb == "run" else ["CartPole-v1", "evil:act"]
    code, _, err = command(verb, *words)
    assert code == 2
    assert "compare ENV --teacher evil:act" in " ".join(err.split())
    assert not (tmp_path / "ran").exists()


def test_a_report_with_a_teacher_is_not_reproduced_and_runs_no_code(
    command, tmp_path, monkeypatch, rows
):
    (tmp_path / "mine.py").write_text(
        "import pathlib\npathlib.Path('ran').touch()\ndef act(seen): return seen - 6\n"
    )
    rows(LEVELS, "--teacher", "mine:act", "-o", "found")
    (tmp_path / "ran").unlink()
    report = json.loads((tmp_path / "found/report.json").read_text())
    report["command"] = f"spikedeploy compare {LEVELS} --teacher mine:act"
    (tmp_path / "found/report.json").write_text(json.dumps(report))
    monkeypatch.delitem(sys.modules, "mine")
    code, _, err = command("reproduce", "found", "--env", LEVELS)
    assert code == 2
    assert "run its command again" in " ".join(err.split())
    assert not (tmp_path / "ran").exists()


def test_after_distill_the_next_command_has_the_teacher(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    quick = [
        "states=24", "iterations=2", "updates=20", "env.count=2", "validation.every=10",
        "validation.episodes=1", "policy.populations=2", "teacher_units=scaled",
    ]  # fmt: skip
    settings = [word for each in quick for word in ("--set", each)]
    name = "tests.own_teachers:reach_scaled"
    code, out, err = command("distill", name, "--env", REACH, "--dense", "--size", "8", *settings)
    assert code == 0, err
    words = shlex.split(out.rpartition("next: ")[2])
    assert words[-4:] == ["--teacher", name, "--teacher-units", "scaled"]


def test_a_model_of_stable_baselines3_is_the_float_ann(rows):
    found = rows("CartPole-v1", "--teacher", SB3 / "ppo.zip")
    assert found["ppo"]["kind"] == "ann"
    assert found["random"]["ratio_to_float_ann"] is not None
    assert found["random"]["reference"] == "ppo"
