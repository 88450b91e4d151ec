r"""Shipped policies as C: equal spikes in whole episodes, sizes, instructions on two cores.

    python -m lab firmware [--episodes 20] [--only hexapod/sparse] [--write]

Each policy is exported as `spikedeploy export --to c --chip loihi1` does it. Its C plays back the
observations of episodes, and every spike and action is compared with the runtime's. For a
Cortex-M4 (no floating-point unit used) and a RV32IMAC core it is built with Debian's compilers and
picolibc; the self-test runs under qemu, which also counts the instructions of a control step. Needs
gcc; what else is missing leaves a dash:

    apt-get install --no-install-recommends gcc-arm-none-eabi picolibc-arm-none-eabi \
        gcc-riscv64-unknown-elf picolibc-riscv64-unknown-elf qemu-system-arm qemu-system-misc

--write puts the table into docs/firmware.md. Exits with 1 where something differs.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path

from lab.firmware.runs import measured
from lab.firmware.table import table, written
from spikedeploy import zoo


def main() -> None:
    """Measure the policies and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--only", default="", help="a policy, such as hexapod/sparse")
    parser.add_argument("--write", action="store_true", help="the table into docs/firmware.md")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    names = [name for name in zoo.names() if zoo.path(name).suffix == ".nir"]
    rows = []
    for name in names:
        if options.only in ("", name):
            with tempfile.TemporaryDirectory() as folder:
                rows.append(measured(name, Path(folder), options.episodes))
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    print(json.dumps(rows) if options.json else table(rows))
    if options.write:
        written(rows, options.episodes)
    sys.exit(any(row["differing"] or not row["passed"] for row in rows))
