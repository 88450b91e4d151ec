"""Learning curves from the metrics of a run."""

from dataclasses import dataclass
from pathlib import Path

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.metrics import read

_SIGNALS = {
    "eval_return": "validation",
    "episode_return": "training",
}  # in this order


@dataclass(frozen=True)
class Curve:
    """The returns of one run over its training.

    name     of the run
    unit     of its steps: "environment steps" or "updates"
    signal   "validation" or "training"
    steps    (n,) [unit]
    returns  (n,)
    """

    name: str
    unit: str
    signal: str
    steps: tuple[float, ...]
    returns: tuple[float, ...]


def curve(metrics: Path, name: str) -> Curve:
    """The learning curve in a run's metrics.csv, whose first column counts its steps."""
    rows = read(metrics)
    unit = next(iter(rows[0])) if rows else ""
    for column, signal in _SIGNALS.items():
        points = [(row[unit], row[column]) for row in rows if column in row]
        if points:
            steps, returns = zip(*points, strict=True)
            return Curve(name, counted_by(unit), signal, steps, returns)
    raise ConfigError(f"{metrics} has no returns yet: train on")


def counted_by(column: str) -> str:
    """What the first column of metrics counts, in words."""
    return column.replace("env_", "environment ").replace("_", " ")
