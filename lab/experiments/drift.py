"""What quantisation costs the shipped policies: spikes, actions and returns on loihi1.

    python -m lab drift [-o results/drift.md] [--policies hexapod/popsan,kart-grid/snn]
                               [--episodes 5] [--steps 200]

Every policy is quantised in every way: weights of 8 to 2 bits, a scale for each layer or for each
neuron, rounded to nearest or truncated, as it is, tuned, or with few thresholds. Spikes and actions
are compared with the float twin's on what that observed on seeds from 10,000 on, and tuning uses
seeds from 5,000 on. The returns are those of closed loops on the chip, on the same seeds as the
float twin's.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.experiments.drift_page import (
    BITS,
    FEW,
    HEAD,
    ROOM,
    ROOM_HEADS,
    Outcome,
    Subject,
    Way,
    markdown,
    section,
    summary,
)
from lab.experiments.parts import command_line
from spikedeploy.emulation.drift import observed_inputs
from spikedeploy.envs.rollout import rollout
from spikedeploy.files import write_text
from spikedeploy.make_env import make_env
from spikedeploy.policies.registry import Candidate, find
from spikedeploy.runtime.analysis.activity import chip_activity
from spikedeploy.runtime.analysis.calibration import tuned
from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import RuleError
from spikedeploy.seeds import EVALUATION, VALIDATION

POLICIES = "hexapod/popsan,kart-grid/snn,kart-gazebo/snn,kart-steer/snn"
PLAYED = 4  # episodes from which observations come


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--policies", default=POLICIES)
    parser.add_argument("--episodes", type=int, default=5)
    parser.add_argument("--steps", type=int, default=200)
    given = parser.parse_args()
    subjects = [subject(name, given.episodes, given.steps) for name in given.policies.split(",")]
    outcomes = [[outcome(each, way) for way in ways()] for each in subjects]
    head = HEAD.format(command=command_line())
    sections = [section(of, found) for of, found in zip(subjects, outcomes, strict=True)]
    rooms = markdown(ROOM_HEADS, [row for of in subjects for row in room(of)])
    text = "\n".join([head, summary(outcomes), ROOM, f"{rooms}\n", *sections])
    if given.output:
        write_text(given.output, text)
    else:
        print(text)


def ways() -> list[Way]:
    """Every way to quantise; tuning is searched for where weights are rounded to nearest."""
    return [
        Way(bits, *choice)
        for bits in BITS
        for choice in (
            ("layer", "nearest"),
            ("layer", "truncate"),
            ("layer", "nearest", True),
            ("channel", "nearest"),
            ("channel", "truncate"),
            ("channel", "nearest", True),
            ("channel", "nearest", False, FEW),
        )
    ]


def subject(name: str, episodes: int, steps: int) -> Subject:
    """The policy, what its float twin observed, and its returns."""
    candidate = find(name)
    artifact = load(candidate.path)
    tuning, measuring = (
        observed_inputs(artifact, candidate, None, range(first, first + PLAYED), steps)
        for first in (VALIDATION.start, EVALUATION)
    )
    seeds = range(EVALUATION, EVALUATION + episodes)
    returns = closed_loop(candidate, artifact, None, Quantisation(), seeds)
    return Subject(name, candidate, artifact, tuning, measuring, seeds, returns)


def closed_loop(
    candidate: Candidate,
    artifact: Artifact,
    on: Chip | None,
    quantisation: Quantisation,
    seeds: Sequence[int],
) -> NDArray[np.float64]:
    """Returns (n,) of episodes on the chip, or of the float twin."""
    world: Any = make_env(candidate.env or "", {})
    options: dict[str, Any] = {} if on is None else {"quantisation": quantisation}
    player = SpikingController(artifact, on, "none", **options)
    returns = [rollout(world, player, seed).total for seed in seeds]
    world.close()
    return np.array(returns)


def outcome(of: Subject, way: Way) -> Outcome:
    """Measure one way to quantise a policy."""
    say(f"{of.name}: {' '.join(way.cells)}")
    on = chip("loihi1", weight_bits=way.bits)
    quantisation = Quantisation(
        way.granularity,  # type: ignore[arg-type]
        way.rounding,  # type: ignore[arg-type]
        thresholds=way.thresholds,
    )
    try:
        if way.tuned:
            quantisation = tuned(of.artifact, on, of.tuning.raster, quantisation)
        found = drift(of.artifact, on, of.measuring.raster, quantisation)
    except RuleError as error:
        return Outcome(way, None, None, str(error))
    returns = closed_loop(of.candidate, of.artifact, on, quantisation, of.seeds)
    return Outcome(way, found, returns)


def room(of: Subject) -> list[list[str]]:
    """What proven headroom and scales of neurons would ask of the chip: rows of a table."""
    rows = []
    for granularity in ("layer", "channel"):
        plain, proven = (
            compile_program(
                of.artifact, chip("loihi1"), Quantisation(granularity, headroom=headroom)
            )
            for headroom in ("none", "proven")
        )
        lost = sum(chip_activity(plain, of.measuring.raster).saturations.values())
        pairs = list(zip(plain.layers, proven.layers, strict=True))
        coarser = [np.max(np.asarray(b.scale) / np.asarray(a.scale)) for a, b in pairs]
        distinct = [len(np.unique(layer.threshold)) for layer in plain.layers]
        rows.append(
            [
                of.name,
                granularity,
                str(lost),
                ", ".join(f"{times:.2f}" for times in coarser),
                ", ".join(map(str, distinct)),
            ]
        )
    return rows


def say(line: str) -> None:
    """Tell whoever waits."""
    print(line, file=sys.stderr)
