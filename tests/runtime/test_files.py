"""Files: whole or missing, and locked by one process at a time."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.emulation.design_report import network_path
from spikedeploy.envs.kart import track
from spikedeploy.policies.registry import find
from spikedeploy.policies.scripts import teacher_candidate
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text, is_locked, locked, replacing, suffix, write_text
from spikedeploy.shipping.sources import is_nir_file, nir_file
from spikedeploy.trainers.distill.teachers import teacher
from tests.paths import ROOT

HOLD = """
import sys, time
from pathlib import Path
from spikedeploy.runtime.files import locked
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


KILLED = """
import os, signal, sys
from pathlib import Path
from spikedeploy.runtime.files import replacing
with replacing(Path(sys.argv[1])) as part:
    part.write_text("half")
    if len(sys.argv) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    print(part, flush=True)
    sys.stdin.read()
"""


def test_what_a_kill_left_of_an_output_goes_with_its_next_write_and_no_other(tmp_path):
    output = tmp_path / "out [1].json"
    for _ in range(2):
        subprocess.run([sys.executable, "-c", KILLED, output], check=False)
    (left,) = tmp_path.iterdir()  # the second has deleted what the first left
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, output, "waits"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    at_work = Path(process.stdout.readline().strip())
    assert not left.exists()
    others = [tmp_path / ".out [1].json.000000-1.part", tmp_path / f".other{left.name}"]
    for other in others:
        other.touch()
    write_text(output, "whole")
    assert output.read_text() == "whole"
    assert sorted(tmp_path.iterdir()) == sorted([output, at_work, *others])
    process.communicate("")
    assert output.read_text() == "half"
    assert not at_work.exists()


def test_a_file_that_is_written_twice_at_once_is_that_of_the_last_to_end(tmp_path):
    output = tmp_path / "out.json"
    with replacing(output) as first:
        first.write_text("first")
        with pytest.raises(FileNotFoundError), replacing(output):
            pass  # nothing was written, and nothing of the first is lost
        with replacing(output) as second:
            assert second != first
            second.write_text("second")
        assert output.read_text() == "second"
    assert output.read_text() == "first"
    assert list(tmp_path.iterdir()) == [output]


def test_numbers_that_json_lacks_become_null():
    found = as_text({"a": [float("nan"), 1.5], 2: (float("-inf"),)})
    assert found == as_text({"a": [None, 1.5], "2": [None]})


def read_teacher(path):
    observation = np.linspace(-1, 1, 64 * 4).reshape(64, 4)
    return teacher(str(path), "CartPole-v1").act_all(observation).tolist()


def found(describe):
    return lambda path: replace(describe(str(path)), path="", name="")


HEXAPOD = zoo.FOLDER / "hexapod"
# file -> its name in upper case, and who reads it
READERS = [
    (HEXAPOD / "popsan.nir", "NET.NIR", found(find)),
    (HEXAPOD / "popsan.nir", "NET.NIR", lambda path: suffix(network_path(str(path)))),
    (HEXAPOD / "popsan.nir", "NET.NIR", lambda path: suffix(nir_file(str(path), "c"))),
    (HEXAPOD / "popsan.nir", "NET.NIR", lambda path: is_nir_file(str(path))),
    (HEXAPOD / "sac.onnx", "POLICY.ONNX", found(find)),
    (ROOT / "tests/golden/sb3/ppo.zip", "TEACHER.ZIP", found(teacher_candidate)),
    (ROOT / "tests/golden/sb3/ppo.zip", "TEACHER.ZIP", read_teacher),
    (ROOT / "envs/kart/tracks/big_S.json", "TRACK.JSON", lambda path: track.load(path).length),
    (ROOT / "runtime/chips/datasheets/loihi1.toml", "OWN1.TOML",
     lambda path: replace(chip(f"{path}:weight_bits=4"), name="")),
]  # fmt: skip


@pytest.mark.parametrize(("file", "upper", "read"), READERS)
def test_suffixes_are_taken_in_any_case(file, upper, read, tmp_path):
    lower = tmp_path / upper.lower()
    for path in (lower, tmp_path / upper):
        path.write_bytes(file.read_bytes())
    assert read(tmp_path / upper) == read(lower)


def test_names_of_shipped_policies_have_suffixes_in_any_case():
    assert zoo.resolve("hexapod/popsan.NIR") == zoo.resolve("hexapod/popsan")
