"""Finishes against environment steps: a panel for each preset and world, median and range."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lab.experiments.finishes import Steps, finished_by
from lab.experiments.kart.design import (
    COUNT,
    LEARNING,
    NETWORKS,
    PEERS,
    WORLDS,
    ExperimentDesign,
    recipe,
)
from spikedeploy.reports.plots import BLUE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = dict(zip(NETWORKS, (BLUE, VERMILION), strict=True))
_NAMES = {"ann": "float ANN", "snn": "SNN"}
_POINTS = 400  # of a line


def finishes_figure(design: ExperimentDesign) -> "Figure":
    """All complete trainings of the two networks."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7.0), layout="constrained")
    panels = figure.subplots(len(LEARNING), len(WORLDS), sharey=True, squeeze=False)
    for preset, row in zip(LEARNING, panels, strict=True):
        for world, axes in zip(WORLDS, row, strict=True):
            _panel(axes, design, preset, world)
        row[0].set_ylabel(f"finished episodes of training, up to {COUNT}")
    named = {name: line for axes in panels.flat for line, name in zip(*_legend(axes), strict=True)}
    figure.legend(
        named.values(), named.keys(), loc="outside upper center", ncols=len(named), frameon=False
    )
    return figure


def _panel(axes: "Axes", design: ExperimentDesign, preset: str, world: str) -> None:
    from matplotlib.ticker import EngFormatter

    for policy in NETWORKS:
        name = recipe(preset, world, policy)
        trials = [t for t in design.trials() if t.recipe == name and t.trained]
        lengths = [float(trial.counters["env_steps"]) for trial in trials]
        if trials:
            _curve(axes, [trial.finishes for trial in trials], lengths, policy)
        axes.plot(
            1000 * PEERS[world].nth[policy], COUNT, "x", color=_COLOURS[policy], clip_on=False,
            zorder=5, label=f"kart-simulator's {policy.upper()}",
        )  # fmt: skip
    axes.set_title(f"{world}, {preset}", loc="left", fontsize=11, pad=10)
    axes.set_xlabel("environment steps")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.set_ylim(0, COUNT)
    axes.set_xlim(left=0)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E8EB")


def _legend(axes: "Axes") -> tuple[list[Any], list[Any]]:
    """Artists and their names."""
    artists, names = axes.get_legend_handles_labels()
    return artists, names


def _curve(axes: "Axes", runs: Sequence[Steps], lengths: Sequence[float], policy: str) -> None:
    grid, counts = counted(runs, lengths)
    axes.fill_between(
        grid,
        counts.min(axis=0),
        counts.max(axis=0),
        color=_COLOURS[policy],
        alpha=0.18,
        linewidth=0,
    )
    label = f"{_NAMES[policy]}: median and range"
    axes.plot(grid, np.median(counts, axis=0), color=_COLOURS[policy], linewidth=1.8, label=label)


def counted(runs: Sequence[Steps], lengths: Sequence[float]) -> tuple[Steps, NDArray[np.int64]]:
    """A grid of steps (POINTS,), and the finishes of each run there, at most COUNT (n, POINTS).

    The grid ends where every run has COUNT finishes, or where the shortest run without them ends.
    """
    ends = [r[COUNT - 1] if len(r) >= COUNT else math.inf for r in runs]
    short = [length for length, end in zip(lengths, ends, strict=True) if math.isinf(end)]
    last = min(short) if short else max(ends)
    grid = np.linspace(0, last, _POINTS)
    return grid, np.stack([np.minimum(finished_by(run, grid), COUNT) for run in runs])
