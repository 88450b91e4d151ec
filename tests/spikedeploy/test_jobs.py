"""Jobs: one result for every job, whatever happens to processes."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from spikedeploy.jobs import WORKER_ENVIRONMENT, Pool, Serial, local_pool, output_to
from spikedeploy.runtime.errors import ChipError
from spikedeploy.trainers.progress import Interrupt
from tests.paths import ROOT
from tests.waiting import PATIENCE, wait_until


class UnpicklableError(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def die(path):
    with Path(path).open("a") as file:
        file.write("x")
    os.kill(os.getpid(), signal.SIGKILL)


def linger(path):
    Path(path).write_text(str(os.getpid()))
    time.sleep(PATIENCE)
    Path(path).write_text("done")


def train(path):
    """Work until asked to stop, then leave a checkpoint, as trainings do."""
    with Interrupt() as stopped, output_to(Path(f"{path}.log")):
        Path(path).write_text("begun")
        wait_until(stopped)
        Path(path).write_text("checkpoint")
        print("said on stdout")
    return "stopped"


def errand(job):
    name, argument = job
    errands = {"die": die, "linger": linger, "train": train, "work": str}
    return errands[name](argument)


def square(number):
    if number == 3:
        raise ChipError("three is no chip")
    if number == 4:
        raise UnpicklableError("this", "that")
    return (lambda: number) if number == 5 else number * number


def variable(name):
    return os.environ.get(name)


def results(pool, function, jobs):
    with pool:
        found = list(pool.run(function, jobs))
    assert sorted(result.index for result in found) == list(range(len(jobs)))
    return sorted(found, key=lambda result: result.index)


@pytest.mark.parametrize("pool", [Serial(), Pool(2)], ids=["here", "processes"])
def test_every_job_has_one_result_and_an_error_is_one_too(pool):
    found = results(pool, square, range(5))
    assert [result.value for result in found] == [0, 1, 4, None, None]
    assert isinstance(found[3].error, ChipError)
    assert "three is no chip" in found[3].trace
    with pytest.raises(Exception, match="this and that"):
        found[4].result()


def test_a_killed_worker_is_replaced_and_its_job_fails_alone(tmp_path):
    jobs = [("work", "a"), ("die", tmp_path / "tries"), ("work", "b")]
    found = results(Pool(2), errand, jobs)
    assert [result.value for result in found] == ["a", None, "b"]
    assert "killed" in str(found[1].error)
    assert (tmp_path / "tries").read_text() == "x"


def test_results_come_in_the_order_of_the_jobs_from_workers_of_one_thread():
    before, done = dict(os.environ), []
    with local_pool(2) as pool:
        found = pool.in_order(variable, list(WORKER_ENVIRONMENT), lambda: done.append(1))
        (unsent,) = pool.run(square, [5])
    assert found == list(WORKER_ENVIRONMENT.values())
    assert (len(done), dict(os.environ)) == (len(found), before)
    assert "pickle" in str(unsent.error).lower()
    assert isinstance(local_pool(1), Serial)


def run_script(folder, body):
    """Start a script that uses a pool."""
    script = folder / "driver.py"
    head = "from spikedeploy.jobs import Pool\nfrom tests.spikedeploy.test_jobs import *\n"
    script.write_text(head + body)
    environ = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, script], cwd=ROOT, env=environ, stderr=subprocess.PIPE, text=True
    )


def test_processes_that_cannot_start_are_a_sentence_and_not_an_endless_row(tmp_path):
    driver = run_script(tmp_path, "list(Pool(1).run(square, range(100)))\n")
    said = driver.communicate()[1]
    assert "SpikedeployError: worker processes end before their first job" in said
    assert said.count("An attempt has been made to start a new process") <= 3


def has_ended(stat):
    try:
        return ") Z " in stat.read_text()
    except OSError:
        return True


def test_a_job_ends_with_its_parent_and_a_training_at_a_checkpoint(tmp_path):
    jobs = [(name, str(tmp_path / name)) for name in ("linger", "train")]
    driver = run_script(
        tmp_path, f"if __name__ == '__main__':\n  list(Pool(2).run(errand, {jobs}))\n"
    )
    for _, path in jobs:
        wait_until(lambda path=Path(path): path.exists() and path.read_text())
    driver.kill()
    driver.communicate()
    wait_until(lambda: has_ended(Path("/proc") / (tmp_path / "linger").read_text() / "stat"))
    wait_until(lambda: (tmp_path / "train").read_text() == "checkpoint")


def test_ctrl_c_ends_jobs_at_once_and_trainings_at_a_checkpoint(tmp_path):
    def interrupt():
        wait_until(lambda: all((tmp_path / name).exists() for name in ("linger", "train")))
        os.kill(os.getpid(), signal.SIGINT)

    jobs = [(name, tmp_path / name) for name in ("linger", "train", "work")]
    found = []
    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt), Pool(2) as pool:
        found.extend(result.value for result in pool.run(errand, jobs))
    assert found == ["stopped"]
    assert (tmp_path / "linger").read_text() != "done"
    assert (tmp_path / "train").read_text() == "checkpoint"
    assert (tmp_path / "train.log").read_text() == "said on stdout\n"
