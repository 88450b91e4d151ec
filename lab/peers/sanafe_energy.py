"""How far our energies and times of random networks are from those of SANA-FE.

Both have the same spikes; energies by the table `sanafe`, with the messages between the cores of
the layout; times as if one core did everything. `pip install "spikedeploy[sanafe]"` first.
"""

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from lab.peers.sanafe_networks import NETWORKS, one_core_each, program, run, scatter, simulate
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.metrics.energy import TABLES, energy, latency
from spikedeploy.runtime.metrics.traffic import Layout, traffic

TABLE = TABLES["sanafe"]
LAYOUTS = {
    "one core a layer": lambda network, seed: one_core_each(network),
    "12 cores": scatter,
}
HEADS = ("network", "layout", "rate", "SOPs", "messages", "energy [nJ]", "theirs", "time [us]",
         "theirs")  # fmt: skip


def main() -> None:
    """Print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20, help="timesteps of a run")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for line in (HEADS, ("---",) * len(HEADS)):
        print(f"| {' | '.join(line)} |")
    for case in NETWORKS:
        for rate in (0.05, 0.3):
            for name, place in LAYOUTS.items():
                network = program(case, options.seed)
                rng = np.random.default_rng(options.seed)
                raster = (rng.random((options.steps, network.width)) < rate).astype(np.uint8)
                placed = place(network, options.seed)
                cells = (case, name, f"{rate:g}", *_measured(network, raster, placed))
                print(f"| {' | '.join(cells)} |")


def _measured(network: Program, raster: np.ndarray, layout: Layout) -> Iterator[str]:
    ledger, spikes = run(network, raster)
    sent = traffic(network, spikes, layout)
    with _silence():
        theirs = simulate(network, raster, layout)
    joules, whole = energy(ledger, TABLE, sent), theirs["energy"]["total"]
    seconds, time = latency(ledger, TABLE), theirs["sim_time"]
    yield from (f"{ledger.total('sop'):,}", f"{sent.message:,}")
    yield from (f"{joules * 1e9:.2f}", f"{whole * 1e9:.2f} ({joules / whole - 1:+.3%})")
    yield from (f"{seconds * 1e6:.2f}", f"{time * 1e6:.2f} ({seconds / time - 1:+.0%})")


@contextmanager
def _silence() -> Iterator[None]:
    """Without the lines that SANA-FE writes on stdout, past Python."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(nowhere)
        os.close(kept)
