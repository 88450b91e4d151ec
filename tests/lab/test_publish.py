"""Publishing: a run becomes a file, a card and a curve that belong together."""

import json

import numpy as np
import pytest

from lab.publish import publish_run, update_card
from spikedeploy import zoo
from spikedeploy.exporters.check import ParityCheck
from spikedeploy.policies.registry import find
from spikedeploy.runtime import load
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.shipping import export_run as export_run_module
from spikedeploy.shipping.export_run import export_run, kind_of
from spikedeploy.shipping.export_run import record_observations as observe
from spikedeploy.trainers.config import (
    DeltaSnnConfig,
    MlpConfig,
    NetworkConfig,
    PopsanConfig,
    PrunedMlpConfig,
)
from spikedeploy.trainers.policies import MlpPolicy, PopsanPolicy, from_config
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sac import SacConfig
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.sparse_ppo import SparsePpoConfig
from tests import toy_stroll_env

SPIKING = PopsanConfig(hidden=(6,), populations=3)


@pytest.fixture(autouse=True)
def _stroll(monkeypatch):
    toy_stroll_env.install(monkeypatch)


@pytest.fixture(autouse=True)
def _few_observations(monkeypatch):
    """Parity on thirty observations."""
    monkeypatch.setattr(
        export_run_module, "record_observations", lambda run, _, name: observe(run, 30, name)
    )


def publish(run, name, folder, **options):
    return publish_run(str(run), name, **{"episodes": 1, "processes": 1, **options}, folder=folder)


@pytest.mark.parametrize(
    ("policy", "suffix", "chips"),
    [
        (SPIKING, ".nir", ["float", "loihi1"]),
        (MlpConfig(hidden=(4,)), ".onnx", [None]),
        (NetworkConfig(chip="tinyodin", hidden=(6,)), ".nir", ["tinyodin"]),
    ],
)
def test_a_published_run_has_file_card_page_curve_and_evaluation(policy, suffix, chips, tmp_path):
    files = [f"small{each}" for each in (suffix, ".json", ".md", ".png", ".csv")]
    run = toy_stroll_env.run_folder(tmp_path / "runs", policy)
    note = "grown in a pot"
    written = publish(run, "small", tmp_path / "zoo", episodes=2, note=note)
    assert [path.relative_to(tmp_path / "zoo/stroll").name for path in written] == files
    card = json.loads((tmp_path / "zoo/stroll/small.json").read_text())
    told = (card["recipe"], card["seed"], card["steps"], card["env"])
    assert told == ("smoke", 0, 5, toy_stroll_env.ID)
    assert [row["chip"] for row in card["evaluation"]] == chips
    assert all(row["episodes"] == 2 and row["file"] == files[0] for row in card["evaluation"])
    assert all(check["passed"] for check in card["parity"])
    assert find(str(written[0])).kind == card["kind"]
    page = (tmp_path / "zoo/stroll/small.md").read_text()
    assert "spikedeploy train smoke --seed 0 --set 'env.name=\"stroll\"'" in page
    assert "- note: grown in a pot" in page
    assert f"- ✓ {card['parity'][0]['name']}" in page
    assert "![learning curve](small.png)" in page
    assert str(tmp_path) not in page + (tmp_path / "zoo/stroll/small.json").read_text()


def test_a_card_names_no_folder_of_the_machine_that_made_it(monkeypatch, tmp_path):
    run = toy_stroll_env.run_folder(tmp_path / "runs", SPIKING)
    settings = json.loads((run / "config.json").read_text())
    settings["env"]["options"] = {"teacher": str(run), "twice": [str(run)]}
    (run / "config.json").write_text(json.dumps(settings))
    monkeypatch.setattr(RunFolder, "config", lambda *_: SacConfig(algorithm="sac", recipe="smoke"))
    monkeypatch.setattr(
        "spikedeploy.shipping.export_run.record_observations", lambda *_: np.zeros((2, 3))
    )
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


def test_what_is_linear_or_pruned_is_a_control():
    assert kind_of(MlpPolicy(3, 2, hidden=(4,))) == "ann"
    assert kind_of(MlpPolicy(3, 2, hidden=())) == "control"
    assert kind_of(from_config(PrunedMlpConfig(hidden=(4,)), 3, 2)) == "control"
    assert kind_of(PopsanPolicy(3, 2, hidden=(4,))) == "snn"


