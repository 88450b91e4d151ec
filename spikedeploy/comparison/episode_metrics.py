"""Metrics of an episode from its step infos.

Adding a metric is one line in `WALKING` or `DRIVING`; one whose signal an environment
does not report is left out of its rows. `measure_named` reduces numbers that the user names.
"""

import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ConfigError

Signal = NDArray[np.float64]


@dataclass(frozen=True)
class _Metric:
    """One number of an episode.

    name: field of a report's rows
    signal: key of the step infos that it is made from
    reduce: key of _OF_OURS
    title: head of its column, with its unit
    meaning: what it is, for a report
    form: format specification of a cell
    unless: a signal in whose presence the metric does not apply
    after: a signal that must be raised at the last control step for the metric to apply
    """

    name: str
    signal: str
    reduce: str
    title: str
    meaning: str
    form: str
    unless: str | None = None
    after: str | None = None

    def applies(self, infos: Mapping[str, Signal]) -> bool:
        """Return True if an episode with these infos, each (S,), has the metric."""
        present = self.signal in infos and self.unless not in infos
        return present and (self.after is None or bool(infos[self.after][-1]))


REDUCTIONS: dict[str, Callable[[Signal], Any]] = {
    "mean": np.mean,
    "last": lambda signal: signal[-1],
    "max": np.max,
}
_OF_OURS: dict[str, Callable[[Signal], Any]] = {
    **REDUCTIONS,
    "mean size": lambda signal: np.abs(signal).mean(),
    "root mean square": lambda signal: np.sqrt(np.square(signal).mean()),
    "ever": np.any,  # 1 if the signal is raised at any control step, else 0
}

WALKING = (
    _Metric("speed", "speed", "mean", "m/s", "mean forward speed [m/s]", ".3f"),
    _Metric("cot", "cot", "last", "CoT", "cost of transport: energy / (m g distance)", ".2f"),
    _Metric("heading_error", "heading", "mean size", "heading",
            "mean absolute heading [rad]; straight ahead is 0", ".3f", unless="turn_error"),
    _Metric("speed_rmse", "speed_error", "root mean square", "speed err.",
            "RMSE of the forward speed to the command [m/s]", ".3f"),
    _Metric("turn_rmse", "turn_error", "root mean square", "turn err.",
            "RMSE of the turn rate to the command [rad/s]", ".3f"),
    _Metric("falls", "fall", "ever", "falls", "episodes with a fall", ".0%"),
)  # fmt: skip
DRIVING = (
    _Metric("lap_time", "lap_time", "last", "lap [s]", "time of the finished episodes [s]", ".2f",
            after="finish"),
    _Metric("crashes", "crash", "ever", "crashes", "episodes that end at a wall", ".0%"),
    _Metric("stalls", "stalled", "ever", "stalls", "episodes that end without progress", ".0%"),
    _Metric("gates", "gates", "last", "gates", "gates passed, in order", ".1f"),
    _Metric("speed", "speed", "mean", "px/s", "mean speed [px/s]; 100 px are 1 m", ".0f"),
)  # fmt: skip


def drives(signals: Iterable[str]) -> bool:
    """Return True if infos or rows with these names are a kart's, whose success is a finish."""
    return "gates" in signals


def metrics_of(signals: Iterable[str]) -> tuple[_Metric, ...]:
    """Return the metrics of the world whose infos or rows have these names."""
    return DRIVING if drives(signals) else WALKING


def measure(infos: Mapping[str, Signal]) -> dict[str, float]:
    """Return the metrics of one episode from its infos, each (S,)."""
    return {
        metric.name: float(_OF_OURS[metric.reduce](np.asarray(infos[metric.signal], np.float64)))
        for metric in metrics_of(infos)
        if metric.applies(infos)
    }


def measure_named(infos: Mapping[str, Signal], texts: Iterable[str]) -> dict[str, float]:
    """Return text `name:reduction` -> value, over the steps of the infos (S,) with that number."""
    found = {}
    for text in texts:
        name, _, reduction = text.rpartition(":")
        if name not in infos:
            close = difflib.get_close_matches(name, infos, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"numbers: {', '.join(infos)}"
            raise ConfigError(f"--metric {text}: no number {name!r} in the step infos; {hint}")
        known = infos[name][~np.isnan(infos[name])]
        found[text] = float(REDUCTIONS[reduction](known))
    return found
