"""Files: whole or missing, and locked by one process at a time."""

import subprocess
import sys

import pytest

from spikedeploy.errors import ConfigError
from spikedeploy.files import as_text, is_locked, locked

HOLD = """
import sys, time
from pathlib import Path
from spikedeploy.files import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_lock_is_held_by_one_process_which_is_named_until_it_dies(tmp_path):
    path = tmp_path / ".lock"
    process = subprocess.Popen([sys.executable, "-c", HOLD, path], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"held\n"
    process.stdout.close()
    assert is_locked(path)
    with pytest.raises(ConfigError, match=rf"in use: wait \(process {process.pid} on "):
        locked(path, "in use: wait").__enter__()
    process.kill()
    process.wait()
    assert not is_locked(path)
    with locked(path, "in use: wait"):
        pass


def test_a_lock_is_held_against_the_own_process_too(tmp_path):
    path = tmp_path / ".lock"
    with locked(path), pytest.raises(ConfigError, match="in use"):
        locked(path, "in use").__enter__()
    with locked(path):
        pass
    assert not path.exists()


def test_numbers_that_json_lacks_become_null():
    found = as_text({"a": [float("nan"), 1.5], 2: (float("-inf"),)})
    assert found == as_text({"a": [None, 1.5], "2": [None]})
