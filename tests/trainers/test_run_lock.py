"""One process trains in a run folder at a time."""

import errno
import os
import subprocess
import sys

import pytest

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.run_folder import fcntl, locked, socket

HOLD = """
import sys, time
from pathlib import Path
from spikedeploy.trainers.run_folder import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def holder(run):
    """A process that holds the lock."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, run], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"held\n"
    process.stdout.close()
    return process


@pytest.fixture
def without_flock(monkeypatch):
    def refused(handle, operation):
        raise OSError(errno.ENOTSUP, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refused)


def test_a_run_is_trained_by_one_process_which_is_named_until_it_dies(tmp_path):
    process = holder(tmp_path)
    with (
        pytest.raises(ConfigError, match=rf"is being trained by process {process.pid}: wait"),
        locked(tmp_path),
    ):
        pass
    process.kill()
    process.wait()
    assert (tmp_path / ".lock").is_file()
    with locked(tmp_path):
        pass
    assert not (tmp_path / ".lock").exists()


def test_the_lock_is_held_against_the_own_process_too(tmp_path):
    with locked(tmp_path), pytest.raises(ConfigError, match=f"process {os.getpid()}"):
        locked(tmp_path).__enter__()
    with locked(tmp_path):
        pass


def test_without_flock_the_process_is_looked_up(tmp_path, without_flock):
    lock = tmp_path / ".lock"
    lock.write_text(f"{os.getppid()} {socket.gethostname()}\n")
    with pytest.raises(ConfigError, match=f"process {os.getppid()}"):
        locked(tmp_path).__enter__()
    lock.write_text(f"{os.getppid()} elsewhere\n")
    with pytest.raises(ConfigError, match=r"on elsewhere.*If it has ended, delete .*\.lock"):
        locked(tmp_path).__enter__()
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    for stale in (f"{dead.pid} {socket.gethostname()}\n", "", "what is this"):
        lock.write_text(stale)
        with locked(tmp_path):
            pass


def test_a_folder_that_takes_no_files_is_named(tmp_path, monkeypatch):
    def refused(*_):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(os, "open", refused)
    with pytest.raises(ConfigError, match=r"cannot train in .*: Read-only file system\. Copy it"):
        locked(tmp_path).__enter__()
