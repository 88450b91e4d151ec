"""Real time of the shipped policies: how soon they act, and how many times faster than the robot.

    python -m lab realtime [NAME ...] [--chip loihi1] [--steps 1000] [--rounds 5] [--json]

start  load + compile + first act, after the import of spikedeploy, each in a process of its own:
       wall clock, and what the process computed, which other work on the machine does not change
loop   the closed loop with the ledger on, once with NumPy's kernels and once with the compiled
       ones: the policy and the environment's own step; medians. A factor is the control period over
       their sum.

Where the machine has other work, compare the parts with one another and not with other machines.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lab.bench.turns import parser_of, report
from spikedeploy import zoo
from spikedeploy.make_env import make_env
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.controllers import SpikingController

NAMES = ("hexapod/popsan", "hexapod/sparse", "kart-steer/snn", "kart-steer/sparse")
BACKENDS: tuple[BackendName, ...] = ("numpy", "numba")
SEED = 5_000  # evaluation begins at 10,000
_START = """
import json, sys, time
import spikedeploy.api
wall, cpu = time.perf_counter(), time.process_time()
controller = spikedeploy.api.load(sys.argv[1]).on(sys.argv[2]).controller()
controller.act([0.0] * controller.codec.encoder.observed)
print(json.dumps([time.perf_counter() - wall, time.process_time() - cpu]))
"""


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = parser_of(__doc__, rounds=5)
    parser.add_argument("names", nargs="*", metavar="NAME", help="shipped spiking policies")
    parser.add_argument("--chip", default="loihi1")
    parser.add_argument("--steps", type=int, default=1000)
    given = parser.parse_args()
    result = {
        name: {
            **starts(name, given.chip, given.rounds),
            "median_s": (found := {b: loop(name, given.chip, given.steps, b) for b in BACKENDS}),
            "times_real_time": {b: period(name) / sum(medians) for b, medians in found.items()},
        }
        for name in given.names or NAMES
    }
    report(result, given)


def starts(name: str, on: str, rounds: int) -> dict[str, float]:
    """Medians [s] of load, compile and first act; the first process fills caches."""
    words = [sys.executable, "-c", _START, str(zoo.resolve(name)), on]
    path = str(Path(__file__).resolve().parents[2])
    found = [
        json.loads(subprocess.run(words, check=True, capture_output=True, cwd=path).stdout)
        for _ in range(rounds + 1)
    ]
    wall, cpu = np.median(found[1:], axis=0).tolist()
    return {"start_s": wall, "start_cpu_s": cpu}


def period(name: str) -> float:
    """The time of a control step [s]."""
    world: Any = make_env(name.partition("/")[0], {}).unwrapped
    return float(world.CONTROL_DT)


def loop(name: str, on: str, steps: int, backend: BackendName) -> tuple[float, float]:
    """Medians [s] of the policy and of the environment's step."""
    artifact, env = load(str(zoo.resolve(name))), make_env(name.partition("/")[0], {})
    policy = SpikingController(artifact, chip(on), "total", backend=backend)
    taken: tuple[list[float], list[float]] = [], []
    observation, _ = env.reset(seed=SEED)
    for _ in range(steps):
        action = clocked(taken[0], policy.act, observation)
        observation, _, terminated, truncated, _ = clocked(taken[1], env.step, action)
        if terminated or truncated:
            observation, _ = env.reset()
            policy.reset(0)
    acted, stepped = (float(np.median(values[steps // 20 :])) for values in taken)
    return acted, stepped


def clocked(taken: list[float], call: Callable[..., Any], given: object) -> Any:  # noqa: ANN401
    """Return what a call returns, and add its duration [s] to those taken before."""
    begun = time.perf_counter()
    result = call(given)
    taken.append(time.perf_counter() - begun)
    return result
