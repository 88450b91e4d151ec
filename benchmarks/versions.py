"""How fast our backends are in this checkout, beside another checkout of the same repository.

    git worktree add ../before 7b2e800
    python benchmarks/versions.py ../before [--backend numpy] [--rounds 9] [--json]

Processes of both take turns, with one thread each; each gives its median time of an inference, and
the medians of those are compared. Networks and inputs are those of benchmarks/runtime.py, without a
ledger.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent.parent
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
BATCHES = (1, 1024)
INPUTS = 20  # rasters of a round at batch 1
ROUNDS = {1: 8, 1024: 2}  # in each process

Times = dict[str, float]


def main() -> None:
    """Measure, and print a table or JSON."""
    arguments = parsed()
    if arguments.child:
        print(json.dumps(measured(arguments.backend)))
        return
    trees = {"this": HERE, "other": arguments.other.resolve()}
    taken: dict[str, list[Times]] = {name: [] for name in trees}
    for _ in range(arguments.rounds):
        for name, tree in trees.items():
            taken[name].append(child(tree, arguments.backend))
    median = {
        case: {name: float(np.median([each[case] for each in taken[name]])) for name in trees}
        for case in taken["this"][0]
    }
    print(json.dumps(median, indent=2) if arguments.json else table(median))


def child(tree: Path, backend: str) -> Times:
    """What a process measures that imports from the tree."""
    environment = {**os.environ, "PYTHONPATH": str(tree), **dict.fromkeys(THREADS, "1")}
    command = [sys.executable, __file__, str(tree), "--backend", backend, "--child"]
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, check=True)
    found: Times = json.loads(done.stdout)
    return found


def measured(backend: str) -> Times:
    """Median time [us per inference] of each network and batch."""
    sys.path.insert(0, os.environ["PYTHONPATH"])
    from benchmarks.nets import bernoulli, encoded, kart, popsan

    spikes, population = bernoulli(1024, 5, 770, 0.2), encoded(1024, 5)
    driving = bernoulli(1024, 32, 20, 0.3)
    nets = {
        "popsan, random spikes": (popsan(spikes[:32]), spikes),
        "popsan, its encoder": (popsan(population), population),
        "kart": (kart(driving[:32]), driving),
    }
    found = {}
    for name, (net, raster) in nets.items():
        for batch in BATCHES:
            rasters = [raster[k : k + batch] for k in range(0, len(raster), batch)][:INPUTS]
            found[f"{name}, batch {batch}"] = timed(net.program, rasters, backend)
    return found


def timed(program: object, rasters: list[np.ndarray], backend: str) -> float:
    """Median of the inferences of a pool [us]; the first round is not kept."""
    try:
        from spikedeploy.runtime.emulator.network import MachinePool
    except ImportError:  # where it stood before
        from spikedeploy.runtime.emulator.controllers import MachinePool

    infer, batch, times = MachinePool(program, "none", backend).infer, len(rasters[0]), []
    for turn in range(ROUNDS[batch] + 1):
        for raster in rasters:
            start = time.perf_counter()
            infer(raster)
            if turn:
                times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times)) / batch


def table(median: dict[str, Times]) -> str:
    """Return the result for people."""
    lines = [f"{'us per inference':36}{'other':>10}{'this':>10}{'other / this':>14}"]
    for case, each in median.items():
        ratio = each["other"] / each["this"]
        lines.append(f"{case:36}{each['other']:10.1f}{each['this']:10.1f}{ratio:14.2f}")
    return "\n".join(lines)


def parsed() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("other", type=Path, help="the other checkout")
    parser.add_argument("--backend", default="numpy", choices=("numpy", "numba"))
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    main()
