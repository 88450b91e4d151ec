"""Functions that tests run as jobs in processes of their own."""

import os
import signal
import time
from pathlib import Path

from spikedeploy.experiments.trial import exclusive
from spikedeploy.runtime.errors import ConfigError


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
        time.sleep(60)
    except KeyboardInterrupt:
        Path(path).write_text("checkpoint")
        return False


def linger(path):
    """Heed no interruption for a while."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Path(path).write_text("begun")
    time.sleep(60)


def turn(path):
    """Work alone, and note when."""
    with exclusive(Path(path).with_name("lock")):
        Path(path).write_text(f"{time.time()}")
        time.sleep(0.5)
        Path(path).write_text(f"{Path(path).read_text()} {time.time()}")