def test_parity_is_checked_on_observations_of_the_policys_own_episodes(tmp_path):
    run = toy_stroll_env.run_folder(tmp_path, SPIKING)
    observations = observe(run, 45)  # more than two episodes of 21
    assert observations.shape == (45, 3)
    assert len({tuple(row) for row in observations}) == 45


def sparse_run(runs, recipe, policy, **settings):
    """A run folder as a training by imitation would leave it."""
    config = SparseConfig(
        algorithm="sparse", recipe=recipe, env={"name": "stroll"}, policy=policy, **settings
    )
    run = RunFolder.create(runs, config)
    for name, updates in (("ops-9", 100), ("ops-6", 300), ("best", 300), ("last", 400)):
        network = from_config(policy, observations=3, actions=2)
        run.save(name, network, {"updates": updates, "eval_return": 1.0})
    run.metrics.write_text("updates,episode_return,eval_return\n200,1.0,\n400,2.0,3.0\n")
    return run.path


def tuned_run(runs, start, policy):
    """A run folder as a training with reward would leave it."""
    config = SparsePpoConfig(
        algorithm="sparse-ppo", recipe="smoke-sparse-tuned", env={"name": "stroll"}, policy=policy,
        start=start.name,
    )  # fmt: skip
    run = RunFolder.create(runs, config)
    network = from_config(policy, observations=3, actions=2)
    run.save("best", network, {"iterations": 2, "env_steps": 40})
    run.metrics.write_text("iterations,env_steps,eval_return\n0,0,1.0\n3,60,2.0\n")
    return run.path


def test_a_level_of_pruning_is_published_with_its_own_weights_and_steps(tmp_path):
    run = sparse_run(tmp_path / "runs", "smoke-sparse", DeltaSnnConfig(hidden=4))
    file = publish(run, "level", tmp_path / "zoo", checkpoint="ops-9")[0]
    best = publish(run, "best", tmp_path / "zoo")[0]
    level, whole = (load(each).provenance for each in (file, best))
    assert (level.checkpoint, level.steps, whole.checkpoint, whole.steps) == ("ops-9", 100, "", 300)
    assert level.sha256 != whole.sha256
    card = json.loads(file.with_suffix(".json").read_text())
    assert (card["checkpoint"], card["steps"], card["steps_unit"]) == ("ops-9", 100, "updates")
    page = file.with_suffix(".md").read_text()
    assert "- updates: 100\n" in page
    assert "environment steps" not in page
    assert "- checkpoint: ops-9, the best of those pruned to 9 operations a control step" in page
    assert "- checkpoint: best\n" in best.with_suffix(".md").read_text()


def test_a_file_of_another_checkpoint_lies_beside_that_of_the_best(tmp_path):
    run = sparse_run(tmp_path, "smoke-sparse-mlp", PrunedMlpConfig(hidden=(4,)))
    paths = [
        export_run(str(run), "onnx", observations=30, checkpoint=each) for each in (None, "ops-6")
    ]
    assert [each.path.name for each in paths] == ["policy.onnx", "policy-ops-6.onnx"]
    assert all(each.passed for each in paths)


def test_an_unknown_checkpoint_is_named_with_those_that_there_are(tmp_path):
    run = sparse_run(tmp_path, "smoke-sparse", DeltaSnnConfig(hidden=4))
    with pytest.raises(ConfigError, match="no checkpoint 'ops-7'; it has: best, last, ops-6, ops"):
        publish(run, "level", tmp_path / "zoo", checkpoint="ops-7")


