"""Time and memory of the worst files that are known, each below 5 MB and in a process of its own.

    python benchmarks/limits.py [NAME …]

Prints a table in Markdown: what the file is, its size, CPU seconds and megabytes that reading it
took besides libraries and Python, and what came of it. Networks are then checked for every chip,
and the slowest counts. Exits with 1 where a file takes more than 5 s or 500 MB.
"""

import prepare  # isort: skip  # noqa: F401 - before all others

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from benchmarks.fuzz_runs import CPU_SECONDS, MEGABYTES, resident
from benchmarks.fuzz_trials import OURS
from benchmarks.worst_files import FILES, small

CLOCK = 300  # seconds after which a file is given up


def main() -> None:
    """Measure each, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(FILES)}")
    parser.add_argument("--file", type=Path, help="measure this one alone, and print JSON")
    options = parser.parse_args()
    if options.file:
        print(json.dumps(measured(options.file)))
        return
    print("| file | MB | CPU s | MB of memory | what came of it |\n|---|---:|---:|---:|---|")
    wrong = False
    for name in options.names or FILES:
        with tempfile.TemporaryDirectory() as folder:
            suffix, write = FILES[name]
            path = Path(folder) / f"file{suffix}"
            write(path)
            size = path.stat().st_size
            stored = min(size, 512 * path.stat().st_blocks)
            found = in_a_process(path)
        wrong |= found["seconds"] > CPU_SECONDS or found["megabytes"] > MEGABYTES
        print(
            f"| {name} | {stored / 1e6:.1f} | {found['seconds']:.1f} | {found['megabytes']:.0f} | "
            f"{found['outcome']} |",
            flush=True,
        )
    sys.exit(wrong)


def in_a_process(path: Path) -> dict[str, float | str]:
    """What `measured` says of a file."""
    words = [sys.executable, __file__, "--file", str(path)]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=CLOCK)
        found: dict[str, float | str] = json.loads(done.stdout.splitlines()[-1])
    except (subprocess.TimeoutExpired, IndexError, ValueError):
        return {"seconds": float(CLOCK), "megabytes": float("nan"), "outcome": "did not end"}
    return found


def measured(path: Path) -> dict[str, float | str]:
    """CPU seconds and megabytes of reading a file, besides those of a small one before it."""
    with tempfile.TemporaryDirectory() as folder:
        attempt(small(path.suffix, Path(folder)))
    libraries = resident("VmRSS")
    outcome, seconds = attempt(path)
    most = resident("VmHWM")
    return {"seconds": seconds, "megabytes": max(0.0, most - libraries), "outcome": outcome}


def attempt(path: Path) -> tuple[str, float]:
    """Read a file: "read", or the first words of the error; and CPU seconds."""
    outcome, seconds = "read", []
    try:
        for step in steps(path):
            began = sum(os.times()[:4])
            try:
                step()
            finally:
                seconds.append(sum(os.times()[:4]) - began)
    except OURS as error:
        text = " ".join(str(error).replace(f"{path}", path.name).split())
        outcome = f"{type(error).__name__}: {text[:100]}…"
    return outcome, seconds[0] + max(seconds[1:], default=0.0)


def steps(path: Path) -> Iterator[Callable[[], object]]:
    """Reading it; of a network also checking it, for one chip after the other."""
    from benchmarks.fuzz_readers import READERS
    from spikedeploy.emulation.rasters import read_rasters
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.chips.chip import CHIPS, chip
    from spikedeploy.runtime.compiler.compile import check

    if path.suffix != ".nir":  # of rasters without playing them, which takes as long as they last
        raster = path.suffix in (".npy", ".npz")
        yield partial(read_rasters if raster else READERS[path.suffix][0], path)
        return
    found = []
    yield lambda: found.append(load(path, dt=1e-3))
    for name in CHIPS:
        yield partial(check, found[0], chip(name))


if __name__ == "__main__":
    main()
