"""Population coding: a number becomes the spikes of neurons with Gaussian receptive fields.

Each neuron integrates a constant drive, so its membrane never decreases when the drive increases as
long as the spikes before are the same. Hence every spike pattern over T timesteps belongs to one
interval of drives, and there are few patterns. Looking a drive up among the edges of the intervals
gives the same bits as integrating timestep by timestep, in a third of the time.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.codec.encoder import Encoder

Drives = NDArray[np.floating]

# longest inference with a table: the number of patterns grows with T * T
MAX_TABLE_TIMESTEPS = 64


@dataclass(frozen=True, eq=False)
class PopulationEncoder(Encoder):
    """P neurons for each observed number, spiking deterministically (Tang et al. 2020, PopSAN).

    mean: (obs, P) centre of each receptive field, in units of the normalised observation.
    std: (obs, P) its width, likewise.
    threshold: membrane above which a neuron spikes, and what a spike subtracts.

    Raises ArtifactError where these are not finite, not above 0, or of other shapes.
    """

    kind: ClassVar[str] = "population"

    mean: NDArray[np.floating]
    std: NDArray[np.floating]
    threshold: float = 0.999

    def __post_init__(self) -> None:
        if self.mean.ndim != 2 or self.mean.shape != self.std.shape:
            found = f"{self.mean.shape} and {self.std.shape}"
            raise self.wrong(f"mean and std must both have shape (obs, P), found {found}")
        if not (np.isfinite(self.mean).all() and (self.std > 0).all() and self.threshold > 0):
            found = f"{self.mean.max()}, {self.std.min()} and {self.threshold}"
            raise self.wrong(f"mean must be finite, std and threshold above 0, found {found}")

    @property
    def observed(self) -> int:
        """Numbers of an observation: obs."""
        return int(self.mean.shape[0])

    @property
    def width(self) -> int:
        """Neurons: M = obs * P; neuron i * P + p is the p-th of observation i."""
        return int(self.mean.size)

    def encode(
        self, x: NDArray[np.floating], timesteps: int, state: None = None
    ) -> NDArray[np.uint8]:
        """Spikes (B, T, M) of the normalised observations x (B, obs)."""
        spikes = spike_patterns(self._drive(x), self.threshold, timesteps)
        return np.asarray(spikes.swapaxes(0, 1))

    def _drive(self, x: NDArray[np.floating]) -> NDArray[np.floating]:
        """Drive A (B, M), the same in every timestep."""
        # A = exp(-1/2 ((x - mean) / std)^2)
        drive = x[:, :, None] - self.mean
        drive /= self.std
        drive *= drive
        drive *= -0.5
        np.exp(drive, out=drive)
        return drive.reshape(len(x), -1)


def spike_patterns(drive: Drives, threshold: float, timesteps: int) -> NDArray[np.uint8]:
    """Spikes (T, ...) of neurons under constant drives (...) from 0 to 1; see `integrate`."""
    if timesteps > MAX_TABLE_TIMESTEPS:
        return integrate(drive, threshold, timesteps)
    table = pattern_table(threshold, timesteps, drive.dtype.str)
    return np.asarray(table.spikes.take(table.edges.searchsorted(drive), axis=1))


def integrate(drive: Drives, threshold: float, timesteps: int) -> NDArray[np.uint8]:
    """Spikes (T, ...) of drives (...), timestep by timestep: the definition."""
    spikes = np.empty((timesteps, *drive.shape), np.bool_)
    membrane = drive.copy()
    for t in range(timesteps):
        if t:
            # v = (v - threshold * s) + A
            membrane -= threshold * spikes[t - 1]
            membrane += drive
        # s = v > threshold
        np.greater(membrane, threshold, out=spikes[t])
    return spikes.view(np.uint8)


@dataclass(frozen=True, eq=False)
class _PatternTable:
    """Every spike pattern of drives from 0 to 1; K patterns in the order of their drives.

    edges: (K - 1,) largest drive of each pattern but the last, increasing.
    spikes: (T, K).
    """

    edges: Drives
    spikes: NDArray[np.uint8]


@lru_cache(maxsize=16)
def pattern_table(threshold: float, timesteps: int, dtype: str) -> _PatternTable:
    """The table of a threshold, its edges bisected down to neighbouring floating-point numbers."""
    low, high = np.zeros(1, dtype), np.ones(1, dtype)
    parts = [np.empty(0, dtype)]
    while low.size:
        differ = _differ(low, high, threshold, timesteps)
        low, high = low[differ], high[differ]
        neighbours = np.nextafter(low, high) == high
        parts.append(low[neighbours])
        low, high = low[~neighbours], high[~neighbours]
        middle = low + (high - low) / 2
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
    edges = np.sort(np.concatenate(parts))
    one_drive_each = np.append(edges, np.ones(1, dtype))
    return _PatternTable(edges, integrate(one_drive_each, threshold, timesteps))


def _differ(low: Drives, high: Drives, threshold: float, timesteps: int) -> NDArray[np.bool_]:
    at_low, at_high = (integrate(ends, threshold, timesteps) for ends in (low, high))
    return np.asarray((at_low != at_high).any(axis=0))
