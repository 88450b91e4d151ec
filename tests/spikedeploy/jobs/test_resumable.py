"""Processes of an experiment: each does its job, and all of them end when it does."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest

from spikedeploy.jobs import resumable
from spikedeploy.jobs.resumable import INTERRUPTED, Job, run
from tests.paths import ROOT
from tests.waiting import wait_until


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    monkeypatch.chdir(ROOT)  # where the processes find tests.job_functions
    monkeypatch.setattr(resumable, "_PAUSE", 0.05)


def job(name, errand, folder):
    arguments = {"path": str(folder / name)}
    return Job(name, f"tests.job_functions:{errand}", folder / "logs" / f"{name}.log", arguments)


def when(condition, then):
    """Do something as soon as the condition holds, from another thread."""

    def watch():
        wait_until(condition)
        then()

    threading.Thread(target=watch, daemon=True).start()


def test_every_job_is_done_in_a_process_of_its_own(tmp_path):
    ends = []
    assert run([job(name, "write", tmp_path) for name in "abc"], 2, ends.append)
    assert sorted(end.job.name for end in ends) == ["a", "b", "c"]
    assert {end.status for end in ends} == {0}
    assert {(tmp_path / name).read_text() for name in "abc"} == {"done"}


def test_a_job_waits_for_those_that_it_needs_and_lets_others_go_first(tmp_path):
    ends = []
    needy = replace(job("a", "write", tmp_path), after=("b", "long done"))
    jobs = [needy, job("b", "write", tmp_path), job("c", "write", tmp_path)]
    assert run(jobs, 1, ends.append)
    assert [end.job.name for end in ends] == ["b", "a", "c"]


def test_a_killed_job_does_not_quote_an_earlier_attempt(tmp_path):
    bad, ends = job("bad", "die", tmp_path), []
    bad.log.parent.mkdir(parents=True, exist_ok=True)
    bad.log.write_text("error: an old reason\n")
    assert run([bad], 1, ends.append)
    assert ends[0].last_line == "no output, killed by signal 9"
    assert bad.log.read_text() == "error: an old reason\n"  # the log keeps all attempts


@pytest.mark.parametrize(
    ("errand", "words"),
    [("fail", "error: the shop was closed"), ("crash", "KeyError"), ("die", "no output")],
)
def test_a_job_that_fails_says_why_and_leaves_the_others_alone(errand, words, tmp_path):
    ends = {}
    jobs = [job("bad", errand, tmp_path), job("good", "write", tmp_path)]
    assert run(jobs, 1, lambda end: ends.update({end.job.name: end}))
    assert ends["bad"].failed
    assert words in ends["bad"].last_line
    assert ends["good"].status == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_experiment_lets_its_jobs_reach_a_safe_end(number, tmp_path):
    ends = []
    when((tmp_path / "a").exists, lambda: os.kill(os.getpid(), number))
    jobs = [job("a", "wait", tmp_path), job("b", "write", tmp_path)]
    assert not run(jobs, 1, ends.append)
    assert (tmp_path / "a").read_text() == "checkpoint"
    assert [(end.job.name, end.status, end.failed) for end in ends] == [("a", INTERRUPTED, False)]
    assert not (tmp_path / "b").exists()  # what waited was not begun


def test_a_second_interruption_does_not_wait(tmp_path):
    def twice():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGINT)

    when((tmp_path / "a").exists, twice)
    with pytest.raises(KeyboardInterrupt):
        run([job("a", "linger", tmp_path)], 1, lambda end: None)
    assert (tmp_path / "a").read_text() == "begun"


def test_jobs_end_even_when_the_experiment_is_killed(tmp_path):
    code = f"""
from pathlib import Path
from tests.spikedeploy.jobs.test_resumable import job
from spikedeploy.jobs.resumable import run
run([job("a", "wait", Path({str(tmp_path)!r}))], 1, print)
"""
    parent = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    wait_until((tmp_path / "a").exists)
    parent.kill()
    parent.wait()
    wait_until(lambda: (tmp_path / "a").read_text() == "checkpoint")
