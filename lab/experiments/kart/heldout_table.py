"""Finish shares on tracks that were not trained on: table, and means with their intervals."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lab.experiments.kart.design import CORRIDOR, DEFAULT, POLICIES, WORLDS
from lab.experiments.kart.heldout import TRACKS
from lab.experiments.kart.records import Record
from spikedeploy.comparison.statistics import Estimate, nested_ratio
from spikedeploy.comparison.statistics import share as wilson
from spikedeploy.reports.table import ABSENT, markdown_text

_TRAINED_ON = {DEFAULT: "big_S", CORRIDOR: "corridor-8"}
_RESAMPLES = 10_000

Shares = NDArray[np.float64]


def heldout_table(rows: Sequence[Record]) -> list[str]:
    """Markdown: the share of starts that finish, each driver on each track."""
    lines = [["world", "trained on", "driver", "seeds", *TRACKS]]
    for world in WORLDS:
        for preset in (CORRIDOR, DEFAULT):
            for policy in POLICIES:
                if found := _of(rows, world, policy, preset=preset):
                    chip = found[0]["chip"]
                    label = f"{policy} · {chip}" if chip else policy
                    lines.append([world, _TRAINED_ON[preset], label, *_cells(found)])
        for script in dict.fromkeys(
            row["policy"] for row in rows if row["seed"] is None and row["world"] == world
        ):
            lines += [[world, ABSENT, script, *_cells(_of(rows, world, script))]]
    return markdown_text(lines).splitlines()


def _cells(rows: Sequence[Record]) -> list[str]:
    """Number of trainings, then the share on each track."""
    trainings = {row["seed"] for row in rows} - {None}
    cells = [_cell([row for row in rows if row["track"] == track]) for track in TRACKS]
    return [f"{len(trainings)}" if trainings else ABSENT, *cells]


def _cell(rows: Sequence[Record]) -> str:
    if not rows:
        return ABSENT
    found = finish_share([row["finished"] for row in rows])
    low, high = found.ci95
    return f"{found.mean:.0%} [{100 * low:.0f}, {100 * high:.0f}]"


def finish_share(finished: Sequence[Sequence[int]]) -> Estimate:
    """The mean of (S, n) starts of S trainings, with an interval over trainings and starts.

    One training, or trainings that agree in every start, have Wilson's interval over the starts:
    resamples of equal values would have none.
    """
    each = np.asarray(finished, np.float64)
    if (each == each[0]).all():
        return wilson(each[0])
    return nested_ratio(each, np.ones(each.shape[1]), np.random.default_rng(0))


def on_unseen(rows: Sequence[Record], world: str, policy: str, preset: str = CORRIDOR) -> Shares:
    """The mean share (S,) over the unseen tracks, of each training; one of a script."""
    found = [r for r in _of(rows, world, policy, preset=preset) if r["unseen"]]
    return np.array(
        [
            np.mean([np.mean(r["finished"]) for r in found if r["seed"] == seed])
            for seed in dict.fromkeys(row["seed"] for row in found)
        ]
    )


def ratio_of_means(values: Shares, reference: Shares) -> Estimate | None:
    """Mean (n,) / mean of a reference (m,), with a bootstrap interval over both.

    None where the reference is 0.
    """
    if not values.size or not reference.size or not reference.mean():
        return None
    rng = np.random.default_rng(0)
    tops, bottoms = (
        each[rng.integers(each.size, size=(_RESAMPLES, each.size))].mean(axis=1)
        for each in (values, reference)
    )
    ratios = tops[bottoms > 0] / bottoms[bottoms > 0]
    low, high = np.quantile(ratios, (0.025, 0.975))
    return Estimate(float(values.mean() / reference.mean()), (float(low), float(high)))


def _of(rows: Sequence[Record], world: str, policy: str, preset: str | None = None) -> list[Record]:
    """The rows of a driver, on all tracks."""
    return [
        row
        for row in rows
        if (row["world"], row["policy"]) == (world, policy)
        and (preset is None or row["preset"] == preset)
    ]
