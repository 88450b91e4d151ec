"""The robustness experiment in its smallest size: evaluated, written, resumed."""

from dataclasses import replace

import numpy as np
import pytest

from lab.experiments import robustness as page
from lab.experiments.robustness import UNDISTURBED, RobustnessDesign, file_name, read_table
from lab.experiments.runner import run_experiment
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.comparison.lineup import Entry
from spikedeploy.runtime.faults import faults
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.train import train

ENV = "kart-grid"
PARTS = (UNDISTURBED, "lidar-noise", "dead-neurons", "lost-spikes")


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    runs = str(tmp_path_factory.mktemp("robustness") / "runs")
    return RobustnessDesign(runs=runs, episodes=3, limit=15, env=ENV, specimens=2)


@pytest.fixture(scope="module")
def results(design, ran, tmp_path_factory):
    """The folder of the page of some parts."""
    folder = tmp_path_factory.mktemp("results")
    outcome = run_experiment(design, PARTS, 1, folder)
    assert (outcome.done, outcome.of, outcome.failed) == (4, len(design.names), {})
    return folder


def rows(results):
    return read_table(results / "robustness" / f"{ENV}.csv")


def test_the_line_up_is_the_ann_a_small_float_network_and_spiking_policies_on_the_chip(design):
    labels = [tested.label for tested in design.policies]
    assert labels[:3] == ["ann", "small", "linear"]
    assert "snn · loihi1" in labels[3:]
    assert all(label.endswith("· loihi1") for label in labels[3:])


def test_faults_are_of_chips_and_disturbances_of_all(design, results):
    policies = {tested.label for tested in design.policies}
    spiking = {tested.label for tested in design.policies if tested.chip}
    by_name = {
        name: {row["policy"] for row in rows(results) if row["name"] == name}
        for name in (*PARTS[1:], None)
    }
    assert by_name[None] == by_name["lidar-noise"] == policies
    assert by_name["dead-neurons"] == by_name["lost-spikes"] == spiking


def test_a_row_is_what_compare_says_of_the_same_episodes(results, design):
    options = {"disturb": ["lidar-noise:2"], "max_steps": 15}
    seeds = range(EVALUATION, EVALUATION + 3)
    entry = next(Entry(tested.candidate, tested.chip) for tested in design.policies if tested.chip)
    compared = compare_policies(ENV, [entry], seeds, 1, options)
    (row,) = (
        row
        for row in rows(results)
        if (row["name"], row["level"], row["policy"]) == ("lidar-noise", 2, entry.label)
    )
    np.testing.assert_allclose(row["returns"], compared.rows[0].returns, rtol=1e-6)


@pytest.mark.parametrize("name", ["dead-neurons", "lost-spikes"])
def test_a_faulty_row_is_what_compare_says_of_the_same_chip(results, design, name):
    tested = next(tested for tested in design.policies if tested.chip)
    (row,) = (
        row
        for row in rows(results)
        if (row["name"], row["level"], row["policy"]) == (name, 3, tested.label)
    )
    for specimen, places in enumerate([(0, 2), (1,)]):
        broken = replace(tested.candidate, faults=faults([f"{name}:3"], specimen))
        seeds = [EVALUATION + place for place in places]
        entry = Entry(broken, tested.chip)
        compared = compare_policies(ENV, [entry], seeds, 1, {"max_steps": 15})
        got = [row["returns"][place] for place in places]
        np.testing.assert_allclose(got, compared.rows[0].returns, rtol=1e-6)


def test_what_is_done_is_not_done_again_and_what_has_changed_is(design, results, ran):
    before = len(ran)
    run_experiment(design, PARTS, 1, results)
    assert len(ran) == before
    design.rows("lidar-noise")[1].file.unlink()
    run_experiment(design, PARTS, 1, results)
    assert ran[before:] == ["lidar-noise"]
    for changed, name, is_done in (
        ({"episodes": 4}, "lidar-noise", False),
        ({"chip": "loihi2"}, "dead-neurons", False),
        ({"specimens": 3}, "lidar-noise", True),
        ({"specimens": 3}, "dead-neurons", False),
    ):
        parts = {part.name: part for part in replace(design, **changed).parts()}
        assert parts[name].is_done == is_done


def row_of(policy, kind, name, kept, part="disturbance"):
    return {
        "policy": policy, "kind": kind, "part": part, "name": name, "level": 2, "kept": kept,
        "kept_low": kept - 0.1, "kept_high": kept + 0.1,
    }  # fmt: skip


def test_the_page_says_where_the_ann_keeps_enough_and_the_spiking_policy_does_not():
    found = page.sentences(
        [
            row_of("ann", "ann", "noise", 0.95),
            row_of("snn", "snn", "noise", 0.5),
            row_of("ann", "ann", "delay", 0.6),
            row_of("snn", "snn", "delay", 0.4),
            row_of("snn", "snn", "lost-spikes", 0.91, "fault"),
        ]
    )
    assert "under 0 of 2 disturbances at level 2; less under noise 50% [40, 60], delay" in found[0]
    assert "under 1 of 1 faults at level 2." in found[1]
    assert "Where ann keeps 90%" in found[2]
    assert found[2].endswith("noise (50% [40, 60] against 95% [85, 105]).")


def test_a_policy_that_earns_nothing_keeps_no_share():
    nothing = {"policy": "p", "part": UNDISTURBED, "returns": [0.0, 0.0], "groups": [0, 1]}
    rows = page.with_kept([nothing, nothing | {"part": "disturbance"}])
    assert all("kept" not in row for row in rows)
    assert page.kept_text(rows[1]) == "–"


@pytest.mark.parametrize(("env", "kind"), [("tests.own_env:Reach", "losing"), ("CartPole-v1", "")])
def test_policies_of_other_environments_are_disturbed_and_broken_too(
    env, kind, ran, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    small = [
        "steps=64", "env.count=2", "horizon=16", "epochs=1", "minibatch=16", "critic_hidden=[8]",
        "policy.hidden=[8,8]", "policy.timesteps=2", "policy.populations=2", "validation.every=64",
        "validation.episodes=1",
    ]  # fmt: skip
    train("ppo-snn", env=env, overrides=small, quiet=True)
    design = RobustnessDesign.of({"env": env, "policies": ["last"], "quick": True, "episodes": 2})
    parts = ("undisturbed", "noise", "command-delay", "lost-spikes")
    outcome = run_experiment(design, parts, 1, tmp_path / "results")
    assert (outcome.done, outcome.failed) == (4, {})
    text = (tmp_path / "results/robustness.md").read_text(encoding="utf-8")
    assert f"## {env}" in text
    assert "--policies runs/" in text
    assert ("cells are mean returns" in text) == bool(kind)
    rows = read_table(tmp_path / "results/robustness" / f"{file_name(env)}.csv")
    assert {row["name"] for row in rows} == {None, *parts[1:]}
    assert {row["success_rate"] for row in rows} <= ({None} if kind else {0.0, 0.5, 1.0})
