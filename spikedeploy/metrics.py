"""What an episode's step infos say about the robot, one number a metric.

Adding a metric is one line in `METRICS`; a metric whose signal an environment does not report is
left out of its rows.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Signal = NDArray[np.float64]


@dataclass(frozen=True)
class Metric:
    """One number of an episode.

    name      field of a report's rows
    signal    key of the step infos that it is made from
    reduce    (S,) -> number
    title     head of its column, with its unit
    meaning   what it is, for a report
    form      how a cell formats it
    unless    a signal in whose presence the metric means nothing
    """

    name: str
    signal: str
    reduce: Callable[[Signal], float]
    title: str
    meaning: str
    form: str
    unless: str | None = None


def last(signal: Signal) -> float:
    """The value at the last control step."""
    return float(signal[-1])


def mean(signal: Signal) -> float:
    """The mean over the control steps."""
    return float(signal.mean())


def mean_size(signal: Signal) -> float:
    """The mean of the absolute value over the control steps."""
    return float(np.abs(signal).mean())


def root_mean_square(signal: Signal) -> float:
    """The root of the mean square over the control steps."""
    return float(np.sqrt(np.square(signal).mean()))


def ever(signal: Signal) -> float:
    """1 if the signal was raised at any control step, else 0."""
    return float(signal.any())


METRICS = (
    Metric("speed", "speed", mean, "m/s", "mean forward speed [m/s]", ".3f"),
    Metric("cot", "cot", last, "CoT", "cost of transport: energy / (m g distance)", ".2f"),
    Metric(
        "heading_error",
        "heading",
        mean_size,
        "heading",
        "mean absolute heading [rad]; straight ahead is 0",
        ".3f",
        unless="turn_error",
    ),
    Metric(
        "speed_rmse",
        "speed_error",
        root_mean_square,
        "speed err.",
        "RMSE of the forward speed to the command [m/s]",
        ".3f",
    ),
    Metric(
        "turn_rmse",
        "turn_error",
        root_mean_square,
        "turn err.",
        "RMSE of the turn rate to the command [rad/s]",
        ".3f",
    ),
    Metric("falls", "fall", ever, "falls", "episodes with a fall", ".0%"),
)


def measure(infos: Mapping[str, NDArray[np.float64]]) -> dict[str, float]:
    """The metrics of one episode from its infos, each (S,)."""
    return {
        metric.name: metric.reduce(np.asarray(infos[metric.signal], dtype=np.float64))
        for metric in METRICS
        if metric.signal in infos and metric.unless not in infos
    }
