"""Drift of readout layers: their membranes on a chip against those of the float twin."""

from dataclasses import dataclass

import numpy as np

from spikedeploy.runtime.analysis.activity import Activity


@dataclass(frozen=True)
class ReadoutDrift:
    """How a readout layer's membranes differ from the float twin's.

    name: of the node.
    neurons: N.
    rms: root of the mean square of the differences [float units].
    range: largest magnitude in float [float units].
    filled: largest part of a register that a current or membrane took on these inputs; None where
        states are floats.
    saturations: numbers that did not fit a register.
    """

    name: str
    neurons: int
    rms: float
    range: float
    filled: float | None
    saturations: int


def readout_drifts(twin: Activity, seen: Activity) -> tuple[ReadoutDrift, ...]:
    """Of all readout layers on the chip.

    twin, seen: of the float twin and of the chip.
    """
    return tuple(_drift(name, twin, seen) for name in seen.membranes)


def _drift(name: str, twin: Activity, seen: Activity) -> ReadoutDrift:
    before, after = twin.membranes[name], seen.membranes[name]
    return ReadoutDrift(
        name=name,
        neurons=before.shape[2],
        rms=float(np.sqrt(np.mean((after - before) ** 2))),
        range=float(np.abs(before).max()),
        filled=seen.filled.get(name),
        saturations=seen.saturations[name],
    )
