"""Events that the camera of kart-eye sends, by control rate and share of quiet.

    python -m lab eye-events [-o results/kart-eye-events.md] [--karts 4] [--forks 1]

The privileged teacher drives; its path and its events are those of 60 Hz as near as noise lets
them be, since the physics and the views do not depend on the control rate. Means over the time in
which each kart is under way; the rates while it drives and while it stands are means of their own.
"""

import argparse
from pathlib import Path

import numpy as np

from spikedeploy.envs.eye.batch import RATES, SPEED, EyeBatch, nearest_action
from spikedeploy.reports.table import markdown_text
from spikedeploy.runtime.files import write_text
from spikedeploy.seeds import EVALUATION

QUIET = (0.0, 0.5, 0.8, 0.95)
HEADS = (
    "control rate [Hz]", "quiet", "time at gates", "events/s", "events/s, driving",
    "events/s, waiting", "events a control step", "steps without events",
)  # fmt: skip


def measure(rate: int, quiet: float, karts: int, forks: int) -> list[str]:
    """Cells of a row."""
    batch = EyeBatch(karts, rate=rate, quiet=quiet, forks=forks)
    batch.reset(range(EVALUATION, EVALUATION + karts))
    going = np.ones(karts, np.bool_)
    events, steps = np.zeros(3), np.zeros(3, np.int64)  # all, driving, waiting
    silent = 0
    while going.any():
        counts, _, terminated, truncated, info = batch.step(nearest_action(batch.teacher()))
        sent = counts.sum((1, 2, 3), dtype=np.int64)
        masks = going, going & (batch.speed == SPEED), going & info["waiting"]
        for place, mask in enumerate(masks):
            events[place] += sent[mask].sum()
            steps[place] += mask.sum()
        silent += int((going & (sent == 0)).sum())
        going &= ~(terminated | truncated)
    rates = [f"{rate * n / of:,.0f}" if of else "–" for n, of in zip(events, steps, strict=True)]
    shares = [f"{100 * share:.0f} %" for share in (quiet, steps[2] / steps[0])]
    each, without = events[0] / steps[0], 100 * silent / steps[0]
    return [str(rate), *shares, *rates, f"{each:,.1f}", f"{without:.0f} %"]


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("results/kart-eye-events.md"))
    parser.add_argument("--karts", type=int, default=4)
    parser.add_argument("--forks", type=int, default=1)
    given = parser.parse_args()
    rows = [measure(rate, quiet, given.karts, given.forks) for rate in RATES for quiet in QUIET]
    text = "# Events of kart-eye\n\nWritten by `python -m lab eye-events`: the teacher drives "
    text += (
        f"{given.karts} courses, forks in each: {given.forks}. While a kart waits there is noise "
    )
    text += "alone, until the gate lifts before it.\n\n"
    write_text(given.output, text + markdown_text([HEADS, *rows]) + "\n")
    print(given.output)
