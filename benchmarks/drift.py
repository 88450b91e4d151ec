"""What quantisation costs the shipped policies: spikes, actions and returns on loihi1.

    python benchmarks/drift.py [-o results/drift.md] [--policies hexapod/popsan,kart-grid/snn]
                               [--episodes 10] [--steps 200]

Every policy is quantised in every way: weights of 8 to 2 bits, a scale for each layer or for each
neuron, rounded to nearest or truncated, as it is, tuned, or with few thresholds. Spikes and actions
are compared with the float twin's on what that observed on seeds from 10,000 on, and tuning uses
seeds from 5,000 on. The returns are those of closed loops on the chip, on the same seeds as the
float twin's.
"""

import prepare  # isort: skip  # noqa: F401 - before all others

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs.rollout import rollout
from runtime.artifact import Artifact, load
from runtime.calibration import tuned
from runtime.chip import Chip, chip
from runtime.controllers import SpikingController
from runtime.drift import Drift, drift
from runtime.errors import RuleError
from runtime.quantisation import Quantisation
from spikedeploy import drift_tables
from spikedeploy.inputs import Inputs, observed
from spikedeploy.policies import Candidate, find
from spikedeploy.seeds import EVALUATION, VALIDATION
from spikedeploy.statistics import paired_difference
from spikedeploy.worlds import made

POLICIES = "hexapod/popsan,kart-grid/snn,kart-gazebo/snn,kart-steer/snn"
BITS = (8, 6, 4, 3, 2)
FEW = 16  # thresholds that nengo-loihi lets a core hold
PLAYED = 4  # episodes from which observations come


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
    """A policy with what it heard.

    tuning, measuring  inputs
    returns            (n,) of its float twin
    """

    name: str
    candidate: Candidate
    artifact: Artifact
    tuning: Inputs
    measuring: Inputs
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
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--steps", type=int, default=200)
    given = parser.parse_args()
    subjects = [subject(name, given.episodes, given.steps) for name in given.policies.split(",")]
    outcomes = [[outcome(each, way) for way in ways()] for each in subjects]
    head = HEAD.format(command=" ".join(["python", *sys.argv]))
    sections = [section(of, found) for of, found in zip(subjects, outcomes, strict=True)]
    text = "\n".join([head, summary(outcomes) + "\n", *sections])
    if given.output:
        given.output.write_text(text, encoding="utf-8")
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
        observed(artifact, candidate, None, range(first, first + PLAYED), steps)
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
    world: Any = made(candidate.env or "", {})
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


def section(of: Subject, outcomes: Sequence[Outcome]) -> str:
    """A policy's tables."""
    inputs = f"Spikes and actions on {of.measuring.source}; tuned on {of.tuning.source}."
    twin = (
        f"The float twin returns {of.returns.mean():,.2f} on seeds {of.seeds[0]} to {of.seeds[-1]}."
    )
    layers = [layer.name for layer in first(outcomes).layers]
    heads = ("bits", "scale", "rounding", "tuned", *(f"distance {name}" for name in layers))
    rows = [cells(of, each) for each in outcomes]
    table = markdown((*heads, "output error", "return − float's [95 %]"), rows)
    return f"## {of.name}\n\n{inputs} {twin}\n\n{table}\n\n{rungs(outcomes)}\n"


def cells(of: Subject, each: Outcome) -> list[str]:
    """A row of a policy's table."""
    if each.drift is None or each.returns is None:
        return [*each.way.cells, each.why]
    output = each.drift.output
    error = f"{output.rms:.1%} other choices" if output.kind == "choice" else f"{output.rms:.4f}"
    form = "+,.0f" if abs(of.returns.mean()) > 1000 else "+,.2f"
    less = paired_difference(each.returns, of.returns, np.random.default_rng(0))
    return [
        *each.way.cells,
        *(f"{layer.distance:.4f}" for layer in each.drift.layers),
        error,
        f"{less.mean:{form}} [{less.ci95[0]:{form}}, {less.ci95[1]:{form}}]",
    ]


def rungs(outcomes: Iterable[Outcome]) -> str:
    """Which rounding costs what, of the plainest way at each number of bits."""
    plain = [
        each.drift
        for each in outcomes
        if each.drift is not None and each.way.cells[1:] == ("layer", "nearest", "")
    ]
    heads = ["rounding", *(f"distance, {bits} bits" for bits in BITS[: len(plain)])]
    rows = [
        [drift_tables.RUNGS[rung.name]]
        + [f"{np.mean(list(found.rungs[k].distance.values())):.5f}" for found in plain]
        for k, rung in enumerate(plain[0].rungs)
    ]
    said = "Mean distance of all layers, one scale for each, rounded to nearest:"
    return f"{said}\n\n{markdown(heads, rows)}"


def summary(all_of_them: Sequence[Sequence[Outcome]]) -> str:
    """How many times nearer or further a choice brings the spikes, everything else equal."""
    choices: dict[str, Callable[[Way], Way]] = {
        "channel / layer": lambda w: w if w.thresholds else replace(w, granularity="layer"),
        "truncate / nearest": lambda w: replace(w, rounding="nearest"),
        "tuned / as it is": lambda w: replace(w, tuned=False),
        f"{FEW} thresholds / any": lambda w: replace(w, thresholds=None),
    }
    rows = [
        [str(bits), *(ratio(all_of_them, bits, other) for other in choices.values())]
        for bits in BITS
    ]
    return markdown(["bits", *choices], rows)


def ratio(
    all_of_them: Sequence[Sequence[Outcome]], bits: int, without: Callable[[Way], Way]
) -> str:
    """Geometric mean over policies of the ratio of distances, with and without a choice."""
    logs = []
    for outcomes in all_of_them:
        by_way = {each.way: distance(each) for each in outcomes if each.drift is not None}
        for way, mine in by_way.items():
            theirs = by_way.get(without(way))
            if theirs and way.bits == bits and without(way) != way:
                logs.append(np.log(mine / theirs))
    return f"{np.exp(np.mean(logs)):.2f}" if logs else "–"


def distance(each: Outcome) -> float:
    """Mean distance of all layers."""
    found = each.drift
    return 0.0 if found is None else float(np.mean([layer.distance for layer in found.layers]))


def first(outcomes: Iterable[Outcome]) -> Drift:
    """The first drift that could be measured."""
    return next(each.drift for each in outcomes if each.drift is not None)


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def say(line: str) -> None:
    """Tell whoever waits."""
    print(line, file=sys.stderr)


HEAD = """# What quantisation costs

Written by `{command}`, which is what every number here comes from.

Distance is van Rossum's (time constant 5 timesteps, mean over inferences and neurons), in which a
spike more or less is 0.5; the float twin is 0. The chip is `loihi1`, with fewer stored bits of a
weight where the table says so. Tuned ways clip the largest weights and shift thresholds as
`runtime/calibration.py` finds best on other episodes.

## All policies

How many times the distance that a choice leaves, everything else equal; geometric mean over the
policies (below 1 is nearer to the float twin).
"""


if __name__ == "__main__":
    main()
