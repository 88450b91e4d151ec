"""Fuzz everything that reads files: only SpikedeployErrors, bounded time and memory.

    python benchmarks/fuzz.py [--files 10000] [--seed 0] [--only .onnx] [--keep FOLDER]

Valid files of every primitive, with and without our metadata, ONNX policies, traces, tracks,
rasters, ghosts, rollouts, TOML files and configurations of runs are mutated: bytes; values,
shapes, types, links and edges of the HDF5 tree; values of JSON; arrays of archives. Each is
loaded, written again, read as another tool would, compiled for every chip with and without limits,
and run for three timesteps on some; traces are verified. That happens in a process of its own with
a memory limit; one that dies or takes too long is a violation, like any other error, and
another takes its place. The same seed and version give the same mutations. Exits with 1 on a
violation.
"""

import prepare  # isort: skip  # noqa: F401 - before all others

import argparse
import contextlib
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from benchmarks.fuzz_runs import describe, fuzz, summary


def main() -> None:
    """Try the files and print the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for files that violate")
    parser.add_argument("--only", default="", help="format, such as .onnx, .ghosts or .toml")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    numbers = range(options.first, options.first + options.files)
    outcomes = []
    with (
        tempfile.TemporaryDirectory() as folder,
        # interrupted, it sums up what was tried
        contextlib.suppress(KeyboardInterrupt),
    ):
        for outcome in fuzz(numbers, options.seed, Path(folder), options.keep, options.only):
            outcomes.append(outcome)
            if outcome.violation:
                print(describe(outcome), file=sys.stderr, flush=True)
    print(json.dumps([asdict(o) for o in outcomes]) if options.json else summary(outcomes))
    sys.exit(any(outcome.violation for outcome in outcomes))


if __name__ == "__main__":
    main()
