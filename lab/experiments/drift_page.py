"""The page of lab/experiments/drift.py: its records as tables."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.comparison.statistics import paired_difference
from spikedeploy.emulation.drift import DriftInputs
from spikedeploy.policies.registry import Candidate
from spikedeploy.reports.drift import ABLATION_STEPS
from spikedeploy.runtime.analysis.drift import Drift
from spikedeploy.runtime.artifact.artifact import Artifact

BITS = (8, 6, 4, 2)
FEW = 16  # thresholds that nengo-loihi lets a core hold


ROOM_HEADS = (
    "policy",
    "scale",
    "saturations without headroom",
    "proven: steps coarser, at most",
    "distinct thresholds",
)
ROOM = """
## Headroom and thresholds

With 8-bit weights, layer by layer: what the inputs below overflow when nothing is left free, how
many times coarser the weights of the worst neuron become when it is proven that nothing can
overflow, and how many distinct thresholds there are.
"""
HEAD = """# What quantisation costs

Written by `{command}`, which is what every number here comes from.

Distance is van Rossum's (time constant 5 timesteps, mean over inferences and neurons), in which a
spike more or less is 0.5; the float twin is 0. The chip is `loihi1`, with fewer stored bits of a
weight where the table says so. Tuned ways clip the largest weights and shift thresholds as
`runtime/analysis/calibration.py` finds best on other episodes. What was learnt from these tables
stands in [docs/quantisation.md](../docs/quantisation.md#what-it-costs).

## All policies

How many times the distance that a choice leaves, everything else equal; geometric mean over the
policies (below 1 is nearer to the float twin).
"""


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
    return f"## {of.name}\n\n{inputs} {twin}\n\n{table}\n\n{ablation(outcomes)}\n"


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


def ablation(outcomes: Iterable[Outcome]) -> str:
    """Which rounding costs what, of the plainest way at each number of bits."""
    plain = [
        each.drift
        for each in outcomes
        if each.drift is not None and each.way.cells[1:] == ("layer", "nearest", "")
    ]
    heads = ["rounding", *(f"distance, {bits} bits" for bits in BITS[: len(plain)])]
    rows = [
        [ABLATION_STEPS[step.name]]
        + [f"{np.mean(list(found.ablation[k].distance.values())):.5f}" for found in plain]
        for k, step in enumerate(plain[0].ablation)
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
