"""Pools: one result for every job, whatever happens to workers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from spikedeploy.jobs.pool import (
    WORKER_ENVIRONMENT,
    ProcessBackend,
    SerialBackend,
    local_backend,
)
from spikedeploy.runtime.errors import ChipError, SpikedeployError
from tests.paths import ROOT
from tests.waiting import PATIENCE, wait_until

BACKENDS = [SerialBackend, lambda: ProcessBackend(2)]


class UnpicklableError(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def square(number):
    if number == 3:
        raise ChipError("three is no chip")
    if number == 4:
        raise UnpicklableError("this", "that")
    return number * number


def die_once(path):
    """Die at the first attempt; a file tells the second that it is one."""
    if not Path(path).exists():
        Path(path).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def die(path):
    with Path(path).open("a") as file:
        file.write("x")
    os.kill(os.getpid(), signal.SIGKILL)


def linger(path):
    Path(path).write_text(str(os.getpid()))
    time.sleep(PATIENCE)
    Path(path).write_text("done")


def errand(job):
    name, path = job
    return {"die": die, "die once": die_once, "linger": linger, "work": str}[name](path)


def lambda_back(number):
    return lambda: number


def results(backend, function, jobs):
    with backend as running:
        found = list(running.run(function, jobs))
    assert sorted(result.index for result in found) == list(range(len(jobs)))
    return sorted(found, key=lambda result: result.index)


@pytest.mark.parametrize("made", BACKENDS)
def test_every_job_has_one_answer_and_an_error_is_one_too(made):
    found = results(made(), square, range(6))
    assert [result.value for result in found] == [0, 1, 4, None, None, 25]
    assert isinstance(found[3].error, ChipError)
    assert "three is no chip" in found[3].trace
    with pytest.raises(Exception, match="this and that"):
        found[4].result()


def test_a_job_whose_worker_is_killed_is_run_again_and_the_others_are_not(tmp_path):
    jobs = [("work", "a"), ("die once", tmp_path / "once"), ("work", "b"), ("work", "c")]
    found = results(ProcessBackend(2), errand, jobs)
    assert [result.error for result in found] == [None] * 4
    assert [result.value for result in found if result.index != 1] == ["a", "b", "c"]


def test_a_job_that_kills_its_worker_twice_fails_and_the_others_are_done(tmp_path):
    jobs = [("die", tmp_path / "tries"), *(("work", str(number)) for number in range(5))]
    found = results(ProcessBackend(2), errand, jobs)
    assert isinstance(found[0].error, SpikedeployError)
    assert "killed" in str(found[0].error)
    assert (tmp_path / "tries").read_text() == "xx"
    assert [result.value for result in found[1:]] == list("01234")


def test_what_cannot_be_sent_back_is_an_error_and_kills_no_worker():
    found = results(ProcessBackend(1), lambda_back, [1, 2])
    assert all("pickle" in str(result.error).lower() for result in found)


def test_processes_that_cannot_start_are_a_sentence_and_not_an_endless_row(tmp_path):
    script = tmp_path / "unguarded.py"
    script.write_text("""
from tests.spikedeploy.jobs.test_pool import square
from spikedeploy.jobs.pool import ProcessBackend
with ProcessBackend(1) as backend:
    print(len(list(backend.run(square, range(100)))))
""")
    done = subprocess.run(
        [sys.executable, str(script)], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "SpikedeployError: worker processes end before their first job" in done.stderr
    assert done.stderr.count("An attempt has been made to start a new process") <= 3


def has_ended(stat):
    try:
        return ") Z " in stat.read_text()
    except OSError:
        return True


def test_a_worker_dies_with_its_parent_in_the_middle_of_a_job(tmp_path):
    code = f"""
from tests.spikedeploy.jobs.test_pool import linger
from spikedeploy.jobs.pool import ProcessBackend
if __name__ == "__main__":
    with ProcessBackend(1) as backend:
        list(backend.run(linger, [{str(tmp_path / "pid")!r}]))
"""
    script = tmp_path / "driver.py"
    script.write_text(code)
    parent = subprocess.Popen(
        [sys.executable, str(script)], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    wait_until(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
    parent.kill()
    parent.wait()
    worker = Path("/proc") / (tmp_path / "pid").read_text() / "stat"
    wait_until(lambda: has_ended(worker))


def variable(name):
    return os.environ.get(name)


@pytest.mark.parametrize("count", [1, 2])
def test_results_come_in_the_order_of_the_jobs(count):
    done = []
    with local_backend(count) as jobs:
        assert jobs.in_order(abs, range(-4, 1), lambda: done.append(1)) == [4, 3, 2, 1, 0]
    assert len(done) == 5


def test_workers_have_one_thread_and_leave_this_process_alone():
    before = dict(os.environ)
    with local_backend(2) as jobs:
        found = jobs.in_order(variable, list(WORKER_ENVIRONMENT), lambda: None)
    assert found == list(WORKER_ENVIRONMENT.values())
    assert dict(os.environ) == before


def test_ctrl_c_ends_at_once_and_does_not_wait_for_jobs(tmp_path):
    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), local_backend(2) as jobs:
        jobs.in_order(errand, [("work", ""), *(("linger", tmp_path / n) for n in "ab")], interrupt)
    assert "done" not in [path.read_text() for path in tmp_path.iterdir()]
