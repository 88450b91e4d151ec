"""The cost of quantisation for the shipped policies: spikes, actions and returns on loihi1.

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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.experiments.pages import render
from lab.experiments.runner import command_line
from spikedeploy.comparison.statistics import paired_difference
from spikedeploy.emulation.drift import DriftInputs, observed_inputs
from spikedeploy.envs.rollout import rollout
from spikedeploy.make_env import make_env
from spikedeploy.policies.registry import Candidate, find
from spikedeploy.reports.drift import ABLATION_STEPS
from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.analysis.activity import chip_activity
from spikedeploy.runtime.analysis.calibration import tune_to_float
from spikedeploy.runtime.analysis.drift import Drift, drift
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.files import write_text
from spikedeploy.seeds import EVALUATION, VALIDATION

POLICIES = "hexapod/popsan,kart-grid/snn,kart-gazebo/snn,kart-steer/snn"
PLAYED = 4  # episodes from which observations come
BITS = (8, 6, 4, 2)
FEW = 16  # thresholds that nengo-loihi lets a core hold
Lines = list[list[str]]


@dataclass(frozen=True)
class Way:
    """One way to quantise."""

    bits: int
    granularity: str
    rounding: str
    tuned: bool = False
    thresholds: int | None = None

    @property
    def cells(self) -> tuple[str, ...]:
        """As a table names it."""
        most = "" if self.thresholds is None else f", {self.thresholds} thresholds"
        tuning = "yes" if self.tuned else ""
        return str(self.bits), f"{self.granularity}{most}", self.rounding, tuning


@dataclass(frozen=True)
class Subject:
    """A policy with its inputs.

    tuning, measuring  inputs
    returns            (n,) of its float twin
    """

    name: str
    candidate: Candidate
    artifact: Artifact
    tuning: DriftInputs
    measuring: DriftInputs
    seeds: Sequence[int]
    returns: NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """A way and what came of it; None where the chip cannot hold it, and why."""

    way: Way
    drift: Drift | None
    returns: NDArray[np.float64] | None
    why: str = ""


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
    text = page(command_line(), subjects, outcomes, [row for of in subjects for row in room(of)])
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
    print(f"{of.name}: {' '.join(way.cells)}", file=sys.stderr)
    on = chip("loihi1", weight_bits=way.bits)
    quantisation = Quantisation(
        way.granularity,  # type: ignore[arg-type]
        way.rounding,  # type: ignore[arg-type]
        thresholds=way.thresholds,
    )
    try:
        if way.tuned:
            quantisation = tune_to_float(of.artifact, on, of.tuning.raster, quantisation)
        found = drift(of.artifact, on, of.measuring.raster, quantisation)
    except RuleError as error:
        return Outcome(way, None, None, str(error))
    returns = closed_loop(of.candidate, of.artifact, on, quantisation, of.seeds)
    return Outcome(way, found, returns)


def room(of: Subject) -> Lines:
    """Rows of a table: demands of proven headroom and scales of neurons on the chip."""
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
        times = ", ".join(f"{each:.2f}" for each in coarser)
        rows.append([of.name, granularity, str(lost), times, ", ".join(map(str, distinct))])
    return rows


# the page


def page(
    command: str, subjects: Sequence[Subject], outcomes: Sequence[Sequence[Outcome]], rooms: Lines
) -> str:
    """All tables in Markdown."""
    pairs = zip(subjects, outcomes, strict=True)
    return render(
        "drift",
        command=command,
        summary=summary(outcomes),
        rooms=rooms,
        sections=[(of, found, _plain_drifts(found)) for of, found in pairs],
        less=less,
        error=error,
        mean=np.mean,
        steps=ABLATION_STEPS,
        BITS=BITS,
    )


def less(of: Subject, each: Outcome) -> str:
    """How much less an outcome returns than the float twin."""
    form = "+,.0f" if abs(of.returns.mean()) > 1000 else "+,.2f"
    return paired_difference(each.returns, of.returns, np.random.default_rng(0)).text(form)


def error(each: Drift) -> str:
    """The error of the actions."""
    output = each.output
    return f"{output.rms:.1%} other choices" if output.kind == "choice" else f"{output.rms:.4f}"


def _plain_drifts(outcomes: Iterable[Outcome]) -> list[Drift]:
    """Those of the plainest way at each number of bits, as far as they could be measured."""
    plain = (each for each in outcomes if each.way.cells[1:] == ("layer", "nearest", ""))
    return [each.drift for each in plain if each.drift is not None]


def summary(every: Sequence[Sequence[Outcome]]) -> Lines:
    """How many times nearer or further a choice brings the spikes, everything else equal."""
    choices: dict[str, Callable[[Way], Way]] = {
        "channel / layer": lambda w: w if w.thresholds else replace(w, granularity="layer"),
        "truncate / nearest": lambda w: replace(w, rounding="nearest"),
        "tuned / as it is": lambda w: replace(w, tuned=False),
        f"{FEW} thresholds / any": lambda w: replace(w, thresholds=None),
    }
    lines = [["bits", *choices]]
    return lines + [
        [str(bits), *(ratio(every, bits, other) for other in choices.values())] for bits in BITS
    ]


def ratio(every: Sequence[Sequence[Outcome]], bits: int, without: Callable[[Way], Way]) -> str:
    """Geometric mean over policies of the ratio of distances, with and without a choice."""
    logs = []
    for outcomes in every:
        distances = {
            each.way: float(np.mean([layer.distance for layer in each.drift.layers]))
            for each in outcomes
            if each.drift is not None
        }
        for way, mine in distances.items():
            theirs = distances.get(without(way))
            if theirs and way.bits == bits and without(way) != way:
                logs.append(np.log(mine / theirs))
    return f"{np.exp(np.mean(logs)):.2f}" if logs else ABSENT
