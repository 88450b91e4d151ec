"""Jobs: the same results in one process and in several, and clean failures."""

import os
import time

import pytest

from spikedeploy.parallel import WORKER_ENVIRONMENT, workers
from spikedeploy.runtime.errors import SpikedeployError


def square(number):
    return number * number


def environment(name):
    return os.environ.get(name)


def sleep(seconds):
    time.sleep(seconds)


def die(number):
    os._exit(number)


@pytest.mark.parametrize("count", [1, 2])
def test_results_come_in_the_order_of_the_jobs(count):
    done = []
    with workers(count) as jobs:
        assert jobs.run(square, range(5), lambda: done.append(1)) == [0, 1, 4, 9, 16]
    assert len(done) == 5


def test_workers_have_one_thread_and_leave_this_process_alone():
    before = dict(os.environ)
    with workers(2) as jobs:
        found = jobs.run(environment, list(WORKER_ENVIRONMENT), lambda: None)
    assert found == list(WORKER_ENVIRONMENT.values())
    assert dict(os.environ) == before


def test_a_killed_worker_is_one_clear_line():
    with workers(2) as jobs, pytest.raises(SpikedeployError, match="fewer --workers"):
        jobs.run(die, [1, 1], lambda: None)


def test_ctrl_c_ends_at_once_and_does_not_wait_for_jobs():
    began = time.monotonic()

    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), workers(2) as jobs:
        jobs.run(sleep, [0, 300, 300], interrupt)
    assert time.monotonic() - began < 60
