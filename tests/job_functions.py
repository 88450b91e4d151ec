"""Functions that tests run as jobs in processes of their own, and jobs in the test's process."""

import json
import os
import signal
import time
from importlib import import_module
from pathlib import Path

from spikedeploy.jobs.resumable import JobEnd
from spikedeploy.runtime.errors import ConfigError
from tests.waiting import PATIENCE


def write(path, text="done"):
    Path(path).write_text(text)


def fail(path):
    raise ConfigError("the shop was closed")


def crash(path):
    raise KeyError(path)


def die(path):
    os.kill(os.getpid(), signal.SIGKILL)


def wait(path):
    """Work until interrupted, then leave what a training would: a checkpoint, and False."""
    Path(path).write_text("begun")
    try:
        time.sleep(PATIENCE)
    except KeyboardInterrupt:
        Path(path).write_text("checkpoint")
        return False


def linger(path):
    """Heed no interruption for a while."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Path(path).write_text("begun")
    time.sleep(PATIENCE)
    Path(path).write_text("done")


def in_this_process(names):
    """A stand-in for resumable.run, which adds the names of the jobs that it runs."""

    def run(jobs, count, ended, look):
        for job in jobs:
            names.append(job.name)
            look([job])
            module, _, function = job.call.partition(":")
            done = getattr(import_module(module), function)(**json.loads(json.dumps(job.arguments)))
            ended(JobEnd(job, 1.0, 0 if done else 1))
        return True

    return run
