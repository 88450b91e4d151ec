"""Paired comparison: who is measured against whom, and what the numbers mean."""

import numpy as np
import pytest

from spikedeploy import envs, zoo
from spikedeploy.comparison.episodes import (
    Agreement,
    first_divergence,
    median_divergence,
    pooled_rmse,
)
from spikedeploy.comparison.evaluation import compare_policies, line_up
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.registry import Entry, find, open_policy
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from tests import toy_stroll_env

SEEDS = range(10_000, 10_003)


@pytest.fixture
def stroll(monkeypatch, tmp_path):
    folder = toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    for name in ("linear", "phase", "zigzag"):
        toy_stroll_env.ann(folder / f"{name}.onnx", hidden=(), kind="control", seed=len(name))
    return folder


def labels(entries):
    return [entry.label for entry in entries]


def by_label(comparison):
    rows = comparison.as_json()
    return {row.entry.label: found for row, found in zip(comparison.rows, rows, strict=True)}


def test_the_line_up_of_what_is_shipped_ends_with_the_controls_by_what_they_see(stroll):
    for name in ("mlp-8", "fourier", "small", "pruned", "mlp-16"):
        toy_stroll_env.ann(stroll / f"{name}.onnx", hidden=(), kind="control", seed=len(name))
    entries = line_up("stroll", (), ("loihi1", "ideal"))
    assert labels(entries) == [
        "sac", "popsan · float", "popsan · loihi1", "popsan · ideal", "gait", "phase", "fourier",
        "linear", "mlp-8", "mlp-16", "pruned", "small", "zigzag",
    ]  # fmt: skip


def test_a_chip_is_measured_against_its_float_twin_and_all_else_against_the_float_ann(stroll):
    references = {e.label: e.reference for e in line_up("stroll", (), ("loihi1",))}
    assert references["sac"] is None
    assert references["popsan · loihi1"].label == "popsan · float"
    others = {"popsan · float", "gait", "phase", "linear", "zigzag"}
    assert {references[name].label for name in others} == {"sac"}


def test_a_file_alone_still_meets_the_shipped_ann_and_controls(stroll, tmp_path):
    file = toy_stroll_env.snn(tmp_path / "mine.nir", seed=1)
    found = labels(line_up("stroll", [str(file)], ("loihi1",)))
    assert found == ["sac", "mine · float", "mine · loihi1", "gait", "phase", "linear", "zigzag"]


def test_files_of_the_same_name_are_told_apart_by_their_folders(stroll, tmp_path):
    files = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        files.append(str(toy_stroll_env.ann(tmp_path / folder / "sac.onnx")))
    assert labels(line_up("stroll", files, ()))[:2] == ["a/sac", "b/sac"]


def test_without_shipped_policies_a_line_says_what_to_do(stroll, monkeypatch, tmp_path):
    monkeypatch.setattr(zoo, "FOLDER", tmp_path / "nothing")
    with pytest.raises(ConfigError, match="no policies are shipped for stroll yet"):
        line_up("stroll", (), ("loihi1",))


def test_rows_hold_what_the_robot_did(stroll):
    rows = by_label(compare_policies("stroll", line_up("stroll", (), ()), SEEDS, processes=1))
    assert {(row["episodes"], len(row["returns"])) for row in rows.values()} == {(3, 3)}
    gait = rows["gait"]
    assert gait["return_mean"] == pytest.approx(np.mean(gait["returns"]))
    assert gait["speed"] == 0.25
    assert gait["cot"] == pytest.approx(2.0 / 20)  # of the last step
    assert gait["heading_error"] == 0.5
    assert gait["falls"] == 0
    assert gait["macs_dense"] == 0
    assert rows["sac"]["ratio_to_float_ann"] == 1
    expected = rows["gait"]["return_mean"] / rows["sac"]["return_mean"]
    assert rows["gait"]["ratio_to_float_ann"] == pytest.approx(expected)


def test_the_ideal_chip_agrees_with_the_float_twin_in_every_action(stroll):
    entries = line_up("stroll", (), ("ideal", "loihi1:clock=gated"))
    rows = by_label(compare_policies("stroll", entries, SEEDS, processes=1))
    ideal, loihi = rows["popsan · ideal"], rows["popsan · loihi1:clock=gated"]
    assert (ideal["clock"], loihi["clock"]) == ("gated", "gated, assumed")
    assert ideal["action_rmse"] < 1e-9
    assert ideal["first_divergence"] is None
    assert ideal["difference_mean"] == pytest.approx(0, abs=1e-9)
    assert ideal["rmse_to_ann"] == pytest.approx(rows["popsan · float"]["action_rmse"])
    assert loihi["action_rmse"] > 1e-4
    assert loihi["sparsity"] == pytest.approx(ideal["sparsity"], abs=0.05)


def test_action_rmse_asks_both_policies_on_what_the_reference_saw(stroll):
    ann, gait = Entry(find(str(stroll / "sac.onnx"))), find("gait")
    row = compare_policies("stroll", [ann, Entry(gait, None, ann)], SEEDS, processes=1).as_json()[1]
    world = envs.make("stroll")
    player = open_policy(ann.candidate, None, world)
    actions = np.concatenate([rollout(world, player, seed).action for seed in SEEDS])
    # the gait puts out zeros, so the difference is the reference's own action
    assert row["action_rmse"] == pytest.approx(np.sqrt(np.square(actions).mean()))


def test_what_cannot_be_compared_is_refused_before_anything_is_played(stroll):
    gait, sac = Entry(find("gait")), Entry(find(str(stroll / "sac.onnx")))
    for env, entries, seeds, said in (
        ("stroll", [gait], range(9_999, 10_001), "seed 9999 may have been trained on"),
        ("stroll", line_up("stroll", (), ("loihi9",)), SEEDS, r"did you mean .*'loihi1'"),
        ("hexapod", [sac], SEEDS, r"made for test/Stroll-v0, not for .*Hexapod-v0"),
    ):
        with pytest.raises(SpikedeployError, match=said):
            compare_policies(env, entries, seeds, processes=1)


def test_processes_find_what_one_process_finds(tmp_path):
    entry = Entry(find("random"))
    seeds = range(10_000, 10_002)
    alone, together = (
        compare_policies("kart-grid", [entry], seeds, count).as_json() for count in (1, 2)
    )
    assert alone == together


@pytest.mark.parametrize(("left", "right", "found"), [
    (np.zeros((5, 2)), np.zeros((5, 2)), None),
    (np.zeros((5, 2)), [[0, 0], [0, 0], [0.009, 0], [0, 0.5], [0, 0]], 3),
    (np.zeros((5, 2)), np.zeros((4, 2)), 4),  # one of them fell
    ([1, 2, 3], [1, 2, 0], 2),
    ([1, 2], [1, 2, 0], 2),
    ([1, 2], [1, 2], None),
])  # fmt: skip
def test_actions_diverge_where_they_first_differ_by_more_than_a_hundredth(left, right, found):
    assert first_divergence(np.array(left), np.array(right)) == found


def test_a_median_divergence_of_never_is_none_and_rmse_is_pooled_over_actions():
    never, late = Agreement(0.0, 1, None), Agreement(0.0, 1, 40)
    assert median_divergence([late, late, never]) == 40
    assert median_divergence([late, never, never]) is None
    short, long = Agreement(squared_error=8.0, actions=2, first_divergence=0), Agreement(0.0, 6, 0)
    assert pooled_rmse([short, long]) == pytest.approx(1.0)  # not averaged over episodes
