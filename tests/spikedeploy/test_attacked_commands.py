"""Commands as they were attacked: each says one sentence, and nothing is lost."""

import json
import os
import shutil
import subprocess
import sys

import pytest

from spikedeploy.policies import run_record
from spikedeploy.policies.nir import read_codec
from spikedeploy.policies.run_record import policy_of
from spikedeploy.runtime.errors import ArtifactError, ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.policies import MlpPolicy
from spikedeploy.trainers.ppo import PpoConfig
from spikedeploy.trainers.run_folder import RunFolder
from tests.paths import ROOT

NET = ROOT / "examples" / "net.nir"
NORSE = ROOT / "tests/golden/exports/norse_lifcell.nir"


@pytest.fixture
def run(tmp_path):
    """A run folder with a checkpoint."""
    config = resolve(PpoConfig, "kart-grid-ann", overrides=["policy.hidden=[4]"], seed=0)
    made = RunFolder.create(tmp_path / "runs", config)
    state = {"env_steps": 10, "finished": False, "share": 0.5}
    made.save("best", MlpPolicy(12, 5, [4], head="discrete"), state)
    return made.path


def refused(done, says):
    code, out, err = done
    assert code == 2, err
    assert says in " ".join(err.split()), err
    assert "Traceback" not in err + out


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="a device of POSIX")
def test_a_device_as_input_does_not_hang(tmp_path, command):
    words = ("emulate", NET, "--chip", "float", "--input", "/dev/zero", "-o", tmp_path / "o.npz")
    refused(command(*words), "/dev/zero is no file")


def checked(cwd, *words, **environ):
    """`check` in a process of its own, whose stderr is empty."""
    command = [sys.executable, "-m", "spikedeploy", "check", *words]
    done = subprocess.run(
        command, cwd=cwd, env={**environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_packages_called_runtime_or_envs_of_somebody_else_are_not_imported(tmp_path):
    for name in ("runtime", "envs", "trainers", "exporters"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('not ours')")
    checked(tmp_path, str(NET), **os.environ)


def test_names_of_any_script_no_home_and_a_folder_that_takes_nothing(tmp_path):
    strange = tmp_path / "ünïcødé 日本 [bold]"
    strange.mkdir()
    shutil.copy(NET, strange / "é.nir")
    environ = {name: value for name, value in os.environ.items() if name != "HOME"}
    found = checked("/proc", str(strange / "é.nir"), "--json", **environ)
    assert "[bold]" in json.dumps(json.loads(found), ensure_ascii=False)


@pytest.mark.parametrize("option", ["colour=3", "track=[[[["])
def test_an_option_that_the_environment_has_not_is_refused_by_training(option, tmp_path, command):
    words = ("train", "smoke-kart", "--set", f"env.options.{option}", "--runs", tmp_path)
    says = "has no option 'colour'" if "colour" in option else "unknown track '[[[['"
    refused(command(*words), says)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["[1]", "[" * 100_000])
@pytest.mark.parametrize("words", [("export",), ("train", "--resume")])
def test_a_cut_configuration_is_a_sentence(words, text, run, command):
    (run / "config.json").write_text(text)
    refused(command(*words, run), "config.json")


@pytest.mark.parametrize(
    ("file", "changes", "read"),
    [
        ("config.json", {"env": {"name": []}}, run_record.env_of),
        ("config.json", {"seed": None}, run_record.origin),
        ("config.json", {"policy": {}}, run_record.format_of),
        ("checkpoints/best.json", {"env_steps": [1]}, run_record.steps),
        ("checkpoints/last.json", {"finished": False, "share": []}, run_record.describe_progress),
    ],
)
def test_strange_records_of_a_run_are_refused_by_name(file, changes, read, run):
    shutil.copy(run / "checkpoints/best.json", run / "checkpoints/last.json")
    record = json.loads((run / file).read_text())
    (run / file).write_text(json.dumps({**record, **changes}))
    with pytest.raises(ConfigError, match=f"{file.rpartition('/')[2]} is damaged"):
        read(run)


@pytest.mark.parametrize("change", ["missing", "clip"])
def test_a_checkpoint_without_its_policy_is_refused_in_a_sentence(change, run):
    policy = MlpPolicy(12, 5, [4], head="discrete")
    if change == "missing":
        del policy.layers[0].weight
    else:
        policy.normalizer.clip = {}
    RunFolder(run).save("best", policy, {"env_steps": 10})
    with pytest.raises(ConfigError, match=r"checkpoint best or last holds no whole policy \(\w+"):
        policy_of(run)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[" * 100_000, "is damaged"),
        ("[1]", "codec.json"),
        ('{"normaliser": {"mean": [0], "std": [1], "clip": %s}}' % ("9" * 400), "finite number"),
        ('{"normaliser": {"mean": [0, [1]]}}', "inhomogeneous"),
        ('{"timesteps": 16, "squash": "argmax"}', "normaliser"),
    ],
)
def test_a_strange_codec_is_refused_in_a_sentence(text, says, tmp_path, command):
    (tmp_path / "codec.json").write_text(text)
    with pytest.raises(ArtifactError, match=says):
        read_codec(tmp_path / "codec.json")
    shutil.copy(NORSE, tmp_path / "net.nir")
    words = ("run", tmp_path / "net.nir", "--from", "norse", "--codec", tmp_path / "codec.json")
    refused(command(*words, "--env", "CartPole-v1"), says)
    assert not (tmp_path / "net.policy.nir").exists()


@pytest.mark.parametrize(("words", "says"), [
    (("reproduce", "card.json"), "card.json"),
    (("distill", "bad.onnx", "--env", "CartPole-v1"), "is not an ONNX file that can be run"),
    (("distill", "bad.zip", "--env", "CartPole-v1"), "cannot be read as a model of Stable-B"),
    (("distill", "mine:number", "--env", "CartPole-v1"), "is no function of an observation, but 3"),
    (("distill", "mine:Actor", "--env", "CartPole-v1"), "mine:Actor is a class: name a function"),
    (("distill", "mine:absent", "--env", "CartPole-v1"), "has no 'absent'"),
    (("distill", "nowhere_at_all:f", "--env", "CartPole-v1"), "there is no module nowhere_at_all"),
])  # fmt: skip
def test_broken_cards_and_teachers_are_refused(words, says, tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("card.json", "bad.onnx", "bad.zip"):
        (tmp_path / name).write_text("[" * 100_000)
    (tmp_path / "mine.py").write_text("number = 3\nclass Actor: pass\n")
    sys.modules.pop("mine", None)
    refused(command(*words), says)
    assert not [*tmp_path.glob("runs/*")]
