"""What happens to jobs on Ray, as JSON: `python -m tests.spikedeploy.jobs.ray_scenarios FOLDER`.

A process of its own, as Ray leaves sockets and processes to the end of its interpreter.
"""

import json
import os
import sys
from pathlib import Path

import psutil

from spikedeploy.jobs.pool import WORKER_ENVIRONMENT
from spikedeploy.jobs.ray_cluster import RayBackend
from spikedeploy.runtime.errors import ConfigError
from tests.spikedeploy.jobs.test_pool import errand, square


def environment(name):
    return os.environ.get(name)


def listening(_):
    """Addresses on which this worker, its parents and their other children listen."""
    family = psutil.Process().parents()[:2]
    family += [child for each in family for child in each.children(recursive=True)]
    ends = [end for process in family for end in process.net_connections()]
    return sorted({end.laddr.ip for end in ends if end.status == psutil.CONN_LISTEN})


def told(answers):
    """Answers in the order of their jobs, as JSON."""
    found = sorted(answers, key=lambda answer: answer.index)
    return [[each.index, each.value, each.error and str(each.error)] for each in found]


def main(folder):
    before = dict(os.environ)
    deadly = [("work", "a"), ("die once", folder / "once"), ("work", "b")]
    deadly += [("die", folder / "tries"), ("work", "c")]
    with RayBackend(1) as backend:
        found = {
            "squares": told(backend.run(square, range(40))),
            "environment": told(backend.run(environment, list(WORKER_ENVIRONMENT))),
            "killed": told(backend.run(errand, deadly)),
            "listening": told(backend.run(listening, [None])),
        }
    names = ("RAY_AUTH_TOKEN", "RAY_AUTH_MODE", "OMP_NUM_THREADS")
    found["left"] = [name for name in names if os.environ.get(name) != before.get(name)]
    try:
        with RayBackend(None, "auto"):
            found["auto"] = ""
    except ConfigError as error:
        found["auto"] = str(error)
    print(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
