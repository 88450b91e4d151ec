"""Cells, memories and frequency of a build, from nextpnr's report; put into costs.json.

Usage: `python3 report.py REPORT SEED`.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any

# names of nextpnr -> ours
_USED = {
    "ICESTORM_LC": "cells",
    "ICESTORM_RAM": "block_rams",
    "ICESTORM_SPRAM": "large_rams",
    "ICESTORM_DSP": "multipliers",
    "TRELLIS_COMB": "cells",
    "DP16KD": "block_rams",
    "MULT18X18D": "multipliers",
    "TRELLIS_FF": "flip_flops",
}
_COSTS = Path("costs.json")


def summary(report: dict[str, Any], seed: int) -> dict[str, Any]:
    """Return the resources of a build: counts by name, seed, and mhz of its slowest clock."""
    used = report["utilization"]
    found = {name: used[key]["used"] for key, name in _USED.items() if key in used}
    return {"seed": seed, "mhz": min(each["achieved"] for each in report["fmax"].values()), **found}


def main(path: str, seed: str) -> int:
    """Print the summary, and put it beside the predictions."""
    found = summary(json.loads(Path(path).read_text("utf-8")), int(seed))
    numbers = [f"{value} {name.replace('_', ' ')}" for name, value in found.items() if value]
    print(f"seed {found['seed']}: {found['mhz']:.1f} MHz; {', '.join(numbers[2:])}")
    if _COSTS.is_file():
        costs = json.loads(_COSTS.read_text("utf-8"))
        others = [each for each in costs.get("built", []) if each["seed"] != found["seed"]]
        costs["built"] = sorted([*others, found], key=lambda each: int(each["seed"]))
        part = _COSTS.with_suffix(".part")
        part.write_text(json.dumps(costs, indent=2) + "\n", "utf-8")
        os.replace(part, _COSTS)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
