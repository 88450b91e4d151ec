"""Faults that a sweep survives: nodes and drivers that are killed.

    python -m lab sweep [--jobs 200] [--only nodes driver] [--folder FOLDER]

nodes    two nodes of Ray on 127.0.0.1, one of which is killed half-way
driver   the same nodes; the driver is killed with SIGKILL half-way, and started again

Every result is compared with that of --backend serial, byte for byte, and the journal must name no
job twice. Exits with 1 where a result is missing, twice or different.
"""

import argparse
import csv
import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spikedeploy.campaign.sweep import run_sweep
from spikedeploy.campaign.sweep_grid import read_grid
from spikedeploy.jobs.pool import SerialBackend

_SPEC = """
env = "kart-grid"
policy = "kart-grid/sparse"
disturb = ["none", "lidar-noise:1"]
fault = ["none", "dead-neurons:1"]
seed = "10000-{last}"
episodes = 1
"""
_CELLS = 4  # of that grid, without the seeds
_CLUSTER = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "token",
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # then nodes have the address 127.0.0.1
}
PARTS = ("nodes", "driver")
_PATIENCE = 1800.0  # [s] for a sweep


def sweep(spec: Path, folder: Path, *words: str) -> "subprocess.Popen[bytes]":
    """A sweep in a process of its own."""
    command = [sys.executable, "-m", "spikedeploy", "sweep", str(spec), "-o", str(folder), *words]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def run_serially(spec: Path, folder: Path) -> None:
    """Run a sweep to its end, in this process."""
    outcome = run_sweep(read_grid(spec), folder, SerialBackend())
    if outcome.interrupted or outcome.failed:
        sys.exit(f"the sweep in {folder} did not end: {outcome.summary}")


def wait_half_way(folder: Path, jobs: int, driver: "subprocess.Popen[bytes]") -> int:
    """Wait until half of the jobs are done; how many are."""
    end = time.monotonic() + _PATIENCE
    while (done := len(results(folder))) < jobs // 2:
        if time.monotonic() > end or driver.poll() is not None:
            sys.exit(f"the sweep in {folder} did not come half-way: {done} of {jobs}")
        time.sleep(0.05)
    return done


def results(folder: Path) -> dict[str, bytes]:
    """Name -> content of the results so far."""
    return {file.name: file.read_bytes() for file in (folder / "jobs").glob("[!.]*.json")}


def verdict(folder: Path, serial: Path, jobs: int) -> dict[str, Any]:
    """Numbers of results that are missing, twice, or unlike the serial sweep's."""
    found, expected = results(folder), results(serial)
    lines = csv.DictReader((folder / "journal.csv").read_text("utf-8").splitlines())
    keys = [line["key"] for line in lines if line["status"] == "done"]
    return {
        "results": len(found),
        "missing": jobs - len(found),
        "twice": len(keys) - len(set(keys)),
        "different": sum(found[name] != expected.get(name) for name in found),
    }


@contextmanager
def cluster() -> Iterator[Any]:
    """Two nodes of Ray with a core each, and the second."""
    os.environ.update(_CLUSTER)
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))  # Ray keeps the first one
    from ray.cluster_utils import Cluster

    options = {"num_cpus": 1, "include_dashboard": False}
    both = Cluster(initialize_head=True, head_node_args=options)
    try:
        yield both, both.add_node(num_cpus=1)
    finally:
        both.shutdown()


def kill(part: str, spec: Path, folder: Path, jobs: int) -> dict[str, Any]:
    """Kill a node half-way, or the driver, which is started again."""
    with cluster() as (both, second):
        words = ("--backend", "ray", "--address", both.address)
        driver = sweep(spec, folder, *words)
        done = wait_half_way(folder, jobs, driver)
        if part == "nodes":
            both.remove_node(second, allow_graceful=False)
        else:
            driver.send_signal(signal.SIGKILL)
            driver.wait()
            done, driver = len(results(folder)), sweep(spec, folder, *words)
        return {"done when killed": done, "exit status": driver.wait(_PATIENCE)}


def main() -> None:
    """Run the parts and print what they came to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=200, help="a multiple of 4")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--folder", type=Path, help="where results are kept; else nowhere")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        spec = folder / "spec.toml"
        spec.write_text(_SPEC.format(last=10_000 + options.jobs // _CELLS - 1), encoding="utf-8")
        run_serially(spec, folder / "serial")
        wrong = False
        for part in options.only:
            found = kill(part, spec, folder / part, options.jobs)
            judged = verdict(folder / part, folder / "serial", options.jobs)
            wrong |= any(judged[fault] for fault in ("missing", "twice", "different"))
            print(json.dumps({part: found | judged}, indent=2), flush=True)
    sys.exit(wrong)