def test_a_page_names_the_runs_that_walks_and_the_start_came_from(tmp_path):
    runs, policy = tmp_path / "runs", PrunedMlpConfig(hidden=(4,))
    spiking = sparse_run(runs, "smoke-sparse", DeltaSnnConfig(hidden=4))
    baseline = sparse_run(runs, "smoke-sparse-mlp", policy, pool=spiking.name, teacher_walks=0)
    run = tuned_run(runs, baseline, policy)
    file = publish_run(str(run), "tuned", 1, tmp_path / "zoo", processes=1)[0]
    page = file.with_suffix(".md").read_text()
    (made,) = [line for line in page.splitlines() if line.startswith("- made by: ")]
    first, second, third = made.removeprefix("- made by: ").split(", then ")
    assert first.startswith("`spikedeploy train smoke-sparse --seed 0")
    assert second.startswith("`spikedeploy train smoke-sparse-mlp --seed 0")
    assert f"--set 'pool=\"{spiking.name}\"'" in second
    assert third.startswith("`spikedeploy train smoke-sparse-tuned --seed 0")
    assert f"--set 'start=\"{baseline.name}\"'" in third
    assert "policy." not in third  # it is that of the start
    assert "- environment steps: 40, after 300 updates by imitation\n" in page
    card = json.loads(file.with_suffix(".json").read_text())
    assert [(each["run"], each["gives"]) for each in card["before"]] == [
        (spiking.name, "pool"), (baseline.name, "start"),
    ]  # fmt: skip


def test_a_card_names_the_run_that_walks_came_from(tmp_path):
    policy = PrunedMlpConfig(hidden=(4,))
    walks = sparse_run(tmp_path, "smoke-sparse", DeltaSnnConfig(hidden=4))
    run = sparse_run(tmp_path, "smoke-sparse-mlp", policy, seed=1, pool=walks.name)
    file = publish_run(str(run), "walked", 1, tmp_path / "zoo", processes=1)[0]
    card = json.loads(file.with_suffix(".json").read_text())
    assert [(each["run"], each["gives"]) for each in card["before"]] == [(walks.name, "pool")]


def test_a_pruned_float_policy_is_not_measured_against_itself(tmp_path, command):
    run = sparse_run(tmp_path, "smoke-sparse-mlp", PrunedMlpConfig(hidden=(4,)))
    file = export_run(str(run), "onnx", observations=30).path
    for policy in (file, run):
        code, out, _ = command("run", policy, "--json")
        assert code == 0
        (row,) = json.loads(out)["rows"]
        assert (row["kind"], row["ratio_to_float_ann"]) == ("control", None)
        assert "100.0%" not in command("run", policy)[1]


@pytest.mark.parametrize(
    "name", ["", ".", "../../evil", "a/b", "a\\b", "/evil", "v0.5", "-x", "a b"]
)
def test_a_name_that_is_a_path_or_empty_is_refused(name, tmp_path):
    with pytest.raises(ConfigError, match="letters, digits, - and _ alone") as error:
        publish_run("no-run", name, 1, tmp_path / "zoo", 1)
    assert repr(name) in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_name_is_one_policy_whatever_kind_it_had_before(tmp_path, capsys):
    told = []
    for number, (policy, suffix) in enumerate(
        [(SPIKING, ".nir"), (MlpConfig(hidden=(4,)), ".onnx")]
    ):
        run = toy_stroll_env.run_folder(tmp_path / str(number), policy)
        for name in ("small", "smaller"):
            publish(run, name, tmp_path / "zoo")
        found = {p.name for p in (tmp_path / "zoo/stroll").iterdir() if p.suffix in zoo.SUFFIXES}
        assert found == {f"small{suffix}", f"smaller{suffix}"}
        told.append(" ".join(capsys.readouterr().err.split()))
    assert "replaced" not in told[0]
    names = "small.csv, small.json, small.md, small.nir, small.png"
    assert f"zoo/stroll: {names}" in told[1]
    assert told[1].count("replaced in") == 2


def test_an_update_writes_other_numbers_and_keeps_the_card_where_a_return_differs(tmp_path):
    run = toy_stroll_env.run_folder(tmp_path / "runs", SPIKING)
    card = publish(run, "small", tmp_path / "zoo")[1]
    whole = json.loads(card.read_text())
    edited = json.loads(card.read_text())
    edited["evaluation"][1]["macs_dense"] += 1
    card.write_text(json.dumps(edited))
    update_card(str(card), 1)
    assert json.loads(card.read_text()) == whole
    edited["evaluation"][0]["returns"][0] += 1e-6
    card.write_text(json.dumps(edited))
    with pytest.raises(ConfigError, match="The card is kept"):
        update_card(str(card), 1)
