"""Memory of a network that streams for a million timesteps, on both backends.

    python -m lab flat-memory [--steps 1000000] [--backend numpy] [--json]

The resident memory of the process is noted after each tenth of the steps; in the first, libraries
fill their caches. Exits with 1 where it grows from the first to the last by more than 64 KiB.

A ledger that keeps a row for each step (`ledger="each"`, the default of Machine) grows by that row,
8 bytes for each layer and kind of event; what streams for long takes "total" or "none".
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from lab.bench import nets
from spikedeploy.runtime.emulator.machine import Machine

PARTS = 10
ALLOWED = 64 * 1024  # [bytes]


def main() -> None:
    """Stream, print and judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--backend", choices=["numpy", "numba"], action="append")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = [
        measure(backend, ledger, options.steps)
        for backend in options.backend or ["numpy", "numba"]
        for ledger in ("none", "total")
    ]
    if options.json:
        print(json.dumps(rows))
    else:
        for row in rows:
            print(
                f"{row['backend']}, ledger {row['ledger']!r}: {row['steps']:,} steps in "
                f"{row['seconds']:.0f} s, {row['bytes_per_step']:+.3f} bytes a step, "
                f"{row['resident'][-1] / 2**20:.1f} MiB at the end"
            )
    sys.exit(any(not row["flat"] for row in rows))


def measure(backend: Any, ledger: Any, steps: int) -> dict[str, Any]:  # noqa: ANN401
    """Resident memory [bytes] after each part of the steps."""
    spikes = nets.bernoulli(1, 64, 20, 0.2)
    machine = Machine(nets.kart(spikes).program, ledger=ledger, backend=backend)
    rows = [np.ascontiguousarray(spikes[:, t]) for t in range(spikes.shape[1])]
    resident, start = [], time.monotonic()
    for _ in range(PARTS):
        for step in range(steps // PARTS):
            machine.step(rows[step % len(rows)])
        resident.append(resident_memory())
    grown = resident[-1] - resident[0]
    return {
        "backend": backend,
        "ledger": ledger,
        "steps": steps,
        "seconds": round(time.monotonic() - start, 1),
        "resident": resident,
        "bytes_per_step": grown / (steps * (PARTS - 1) // PARTS),
        "flat": grown <= ALLOWED,
    }


def resident_memory() -> int:
    """Resident memory of this process [bytes]."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
