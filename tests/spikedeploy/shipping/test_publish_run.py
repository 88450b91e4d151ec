"""Publishing: a run becomes a file, a card and a curve that belong together."""

import json

import numpy as np
import pytest

from spikedeploy.exporters.check import ParityCheck
from spikedeploy.policies import run_record
from spikedeploy.policies.registry import find
from spikedeploy.runtime.errors import SpikedeployError
from spikedeploy.shipping.export_run import kind_of, recorded
from spikedeploy.shipping.publish_run import publish_run
from spikedeploy.trainers.config import MlpConfig, PopsanConfig
from spikedeploy.trainers.policies import MlpPolicy, PopsanPolicy
from spikedeploy.trainers.policies.features import Features
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sac.config import SacConfig
from tests import toy_stroll_env

SPIKING = PopsanConfig(hidden=(6,), populations=3)


@pytest.fixture(autouse=True)
def _stroll(monkeypatch):
    toy_stroll_env.install(monkeypatch)


@pytest.mark.parametrize(
    ("policy", "suffix", "chips"),
    [(SPIKING, ".nir", ["float", "loihi1"]), (MlpConfig(hidden=(4,)), ".onnx", [None])],
)
def test_a_published_run_has_file_card_curve_and_evaluation(policy, suffix, chips, tmp_path):
    files = [f"small{each}" for each in (suffix, ".json", ".md", ".png", ".csv")]
    run = toy_stroll_env.run_folder(tmp_path / "runs", policy)
    written = publish_run(str(run), "small", episodes=2, folder=tmp_path / "zoo", processes=1)
    assert [path.relative_to(tmp_path / "zoo/stroll").name for path in written] == files
    card = json.loads((tmp_path / "zoo/stroll/small.json").read_text())
    assert (card["recipe"], card["seed"], card["steps"], card["env"]) == (
        "smoke",
        0,
        5,
        toy_stroll_env.ID,
    )
    assert [row["chip"] for row in card["evaluation"]] == chips
    assert all(row["episodes"] == 2 and row["file"] == files[0] for row in card["evaluation"])
    assert all(check["passed"] for check in card["parity"])
    assert find(str(written[0])).kind == card["kind"]


def test_the_page_says_how_to_make_the_policy_again(tmp_path):
    run = toy_stroll_env.run_folder(tmp_path / "runs", SPIKING)
    zoo = tmp_path / "zoo"
    publish_run(str(run), "small", episodes=2, folder=zoo, processes=1, note="grown in a pot")
    page = (tmp_path / "zoo/stroll/small.md").read_text()
    assert "spikedeploy train smoke --seed 0 --set 'env.name=\"stroll\"'" in page
    assert "- note: grown in a pot" in page
    assert "| small · loihi1 |" in page
    assert "- ✓ spikes: torch = NumPy, float64" in page
    assert "![learning curve](small.png)" in page
    assert str(tmp_path) not in page + (tmp_path / "zoo/stroll/small.json").read_text()


def test_a_card_names_no_folder_of_the_machine_that_made_it(monkeypatch, tmp_path):
    run = toy_stroll_env.run_folder(tmp_path / "runs", SPIKING)
    settings = json.loads((run / "config.json").read_text())
    settings["env"]["options"] = {"teacher": str(run), "twice": [str(run)]}
    (run / "config.json").write_text(json.dumps(settings))
    monkeypatch.setattr(RunFolder, "config", lambda *_: SacConfig(algorithm="sac", recipe="smoke"))
    monkeypatch.setattr("spikedeploy.shipping.export_run.recorded", lambda *_: np.zeros((2, 3)))
    monkeypatch.chdir(tmp_path)
    publish_run(str(run), "small", episodes=1, folder=tmp_path / "zoo", processes=1)
    card = (tmp_path / "zoo/stroll/small.json").read_text()
    assert str(tmp_path) not in card
    assert f'"teacher": "runs/{run.name}"' in card


def test_a_file_that_differs_from_its_policy_is_not_published(monkeypatch, tmp_path):
    run = toy_stroll_env.run_folder(tmp_path / "runs", SPIKING)
    monkeypatch.setattr(
        "spikedeploy.shipping.export_run.check",
        lambda *_: [ParityCheck("spikes", False, "3 differ")],
    )
    with pytest.raises(SpikedeployError, match=r"does not do what .*: spikes"):
        publish_run(str(run), "small", episodes=1, folder=tmp_path / "zoo", processes=1)
    assert not (tmp_path / "zoo").exists()


def test_what_sees_less_or_is_linear_is_a_control():
    assert kind_of(MlpPolicy(3, 2, hidden=(4,))) == "ann"
    assert kind_of(MlpPolicy(3, 2, hidden=())) == "control"
    assert (
        kind_of(MlpPolicy(6, 2, hidden=(4,), features=Features("phase", 6, [2, 3], [])))
        == "control"
    )
    assert kind_of(PopsanPolicy(3, 2, hidden=(4,))) == "snn"


def test_parity_is_checked_on_observations_of_the_policys_own_episodes(tmp_path):
    run = toy_stroll_env.run_folder(tmp_path, SPIKING)
    observations = recorded(run, 45)  # more than two episodes of 21
    assert observations.shape == (45, 3)
    assert len({tuple(row) for row in observations}) == 45


def test_a_run_tells_its_origin(tmp_path):
    origin = run_record.origin(toy_stroll_env.run_folder(tmp_path, SPIKING))
    assert (origin.env, origin.recipe, origin.seed, origin.steps) == (
        toy_stroll_env.ID,
        "smoke",
        0,
        5,
    )
    assert origin.created.endswith("+00:00")
