"""How fast our backends are in this checkout, beside another checkout of the same repository.

    git worktree add ../before 7b2e800
    python -m lab versions ../before [--policies] [--backend numpy] [--rounds 15] [--json]

One process for each checkout, with one thread; they take turns, and the medians of their inferences
are compared. Networks and inputs are those of lab/bench/runtime.py, without a ledger. With
--policies they are control steps of shipped policies on loihi1, with one, at random observations.
"""

import argparse
import json
import os
import subprocess
import sys
import timeit
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parents[2]
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
INPUTS = {1: 20, 1024: 1}  # inferences of a round, by the batch
POLICIES = ("hexapod/sparse", "hexapod/popsan", "kart-steer/sparse", "kart-grid/sparse")
OBSERVATIONS = 200  # of a policy in a round
CALIBRATION = 4  # rasters that thresholds are set with

Times = dict[str, dict[str, float]]
Cases = dict[str, list[Callable[[], Any]]]


def main() -> None:
    """Measure, and print a table or JSON."""
    arguments = parse_options()
    if arguments.child:
        serve(make_policies if arguments.policies else make_cases, arguments.backend)
        return
    trees = {"other": arguments.other.resolve(), "this": HERE}
    children = {name: child(tree, arguments) for name, tree in trees.items()}
    cases = {name: json.loads(ask(each, "cases")) for name, each in children.items()}["this"]
    taken: dict[str, dict[str, list[float]]] = {case: {n: [] for n in trees} for case in cases}
    for turn in range(arguments.rounds + 1):
        for case in cases:
            for name, each in children.items():
                times = json.loads(ask(each, case))
                if turn:  # the first round is not kept
                    taken[case][name] += times
    for each in children.values():
        each.communicate()
    median = {c: {n: float(np.median(times)) for n, times in t.items()} for c, t in taken.items()}
    print(json.dumps(median, indent=2) if arguments.json else table(median))


def child(tree: Path, arguments: argparse.Namespace) -> "subprocess.Popen[str]":
    """A process that imports from the tree, and measures what it is asked for."""
    environment = {**os.environ, "PYTHONPATH": str(tree), **dict.fromkeys(THREADS, "1")}
    command = [sys.executable, __file__, str(tree), "--backend", arguments.backend, "--child"]
    command += ["--policies"] * arguments.policies
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=tree, env=environment, stdin=pipe, stdout=pipe, text=True)


def ask(process: "subprocess.Popen[str]", question: str) -> str:
    """The answer of a child."""
    if process.stdin is None or process.stdout is None:
        raise RuntimeError("the process has no pipes")
    print(question, file=process.stdin, flush=True)
    return process.stdout.readline()


def serve(make: Callable[[str], Cases], backend: str) -> None:
    """Times [us per inference] of a round of the case that each line names."""
    sys.path[0] = os.environ["PYTHONPATH"]  # not this folder, but the tree
    cases = make(backend)
    for line in sys.stdin:
        case = line.strip()
        times = list(cases) if case == "cases" else time_calls(cases[case], case)
        print(json.dumps(times), flush=True)


def time_calls(acts: list[Callable[[], Any]], case: str) -> list[float]:
    """Time of each inference [us], per network of a batch."""
    batch = int(case.rpartition(" ")[2])
    return [1e6 * timeit.timeit(act, number=1) / batch for act in acts]


def make_cases(backend: str) -> Cases:
    """The inferences of a round, of each network and batch."""
    from lab.bench.nets import bernoulli, encode, kart, popsan
    from spikedeploy.runtime.emulator.machine import Machine

    cases = {}
    for name, make, raster in (
        ("popsan, random spikes", popsan, bernoulli(1024, 5, 770, 0.2)),
        ("popsan with its encoder", popsan, encode(1024, 5)),
        ("kart", kart, bernoulli(1024, 32, 20, 0.3)),
    ):
        net = make(raster[:CALIBRATION])
        for batch, inputs in INPUTS.items():
            infer = Machine(net.program, None, "none", backend=backend).infer
            parts = [raster[k : k + batch] for k in range(0, batch * inputs, batch)]
            cases[f"{name}, batch {batch}"] = [partial(infer, part) for part in parts]
    return cases


def make_policies(backend: str) -> Cases:
    """The control steps of a round, of each policy."""
    from spikedeploy import load
    from spikedeploy.runtime.chips.chip import chip
    from spikedeploy.runtime.emulator.controllers import SpikingController

    cases = {}
    for name in POLICIES:
        artifact = load(name).artifact
        seen = np.random.default_rng(0).normal(
            size=(OBSERVATIONS, artifact.codec.normaliser.mean.size)
        )
        act = SpikingController(artifact, chip("loihi1"), backend=backend).act
        cases[f"{name}, batch 1"] = [partial(act, each) for each in seen]
    return cases


def table(median: Times) -> str:
    """Return the result for people."""
    lines = [f"{'us per inference':36}{'other':>10}{'this':>10}{'other / this':>14}"]
    for case, each in median.items():
        ratio = each["other"] / each["this"]
        lines.append(f"{case:36}{each['other']:10.1f}{each['this']:10.1f}{ratio:14.2f}")
    return "\n".join(lines)


def parse_options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("other", type=Path, help="the other checkout")
    parser.add_argument("--backend", default="numpy", choices=("numpy", "numba"))
    parser.add_argument(
        "--policies", action="store_true", help="shipped ones, in place of networks"
    )
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":  # a child, which must find lab and spikedeploy in its tree alone
    main()
