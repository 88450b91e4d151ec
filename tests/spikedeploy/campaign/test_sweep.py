"""A sweep in its smallest size: run, stopped, damaged, failed, and run again."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace

import pytest

from spikedeploy import jobs
from spikedeploy.campaign import sweep_page
from spikedeploy.campaign.sweep import RESULTS, load_sweep, run_sweep
from spikedeploy.campaign.sweep_grid import expand, read_grid
from spikedeploy.campaign.sweep_page import cells, print_sweep
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.registry import Entry, find
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import locked
from spikedeploy.runtime.metadata import Provenance
from tests.networks import popsan
from tests.paths import ROOT
from tests.waiting import wait_until

ENV = "tests.own_env:Reach"
SPEC = """
env = "tests.own_env:Reach"
policy = ["{folder}/small.nir", "random"]
chip = ["loihi1", "float"]
bits = ["own", 4]
disturb = ["none", "noise:2"]
fault = ["none", "dead-neurons:2"]
seed = "10000-10003"
episodes = 2
"""
# cells: on chip 2 bits x 2 disturb x 2 fault, in float 2 disturb, random 2 disturb; 2 seeds each
JOBS = (8 + 2 + 2) * 2


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    """A file with a sweep of a small policy."""
    folder = tmp_path_factory.mktemp("spec")
    artifact = popsan(obs=4, act=2, hidden=(6, 5), seed=1)
    save(replace(artifact, provenance=Provenance(ENV, "none")), folder / "small.nir")
    (folder / "small.toml").write_text(SPEC.format(folder=folder))
    return folder / "small.toml"


@pytest.fixture(scope="module")
def grid(spec):
    return read_grid(spec)


@pytest.fixture(scope="module")
def serial(grid, tmp_path_factory):
    """The sweep, run in this process."""
    folder = tmp_path_factory.mktemp("serial")
    outcome = run_sweep(grid, folder)
    assert (outcome.ran, outcome.interrupted) == (JOBS, False)
    return folder


def results(folder):
    """Key -> job, row and failure of each line, each key once."""
    lines = [json.loads(line) for line in (folder / RESULTS).read_text().splitlines()]
    found = {each["key"]: (each["job"], each["row"], each["failed"]) for each in lines}
    assert len(found) == len(lines)
    return found


def test_a_job_earns_what_compare_finds(grid, serial):
    compared = compare_policies(ENV, [Entry(find("random"))], range(10_000, 10_002), processes=1)
    key = next(job.key for job in expand(grid) if job.label == f"{ENV} · random · seed 10000")
    row = results(serial)[key][1]
    expected = json.loads(json.dumps(compared.as_json()[0]))
    assert {name: row[name] for name in expected} == expected


@pytest.mark.parametrize("damage", ["none", "\0", "cut", "other", "[]"])
def test_what_is_done_is_not_run_again_and_what_is_damaged_is(
    damage, grid, serial, tmp_path, capsys
):
    first, second, *rest = (serial / RESULTS).read_text().splitlines(keepends=True)
    other = first.replace("10000", "10001", 1)
    damaged = {"none": first, "cut": first[:-20], "other": other}.get(damage, damage + "\n")
    whole = [second, *rest, damaged] if damage == "cut" else [damaged, second, *rest]
    (tmp_path / RESULTS).write_text("".join(whole))
    outcome = run_sweep(grid, tmp_path)
    assert outcome.ran == (damage != "none")
    assert outcome.rows == load_sweep(grid, serial).rows
    assert ("1 lines are damaged" in capsys.readouterr().err) == (damage != "none")
    assert run_sweep(grid, tmp_path).ran == 0


def test_another_option_or_policy_is_another_job(grid, monkeypatch):
    keys = {job.key for job in expand(grid)}
    for change in (
        {"setup": Setup(set_=("steps=5",))},
        {"setup": Setup(metric=("valves:last",))},
        {"episodes": 1},
    ):
        assert not keys & {job.key for job in expand(replace(grid, **change))}
    monkeypatch.setattr("spikedeploy.campaign.sweep_grid._sha256", lambda path: "0")
    assert len(keys & {job.key for job in expand(grid)}) == 4  # of random
    monkeypatch.setattr("spikedeploy.campaign.sweep_grid.versions_for", lambda env: {"numpy": "1"})
    assert not keys & {job.key for job in expand(grid)}


def test_failures_are_kept_with_their_reason_and_retried_on_request(grid, tmp_path):
    wrong = replace(grid, policy=("random",), setup=Setup(metric=("no_such:mean",)), disturb=((),))
    first = run_sweep(wrong, tmp_path)
    assert len(first.failed) == first.ran == 2
    assert all("no_such" in why and "\n" not in why for _, why in first.failures)
    assert run_sweep(wrong, tmp_path).ran == 0
    assert run_sweep(wrong, tmp_path, retry=True).ran == 2
    page = (tmp_path / "report.html").read_text()
    assert "<h2>Failed" in page
    assert "no_such" in page


def test_ctrl_c_keeps_what_is_done(grid, tmp_path, serial, monkeypatch):
    run = jobs.Serial.run

    def stopped(self, function, todo):
        for result in run(self, function, todo):
            yield result
            if result.index == 4:
                raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(jobs.Serial, "run", stopped)
        outcome = run_sweep(grid, tmp_path)
    assert (outcome.interrupted, outcome.ran) == (True, 5)
    said = f"5 of {JOBS} jobs are done, 0 failed, {JOBS - 5} are missing"
    assert said in (tmp_path / "report.html").read_text()
    assert run_sweep(grid, tmp_path).ran == JOBS - 5
    assert results(tmp_path) == results(serial)


def test_a_driver_that_is_killed_loses_nothing(spec, grid, serial, tmp_path):
    command = [sys.executable, "-m", "spikedeploy", "sweep", str(spec), "-o", str(tmp_path)]
    environ = {**os.environ, "PYTHONPATH": str(ROOT)}
    driver = subprocess.Popen([*command, "--workers", "1"], cwd=ROOT, env=environ)
    file = tmp_path / RESULTS
    wait_until(lambda: file.exists() and file.read_text().count("\n") >= 3)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    there = file.read_text().count("\n")
    assert 3 <= there < JOBS
    assert run_sweep(grid, tmp_path).ran == JOBS - there
    assert results(tmp_path) == results(serial)


def test_two_sweeps_do_not_run_in_one_folder(grid, tmp_path):
    with locked(tmp_path / ".lock"), pytest.raises(ConfigError, match="another sweep"):
        run_sweep(grid, tmp_path)
    assert load_sweep(grid, tmp_path).ran == 0


def test_cells_pool_the_seeds_and_differ_from_the_undisturbed_seed_by_seed(grid, serial):
    rows = load_sweep(grid, serial).found
    found = cells(rows)
    assert len(found) == JOBS // 2
    calm, noisy = (row for row in found if row["policy"] == "random")
    assert (calm["episodes"], calm["jobs"], calm["difference_mean"]) == (4, 2, None)
    assert noisy["difference_mean"] == pytest.approx(noisy["return_mean"] - calm["return_mean"])
    on_chip = [each for each in rows if each.job.cell == rows[0].job.cell]
    steps = [sum(each.row["steps"]) for each in on_chip]
    sops = [each.row["sops_per_inference"] for each in on_chip]
    mean = sum(n * s for n, s in zip(steps, sops, strict=True)) / sum(steps)
    assert found[0]["sops_per_inference"] == pytest.approx(mean)
    assert cells(rows[:-1])[-1]["difference_mean"] is None  # not all of its seeds are there yet


def test_the_command_runs_shows_and_goes_on(spec, serial, command):
    code, out, err = command("sweep", spec, "-o", serial, "--workers", 1)
    assert code == 0, err
    assert "small · loihi1:weight_bits=4 · noise:2 · dead-neurons:2" in out
    code, out, _ = command("sweep", spec, "-o", serial, "--no-run", "--json")
    assert (code, json.loads(out)["done"]) == (0, JOBS)


def test_cells_of_few_episodes_claim_no_interval_and_say_why(grid, serial, capsys):
    sweep = load_sweep(grid, serial)
    print_sweep(sweep)
    out, page = " ".join(capsys.readouterr().out.split()), (serial / "report.html").read_text()
    for text in (out, page):
        assert "Cells of fewer than 5 episodes have no interval" in text
    assert not re.search(r"\d \[", page)
    assert not sweep_page._remarks([{"episodes": 5}])


@pytest.mark.parametrize("name", ["report.html", RESULTS])
def test_a_folder_of_something_else_is_left_alone(name, spec, tmp_path, command):
    (tmp_path / name).write_text("mine\n")
    code, _, err = command("sweep", spec, "-o", tmp_path, "--workers", 1)
    assert (code, (tmp_path / name).read_text()) == (2, "mine\n")
    assert "--force" in err


def test_a_page_without_results_is_a_sweep_that_goes_on(spec, tmp_path, command):
    for _ in range(2):
        assert command("sweep", spec, "-o", tmp_path, "--no-run")[0] == 0
