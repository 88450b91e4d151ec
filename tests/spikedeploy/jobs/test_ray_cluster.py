"""Tasks of Ray on this machine: the same answers, killed workers, nothing that others can reach."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest

from spikedeploy.jobs.pool import WORKER_ENVIRONMENT
from tests.paths import ROOT

pytest.importorskip("psutil")
if find_spec("ray") is None:
    pytest.skip("the extra sweep is not installed", allow_module_level=True)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What the scenarios came to."""
    folder = tmp_path_factory.mktemp("ray")
    done = subprocess.run(
        [sys.executable, "-m", "tests.spikedeploy.jobs.ray_scenarios", str(folder)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1]) | {"tries": (folder / "tries").read_text()}


def test_jobs_come_back_as_from_a_process(found):
    assert [place for place, _, _ in found["squares"]] == list(range(40))
    assert [value for _, value, _ in found["squares"][5:]] == [n * n for n in range(5, 40)]
    assert found["squares"][3][1:] == [None, "three is no chip"]


def test_workers_have_one_thread_and_this_process_is_left_alone(found):
    values = [value for _, value, _ in found["environment"]]
    assert values == list(WORKER_ENVIRONMENT.values())
    assert found["left"] == []


def test_a_killed_worker_loses_no_job_and_a_job_that_kills_always_fails_alone(found):
    values = {place: value for place, value, _ in found["killed"]}
    errors = {place: error for place, _, error in found["killed"] if error}
    assert [values[place] for place in (0, 2, 4)] == ["a", "b", "c"]
    assert list(errors) == [3]
    assert "killed" in errors[3]
    assert len(found["tries"]) <= 6


def test_nothing_listens_to_other_machines(found):
    ((_, addresses, _),) = found["listening"]
    assert addresses
    assert set(addresses) <= {"127.0.0.1", "::ffff:127.0.0.1", "::1"}


def test_a_cluster_that_does_not_answer_is_a_sentence(found):
    assert found["auto"].startswith("--address auto: no cluster of Ray answers")
