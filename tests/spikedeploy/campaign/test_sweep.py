"""A sweep in its smallest size: run, stopped, damaged, failed, and run again."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace

import pytest

from spikedeploy.campaign import sweep_page
from spikedeploy.campaign.sweep import (
    SweepFolder,
    SweepJob,
    evaluate_job,
    load_sweep,
    run_sweep,
)
from spikedeploy.campaign.sweep_grid import expand, read_grid
from spikedeploy.campaign.sweep_page import JobRow, cells, print_sweep
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.comparison.lineup import Entry
from spikedeploy.jobs.pool import ProcessBackend, SerialBackend
from spikedeploy.policies.registry import find
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.errors import ConfigError
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
    outcome = run_sweep(grid, folder, SerialBackend())
    assert (outcome.ran, outcome.interrupted) == (JOBS, False)
    return folder


def results(folder):
    """Name -> content of each file of a job."""
    return {file.name: file.read_text() for file in (folder / "jobs").iterdir()}


def journal(folder):
    return list(csv.DictReader((folder / "journal.csv").read_text().splitlines()))


def test_processes_find_what_one_finds_bit_for_bit(grid, serial, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    outcome = run_sweep(grid, tmp_path, ProcessBackend(2))
    assert outcome.summary == f"{JOBS} of {JOBS} jobs are done, 0 failed"
    assert results(tmp_path) == results(serial)
    assert len({line["worker"] for line in journal(tmp_path)}) == 2


def test_a_job_earns_what_compare_finds(grid, serial):
    compared = compare_policies(ENV, [Entry(find("random"))], range(10_000, 10_002), processes=1)
    job = next(job for job in expand(grid).jobs if job.policy == "random" and not job.disturb)
    row = SweepFolder(serial).read(job)[0]
    expected = json.loads(json.dumps(compared.as_json()[0]))
    assert {name: row[name] for name in expected} == expected


def test_what_is_done_is_not_run_again(grid, serial):
    before = results(serial)
    assert run_sweep(grid, serial, SerialBackend()).ran == 0
    assert results(serial) == before
    assert len(journal(serial)) == JOBS


@pytest.mark.parametrize("damage", ["", "{}", "[]", "\0", "cut", "edited", "other"])
def test_a_damaged_result_is_noticed_and_made_again(damage, grid, serial, capsys):
    files = sorted((serial / "jobs").iterdir())
    whole, other = (file.read_text() for file in files[:2])
    texts = {"cut": whole[:-20], "edited": whole.replace("return_mean", "mean"), "other": other}
    files[0].write_text(texts.get(damage, damage))
    assert run_sweep(grid, serial, SerialBackend()).ran == 1
    assert f"{files[0]} is damaged" in capsys.readouterr().err.replace("\n", "")
    assert files[0].read_text() == whole


def test_another_option_or_policy_is_another_job(grid):
    keys = {job.key for job in expand(grid).jobs}
    for change in ({"options": {"steps": 5}}, {"metrics": ("valves:last",)}, {"episodes": 1}):
        assert not keys & {job.key for job in expand(replace(grid, **change)).jobs}
    job = expand(grid).jobs[0]
    assert replace(job, sha256="0").key != job.key
    assert replace(job, versions={**job.versions, "numpy": "1"}).key != job.key


def test_a_worker_refuses_other_versions_and_damaged_policies(grid):
    plan = expand(grid)
    job = replace(plan.jobs[0], versions={"numpy": "1.0"})
    with pytest.raises(ConfigError, match=r"this worker has numpy .*begun with 1\.0"):
        evaluate_job(SweepJob(job, plan.policies[job.sha256]))
    with pytest.raises(ConfigError, match="arrived damaged"):
        evaluate_job(SweepJob(plan.jobs[0], b"no network"))


def test_failures_are_kept_with_their_reason_and_retried_on_request(grid, tmp_path):
    wrong = replace(grid, policy=("random",), metrics=("no_such:mean",), disturb=((),))
    first = run_sweep(wrong, tmp_path, SerialBackend())
    assert len(first.failed) == first.ran == 2
    assert all("no_such" in why and "\n" not in why for _, why in first.failures)
    assert run_sweep(wrong, tmp_path, SerialBackend()).ran == 0
    assert run_sweep(wrong, tmp_path, SerialBackend(), retry=True).ran == 2
    assert {line["status"] for line in journal(tmp_path)} == {"failed"}
    page = (tmp_path / "sweep.md").read_text()
    assert "## Failed" in page
    assert "no_such" in page


def test_ctrl_c_keeps_what_is_done(grid, tmp_path, serial):
    backend = SerialBackend()
    inner = backend.run

    def stopped(function, jobs):
        for result in inner(function, jobs):
            yield result
            if result.index == 4:
                raise KeyboardInterrupt

    backend.run = stopped
    outcome = run_sweep(grid, tmp_path, backend)
    assert (outcome.interrupted, outcome.ran) == (True, 5)
    assert (
        f"5 of {JOBS} jobs are done, 0 failed, {JOBS - 5} are missing"
        in (tmp_path / "sweep.md").read_text()
    )
    assert run_sweep(grid, tmp_path, SerialBackend()).ran == JOBS - 5
    assert results(tmp_path) == results(serial)


def test_a_driver_that_is_killed_loses_nothing_and_repeats_what_was_in_flight(
    spec, grid, serial, tmp_path
):
    command = [sys.executable, "-m", "spikedeploy", "sweep", str(spec), "-o", str(tmp_path)]
    environ = {**os.environ, "PYTHONPATH": str(ROOT)}
    driver = subprocess.Popen([*command, "--workers", "1"], cwd=ROOT, env=environ)
    wait_until(lambda: len(list((tmp_path / "jobs").glob("*.json"))) >= 3)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    there = results(tmp_path)
    assert len([name for name in there if name.endswith(".json")]) < JOBS
    outcome = run_sweep(grid, tmp_path, SerialBackend())
    assert outcome.ran == JOBS - len([name for name in there if not name.startswith(".")])
    found = {name: text for name, text in results(tmp_path).items() if not name.startswith(".")}
    assert found == results(serial)
    keys = [line["key"] for line in journal(tmp_path)]
    assert len(keys) == len(set(keys))


def test_two_sweeps_do_not_run_in_one_folder(grid, tmp_path):
    with SweepFolder(tmp_path).locked(), pytest.raises(ConfigError, match="another sweep"):
        run_sweep(grid, tmp_path, SerialBackend())
    assert load_sweep(grid, tmp_path).ran == 0


def test_cells_pool_the_seeds_and_differ_from_the_undisturbed_seed_by_seed(grid, serial):
    jobs = expand(grid).jobs
    rows = [JobRow(job, SweepFolder(serial).read(job)[0]) for job in jobs]
    found = cells(rows)
    assert len(found) == JOBS // 2
    calm, noisy = (row for row in found if row["policy"] == "random")
    assert (calm["episodes"], calm["jobs"], calm["difference_mean"]) == (4, 2, None)
    assert noisy["difference_mean"] == pytest.approx(noisy["return_mean"] - calm["return_mean"])
    on_chip = [each for each in rows if each.of.cell == rows[0].of.cell]
    steps = [sum(each.row["steps"]) for each in on_chip]
    sops = [each.row["sops_per_inference"] for each in on_chip]
    mean = sum(n * s for n, s in zip(steps, sops, strict=True)) / sum(steps)
    assert found[0]["sops_per_inference"] == pytest.approx(mean)
    assert cells(rows[:-1])[-1]["difference_mean"] is None  # not all of its seeds are there yet


def test_the_command_runs_shows_and_goes_on(spec, serial, command):
    code, out, err = command("sweep", spec, "-o", serial, "--backend", "serial")
    assert code == 0, err
    assert "small · loihi1:weight_bits=4 · noise:2 · dead-neurons:2" in out
    code, out, _ = command("sweep", spec, "-o", serial, "--no-run", "--json")
    assert (code, json.loads(out)["done"]) == (0, JOBS)
    code, _, err = command("sweep", spec, "-o", serial, "--address", "auto")
    assert code == 2
    assert "--backend ray" in err


def test_cells_of_few_episodes_claim_no_interval_and_say_why(grid, serial, capsys):
    sweep = load_sweep(grid, serial)
    print_sweep(sweep)
    out, page = " ".join(capsys.readouterr().out.split()), (serial / "sweep.md").read_text()
    for text in (out, page):
        assert "Cells of fewer than 5 episodes have no interval" in text
    assert "95%" not in page
    assert not re.search(r"\d \[", page)
    many = [{**row, "episodes": 5} for row in cells(sweep.found)]
    meanings = {each.title: each.meaning for each in sweep_page._measured_columns(many)}
    assert meanings["return"] == "mean of all episodes, with its 95% bootstrap interval"
    assert sweep_page._on_few_episodes(many) == ""


def test_the_back_ends_of_the_command_are_those_that_exist():
    from typing import get_args

    from spikedeploy.commands.training import JobBackend
    from spikedeploy.jobs import BACKENDS

    assert get_args(JobBackend) == BACKENDS


@pytest.mark.parametrize("name", ["sweep.md", "journal.csv"])
def test_a_folder_of_something_else_is_left_alone(name, spec, tmp_path, command):
    (tmp_path / name).write_text("mine\n")
    code, _, err = command("sweep", spec, "-o", tmp_path, "--backend", "serial")
    assert (code, (tmp_path / name).read_text()) == (2, "mine\n")
    assert "--force" in err


def test_a_page_without_results_is_a_sweep_that_goes_on(spec, tmp_path, command):
    for _ in range(2):
        assert command("sweep", spec, "-o", tmp_path, "--no-run")[0] == 0
