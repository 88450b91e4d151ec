"""The page of the kart experiment: results/kart.md, its tables as CSV, and its picture."""

import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from spikedeploy.experiments.kart.design import CONTROLS, NETWORKS, PEERS, WORLDS, ExperimentDesign
from spikedeploy.experiments.kart.plot import draw
from spikedeploy.experiments.kart.records import COUNT, NTH, Record, driving, learning, write_csv
from spikedeploy.experiments.kart.tables import (
    chip_table,
    driving_table,
    learning_table,
    of,
    on_chip,
    share,
)
from spikedeploy.files import write_text
from spikedeploy.trainers.versions import own

_NEAR = 0.95  # of the ANN's steps: what an SNN is asked to reach
_POINTS = 2  # of the finish rate that the chip may differ from the float twin


def write(design: ExperimentDesign, results: Path) -> list[Path]:
    """Write page, tables and picture of the complete parts; return the files."""
    learned, driven = learning(design), driving(design)
    folder = results / "kart"
    files = [
        write_csv(learned, folder / "learning.csv"),
        write_csv(driven, folder / "driving.csv"),
        write_csv(_finishes(design), folder / "finishes.csv"),
        draw(design, folder / "finishes.png"),
    ]
    return [write_text(results / "kart.md", _page(design, learned, driven)), *files]


def _finishes(design: ExperimentDesign) -> list[Record]:
    """One row for each finish of each complete training."""
    return [
        {"recipe": t.recipe, "seed": t.seed, "finish": n, "env_steps": steps}
        for t in design.trials()
        if t.trained
        for n, steps in enumerate(map(int, t.finishes), start=1)
    ]


_LEARNING = f"""\
Environment steps until the first and the {COUNT}th finished episode of training, whose actions are
drawn and whose starts are random; the steps of all copies of the world count. Medians over the
training seeds [least, most]. "% of ANN" is the ANN's steps over the SNN's, with a 95% bootstrap
interval over seeds. kart-simulator's figures are of single, best runs, read off once a batch.

Dynamics, track, starts and what counts as a finish are kart-simulator's; the reward, the
observation (rays straight ahead, all of the motion) and PPO's settings are ours. So the steps show
what a user of this project gets, not which of these differences is worth how much."""
_DRIVING = """\
Greedy episodes from {episodes} starts that no training saw, for each trained policy; medians over
the trainings [least, most]. `float` is the float twin of the spiking network, `{chip}` the same
file in the emulated chip's integers. Controls: `small` is a float network of the spiking one's
size, `linear` has no hidden layer; both learn by the same rules within the same budget. `gap` is a
script that follows the gap in the LIDAR, `random` draws its actions."""
_CHIP = """\
The same starts, the same file; points of the finish rate, and the share of equal actions on the
observations that the twin recorded."""


def _page(design: ExperimentDesign, learned: Sequence[Record], driven: Sequence[Record]) -> str:
    """The page."""
    budgets = {(w, p): _budget(design, w, p) for w in WORLDS for p in NETWORKS}
    sections = {
        "How soon they finish": [
            _LEARNING,
            "\n".join(learning_table(learned, budgets)),
            "![finishes against environment steps](kart/finishes.png)",
        ],
        "How well they drive": [
            _DRIVING.format(episodes=design.episodes, chip=design.chip),
            "\n".join(driving_table(driven)),
        ],
        "The chip beside its float twin": [_CHIP, "\n".join(chip_table(driven))],
        "How this was made": ["\n".join(_facts(design, budgets))],
    }
    parts = ["# Karts: float and spiking networks, learned from scratch", f"    {_command()}"]
    parts += [*_missing(design), "\n".join(verdicts(learned, driven))]
    for title, section in sections.items():
        parts += [f"## {title}", *section]
    return "\n\n".join(part for part in parts if part) + "\n"


def _command() -> str:
    return shlex.join(["spikedeploy", *sys.argv[1:]])


def _missing(design: ExperimentDesign) -> list[str]:
    done, of_all = sum(part.done for part in design.parts), len(design.parts)
    return [f"**{done} of {of_all} parts are complete.**"] if done < of_all else []


def _facts(design: ExperimentDesign, budgets: Mapping[tuple[str, str], int]) -> list[str]:
    """What is needed to reproduce the experiment."""
    ends = f"with {design.finishes} finishes or" if design.finishes else "with"
    steps = ", ".join(f"{world} {policy} {count:,}" for (world, policy), count in budgets.items())
    return [
        f"- spikedeploy {own()}; run folders in `{design.folder}`",
        f"- training seeds 0 to {design.seeds - 1}; of {' and '.join(CONTROLS)} the first "
        f"{design.controls}",
        f"- a training ends {ends} its budget of environment steps: {steps}",
        *(f"- `--set {setting}`" for setting in design.overrides),
        *(
            f"- ✗ {trial.name} was trained with other settings than its recipe has now: "
            + ", ".join(trial.changed_settings)
            for trial in design.trials()
            if trial.changed_settings
        ),
        "- every number: [learning.csv](kart/learning.csv), [driving.csv](kart/driving.csv), "
        "[finishes.csv](kart/finishes.csv)",
    ]


def verdicts(learned: Sequence[Record], driven: Sequence[Record]) -> list[str]:
    """A line for each target: whether it was reached, and the numbers."""
    lines = []
    for world in WORLDS:
        for place, policy in enumerate(NETWORKS):
            found = [row[NTH] for row in of(learned, world, policy)]
            if found:
                limit, median = 1000 * PEERS[world].nth[place], float(np.median(found))
                known = math.isfinite(median)
                text = f"{median / 1000:,.0f}k steps" if known else "more steps than its budget"
                lines.append(
                    _verdict(
                        median <= limit,
                        f"{world}, {policy}: {COUNT} finishes after {text} (median), "
                        f"kart-simulator {limit / 1000:,.0f}k",
                    )
                )
        ratio = share(learned, world)
        if ratio:
            text = f"{world}: the SNN reaches {ratio.mean:.0%} of the ANN (asked for {_NEAR:.0%})"
            lines.append(_verdict(ratio.mean >= _NEAR, text))
        apart = [abs(100 * row["success_difference_mean"]) for row in on_chip(driven, world)]
        if apart:
            text = f"{world}: chip and float twin differ by up to {max(apart):.0f} points"
            lines.append(_verdict(max(apart) <= _POINTS, text))
    return lines


def _verdict(reached: bool, text: str) -> str:
    return f"- {'✓' if reached else '✗'} {text}"


def _budget(design: ExperimentDesign, world: str, policy: str) -> int:
    """Environment steps that a training may take."""
    recipe = f"{world}-{policy}"
    return next(trial.config.steps for trial in design.trials() if trial.recipe == recipe)
