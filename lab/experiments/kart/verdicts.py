"""Sentences of the kart page: each target, whether it was reached, and the numbers."""

import math
from collections.abc import Sequence

import numpy as np

from lab.experiments.kart.design import (
    COUNT,
    GREEDY,
    LEARNING,
    NETWORKS,
    PEERS,
    PRESETS,
    WORLDS,
)
from lab.experiments.kart.heldout_table import on_unseen, ratio_of_means
from lab.experiments.kart.records import HELD, NTH, Record
from lab.experiments.kart.tables import AnnShare, of, on_chip, share, taken

_NEAR = 0.95  # of the ANN: what an SNN is asked to reach
_SOME = 0.05  # of the starts on other tracks, below which an ANN is nothing to be compared with
_POINTS = 2  # of the finish rate that the chip may differ from the float twin


def learning_verdicts(learned: Sequence[Record]) -> list[str]:
    """Steps beside kart-simulator's, and the SNN beside the ANN, for each preset and world."""
    lines = []
    for preset in PRESETS:
        rows = [row for row in learned if row["preset"] == preset]
        for world in WORLDS:
            if preset in LEARNING:  # as kart-simulator's
                for policy in NETWORKS:
                    lines += _finishes(rows, f"{preset}, {world}", world, policy)
            for field, what in ((NTH, f"{COUNT} finishes"), (HELD, f"greedy {GREEDY:.0%}")):
                found = share(rows, world, "snn", field)
                lines += _near(found, f"{preset}, {world}", f"in steps to {what}")
                lines += [] if found else _came_to(rows, preset, world, field, what)
    return lines


def _finishes(rows: Sequence[Record], where: str, world: str, policy: str) -> list[str]:
    found = of(rows, world, policy)
    if not found:
        return []
    limit, median = 1000 * PEERS[world].nth[policy], float(np.median([row[NTH] for row in found]))
    known = math.isfinite(median)
    text = f"{median / 1000:,.0f}k steps" if known else "more steps than it was trained"
    # of a training that ended without, it is only known that it takes longer
    mark = "✓" if median <= limit else "✗" if np.median(taken(found, NTH)) > limit else "≈"
    return [
        f"- {mark} {where}, {policy}: {COUNT} finishes after {text} (median), "
        f"kart-simulator {limit / 1000:,.0f}k"
    ]


def _came_to(rows: Sequence[Record], preset: str, world: str, field: str, what: str) -> list[str]:
    """How many trainings of both came so far, where that leaves no share; empty without any."""
    found = {
        each: [math.isfinite(row[field]) for row in of(rows, world, each)] for each in NETWORKS
    }
    if not all(found.values()):
        return []
    said = ", ".join(f"{sum(came)} of {len(came)} {each}" for each, came in found.items())
    return [f"- ≈ {preset}, {world}: trainings that came to {what}: {said}; no share of steps"]


def _near(found: AnnShare | None, where: str, what: str) -> list[str]:
    """Whether the SNN comes near the ANN; its interval says whether that can be told."""
    if found is None:
        return []
    text = f"{where}: the SNN reaches {found} of the ANN {what} (asked for: at least {_NEAR:.0%})"
    mark = found.mark(_NEAR)
    return [f"- {mark} {text}" + ("; the interval is on both sides" if mark == "≈" else "")]


def chip_verdicts(driven: Sequence[Record]) -> list[str]:
    """Chip beside float twin, for each preset and world."""
    lines = []
    for preset in PRESETS:
        rows = [row for row in driven if row["preset"] == preset]
        for world in WORLDS:
            chips = on_chip(rows, world)
            apart = [abs(100 * row["success_difference_mean"]) for row in chips]
            if any(apart) or any(row["success_rate"] for row in chips):  # else neither drives
                text = (
                    f"chip and float twin differ by up to {max(apart):.0f} points of the finish "
                    f"rate (asked for: at most {_POINTS})"
                )
                lines.append(_verdict(max(apart) <= _POINTS, f"{preset}, {world}: {text}"))
    return lines


def heldout_verdicts(rows: Sequence[Record]) -> list[str]:
    """On tracks that nothing was trained on: networks beside the script, the SNN beside the ANN."""
    lines = []
    for world in WORLDS:
        shares = {policy: on_unseen(rows, world, policy) for policy in NETWORKS}
        script = [
            np.mean(row["finished"])
            for row in rows
            if (row["world"], row["policy"], row["unseen"]) == (world, "gap", True)
        ]
        for policy, found in shares.items():
            if found.size and script:
                text = (
                    f"held-out tracks, {world}: {policy}, trained in corridors, finishes "
                    f"{found.mean():.0%} of the starts (mean over tracks and trainings), the gap "
                    f"follower {np.mean(script):.0%}"
                )
                lines.append(_verdict(bool(found.mean() > np.mean(script)), text))
        if shares["ann"].size and shares["ann"].mean() >= _SOME:
            ratio = ratio_of_means(shares["snn"], shares["ann"])
            near = None if ratio is None else AnnShare(ratio)
            lines += _near(near, f"held-out tracks, {world}", "in finished starts")
    return lines


def _verdict(reached: bool, text: str) -> str:
    return f"- {'✓' if reached else '✗'} {text}"
