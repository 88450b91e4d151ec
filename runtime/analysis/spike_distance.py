"""Distances of spike trains, those of van Rossum, exact for spikes on a grid."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.analysis.activity import in_trains

Floats = NDArray[np.float64]

# [timesteps] time constant of the kernel
TAU = 5.0


def van_rossum(one: NDArray[Any], other: NDArray[Any], tau: float = TAU) -> Floats:
    """Distance D**2 (B, N) of spike trains (B, T, N), by (van Rossum 2001, eq. 3).

        f(t) = sum over spikes of H(t - t_i) exp(-(t - t_i) / tau)
        D**2 = 1/tau integral from 0 to infinity of (f(t) - g(t))**2 dt

    A spike more or less is 1/2; two that are far apart are 1; as tau vanishes, D**2 is half the
    number of spikes that differ.

    tau: [timesteps].
    """
    more = one.astype(np.float64) - other.astype(np.float64)
    decay_factor = np.exp(-1.0 / tau)
    apart = np.zeros(more[:, 0].shape)
    total = np.zeros_like(apart)
    for t in range(more.shape[1]):
        # e = e exp(-1/tau) + difference     D^2 += e^2 (1 - exp(-2/tau)) / 2
        apart = decay_factor * apart + more[:, t]
        total += apart**2 * (1 - decay_factor**2) / 2
    # what is left decays for ever: e^2 exp(-2/tau) / 2
    return np.asarray(total + apart**2 * decay_factor**2 / 2)


def mean_distance(
    one: NDArray[Any], other: NDArray[Any], tau: float = TAU, trains: Sequence[int] = ()
) -> float:
    """Mean over inferences and neurons of the distance of spike trains (B, T, N).

    trains: numbers of successive inferences that are one train; empty where each is its own.
    """
    if not trains:
        return float(van_rossum(one, other, tau).mean())
    parts = zip(in_trains(one, trains), in_trains(other, trains), strict=True)
    # a train of several inferences has the sum of their distances
    total = sum(van_rossum(*part, tau).sum() for part in parts)
    return float(total / (one.shape[0] * one.shape[2]))
