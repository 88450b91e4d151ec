"""Kill trainings at random moments, resume them, and compare every file with an unbroken run's.

    python -m lab kill [--kills 20] [--seed 0] [--only sac] [--keep FOLDER]

Small trainings of every algorithm are started, killed (SIGKILL), resumed and killed again: one
half of the kills at a random time, the other at a random one of the file operations, which are
short and would hardly be met otherwise. Among the kills some are stopped (SIGTERM), which leaves a
checkpoint where the unbroken run has none. Each chain of them ends with a training that may finish.
Its run folder must then hold the same files as that of the run that nothing stopped, with the
same bytes; left out are the columns of metrics.csv that are times, what has the folder's name in
it (curves, card and page) and TensorBoard's files. Exits with 1 on a difference.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from lab.kill.kill_chains import CASES, Killer, table


def main() -> None:
    """Run the chains and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20, help="of each training")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--keep", type=Path, help="folder in which the run folders stay")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        killer = Killer(options.keep or Path(temporary), options.seed)
        rows = []
        for name in options.only:
            rows.append(killer.tried(CASES[name], options.kills))
            print(table(rows[-1:]), file=sys.stderr, flush=True)
    print(json.dumps([asdict(row) for row in rows]) if options.json else table(rows))
    sys.exit(any(row.differences for row in rows))
