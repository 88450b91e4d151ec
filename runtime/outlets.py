"""What leaves a chip where it is more than one readout of one layer: computed by the host."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.ports import Port

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tap:
    """What an Output node hears of one layer.

    layer: name.
    weight: (N, act) axon-major; None passes the spikes on as they are.
    lag: [timesteps] by which it trails the spikes.
    """

    layer: str
    weight: Floats | None
    lag: int


@dataclass(frozen=True, eq=False)
class Outlet:
    """One Output node.

    port: its name and shape.
    taps: what it hears.
    bias: (act,) added in every timestep.
    """

    port: Port
    taps: tuple[Tap, ...]
    bias: Floats


def leaving(outlets: Sequence[Outlet], spikes: Mapping[str, NDArray[Any]]) -> Floats:
    """Output (B, T, act) of all outlets side by side, from the spikes (B, T, N) of each layer."""
    return np.concatenate([_heard(outlet, spikes) for outlet in outlets], axis=2)


def _heard(outlet: Outlet, spikes: Mapping[str, NDArray[Any]]) -> Floats:
    batch, timesteps, _ = spikes[outlet.taps[0].layer].shape
    output = np.zeros((batch, timesteps, outlet.port.size)) + outlet.bias
    for tap in outlet.taps:
        rows = spikes[tap.layer][:, : max(0, timesteps - tap.lag)].astype(np.float64)
        output[:, timesteps - rows.shape[1] :] += rows if tap.weight is None else rows @ tap.weight
    return output
