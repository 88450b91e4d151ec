"""`runs`, and the beginnings of names by which every command knows a run."""

import json
import os

import pytest

from spikedeploy.commands.training import SortKey
from spikedeploy.reports.runs import SORTS
from spikedeploy.shipping.exported_run import runnable, trained_in
from spikedeploy.trainers.config import MlpConfig, PopsanConfig
from spikedeploy.trainers.run_folder import RunFolder, find_run
from tests import toy_stroll_env


@pytest.fixture
def two(stroll):
    """Two runs below runs/: `walk-a`, older and worse, and `walk-b`."""
    for name, earned, policy in (
        ("walk-a", 1.5, MlpConfig(hidden=(4,))),
        ("walk-b", 7.5, PopsanConfig(hidden=(6,), populations=3)),
    ):
        made = toy_stroll_env.run_folder(stroll / "made", policy)
        run = made.rename(stroll / "made" / name)
        file = run / "checkpoints/best.json"
        numbers = {"eval_return": earned, "eval_finish": 0.5, "eval_operations": 12.0}
        file.write_text(json.dumps({**json.loads(file.read_text()), **numbers}))
        for path in (run / "config.json", run / "metrics.csv", file):
            os.utime(path, (1e9 + earned, 1e9 + earned))
    (stroll / "made").rename(stroll / "runs")
    return stroll / "runs"


def test_runs_are_listed_with_their_scores_the_newest_first(two, command):
    code, out, _ = command("runs", "--json")
    rows = json.loads(out)
    assert (code, [row["name"] for row in rows]) == (0, ["walk-b", "walk-a"])
    assert [(row["earned"], row["success"], row["operations"]) for row in rows] == [
        (7.5, 0.5, 12.0),
        (1.5, 0.5, 12.0),
    ]
    assert [row["share"] for row in rows] == [0.0, 0.0]  # there is no checkpoint last
    _, out, _ = command("runs")
    assert "12 SOPs" in out
    assert "12 MACs" in out


@pytest.mark.parametrize(("sort", "first"), [("return", "walk-b"), ("name", "walk-a")])
def test_runs_are_sorted_by_a_column(two, command, sort, first):
    _, out, _ = command("runs", "--sort", sort, "--json")
    assert json.loads(out)[0]["name"] == first


def test_every_column_that_sorts_is_one_that_the_command_takes():
    assert set(SortKey.__args__) == set(SORTS)


@pytest.mark.parametrize("name", ["eval_return", "eval_finish"])
def test_a_run_whose_scores_are_no_numbers_is_left_out_and_said(name, two, command):
    for record in (two / "walk-a/checkpoints").glob("*.json"):
        record.write_text(json.dumps({**json.loads(record.read_text()), name: "high"}))
    code, out, err = command("runs", "--json")
    assert (code, [row["name"] for row in json.loads(out)]) == (0, ["walk-b"])
    assert "is damaged (ValueError" in " ".join(err.split())


def test_links_to_folders_are_not_followed(two, command):
    (two / "again").symlink_to(two)
    assert len(json.loads(command("runs", "--json")[1])) == 2


def test_a_folder_without_runs_says_how_to_make_one(stroll, command):
    code, out, _ = command("runs")
    assert (code, "spikedeploy train" in out) == (0, True)


def test_a_name_means_the_run_of_this_folder_or_of_runs(two):
    assert find_run("walk-a") == find_run("runs/walk-a")
    assert RunFolder.find("walk-a").path.name == "walk-a"
    assert runnable("walk-a").endswith("walk-a.onnx")
    assert trained_in("walk-a") == "stroll"
    assert find_run("walk") is find_run("") is None
