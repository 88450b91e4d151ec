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

from lab.bench.turns import report

HERE = Path(__file__).resolve().parents[2]
INPUTS = {1: 20, 1024: 1}  # inferences of a round, by the batch
POLICIES = ("hexapod/sparse", "hexapod/popsan", "kart-steer/sparse", "kart-grid/sparse")
OBSERVATIONS = 200  # of a policy in a round
Cases = dict[str, list[Callable[[], Any]]]


def main() -> None:
    """Measure, and print a table or JSON."""
    given = parse_options()
    if given.child:
        serve(make_policies if given.policies else make_networks, given.backend)
        return
    children = {"other": child(given.other.resolve(), given), "this": child(HERE, given)}
    cases = [json.loads(ask(each, "cases")) for each in children.values()][-1]
    taken: dict[str, dict[str, list[float]]] = {c: {n: [] for n in children} for c in cases}
    for turn in range(given.rounds + 1):
        for case in cases:
            for name, process in children.items():
                times = json.loads(ask(process, case))
                taken[case][name] += times if turn else []  # the first round is not kept
    for process in children.values():
        process.communicate()
    median = {c: {n: float(np.median(each)) for n, each in t.items()} for c, t in taken.items()}
    report({c: {**t, "other / this": t["other"] / t["this"]} for c, t in median.items()}, given)


def child(tree: Path, given: argparse.Namespace) -> "subprocess.Popen[str]":
    """Return a process that imports from the tree, and measures what it is asked for."""
    words = [sys.executable, __file__, str(tree), "--backend", given.backend, "--child"]
    words += ["--policies"] * given.policies
    pipe, environment = subprocess.PIPE, {**os.environ, "PYTHONPATH": str(tree)}
    return subprocess.Popen(words, cwd=tree, env=environment, stdin=pipe, stdout=pipe, text=True)


def ask(process: "subprocess.Popen[str]", question: str) -> str:
    """Return the answer of a child."""
    assert process.stdin is not None
    assert process.stdout is not None
    print(question, file=process.stdin, flush=True)
    return process.stdout.readline()


def serve(make: Callable[[str], Cases], backend: str) -> None:
    """Print the times [us per inference] of a round of the case that each line names."""
    sys.path[0] = os.environ["PYTHONPATH"]  # not this folder, but the tree
    cases = make(backend)
    for line in sys.stdin:
        case = line.strip()
        batch = int(case.rpartition(" ")[2]) if case != "cases" else 1
        acts = cases.get(case, [])
        times = [1e6 * timeit.timeit(act, number=1) / batch for act in acts] or list(cases)
        print(json.dumps(times), flush=True)


def make_networks(backend: str) -> Cases:
    """Return the inferences of a round, of each network and batch."""
    from lab.bench.nets import bernoulli, encode, kart, popsan
    from spikedeploy.runtime.emulator.machine import Machine

    cases = {}
    for name, make, raster in (
        ("popsan, random spikes", popsan, bernoulli(1024, 5, 770, 0.2)),
        ("popsan with its encoder", popsan, encode(1024, 5)),
        ("kart", kart, bernoulli(1024, 32, 20, 0.3)),
    ):
        infer = Machine(make(raster[:4]).program, None, "none", backend=backend).infer
        for batch, inputs in INPUTS.items():
            parts = [raster[k : k + batch] for k in range(0, batch * inputs, batch)]
            cases[f"{name}, batch {batch}"] = [partial(infer, part) for part in parts]
    return cases


def make_policies(backend: str) -> Cases:
    """Return the control steps of a round, of each policy."""
    from spikedeploy import load
    from spikedeploy.runtime.chips.chip import chip
    from spikedeploy.runtime.emulator.controllers import SpikingController

    cases = {}
    for name in POLICIES:
        artifact = load(name).artifact
        width = artifact.codec.normaliser.mean.size
        seen = np.random.default_rng(0).normal(size=(OBSERVATIONS, width))
        act = SpikingController(artifact, chip("loihi1"), backend=backend).act
        cases[f"{name}, batch 1"] = [partial(act, each) for each in seen]
    return cases


def parse_options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("other", type=Path, help="the other checkout")
    parser.add_argument("--backend", default="numpy", choices=("numpy", "numba"))
    parser.add_argument("--policies", action="store_true", help="in place of networks")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":  # a child, which must find lab and spikedeploy in its tree alone
    main()
