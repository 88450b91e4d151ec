"""Fuzz everything that reads files: only SpikedeployErrors, bounded time and memory.

    python benchmarks/fuzz.py [--format nir …] [--files 10000] [--record FOLDER] [--keep FOLDER]

Valid files of each format are mutated: bytes; values, shapes, types, links and edges of the HDF5
tree; operators and constants of ONNX; values of JSON; arrays of archives; files of run folders.
Networks are loaded, written again, read as another tool would, compiled for every chip with and
without limits, and run for three timesteps on some; other files are read by every command that
takes such a file. That happens in a process of its own with a memory limit; one that dies or takes
too long is a violation, like any error that is not ours, and another takes its place. The same seed
and version give the same mutations. With --record, outcomes are kept, and what is there is not
tried again. Exits with 1 on a violation.
"""

import prepare  # isort: skip  # noqa: F401 - before all others

import argparse
import contextlib
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from benchmarks.fuzz_formats import FORMATS
from benchmarks.fuzz_runs import recorded, resumed, table


def main() -> None:
    """Try the files and print the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--format", nargs="+", choices=FORMATS, default=list(FORMATS))
    parser.add_argument("--files", type=int, default=10_000, help="of each format")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--record", type=Path, help="folder that keeps outcomes")
    parser.add_argument("--keep", type=Path, help="folder for files that violate")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.record or Path(temporary) / "records"
        files = {name: folder / f"{name}-{options.seed}.jsonl" for name in options.format}
        # interrupted, it sums up what was tried
        with contextlib.suppress(KeyboardInterrupt):
            for name, file in files.items():
                work = Path(tempfile.mkdtemp(dir=temporary))
                resumed(file, options.files, options.seed, options.keep, name, work)
                print(name, file=sys.stderr, flush=True)
        outcomes = {name: recorded(file)[: options.files] for name, file in files.items()}
    found = {name: [asdict(outcome) for outcome in made] for name, made in outcomes.items()}
    print(json.dumps(found) if options.json else table(outcomes))
    sys.exit(any(outcome.violation for made in outcomes.values() for outcome in made))


if __name__ == "__main__":
    main()
