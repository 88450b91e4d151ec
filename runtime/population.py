"""Population coding: a number becomes the spikes of neurons with Gaussian receptive fields."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from runtime.errors import ArtifactError
from runtime.patterns import spike_pattern
from runtime.record import Record, Tree
from runtime.xorshift import Xorshift


@dataclass(frozen=True, eq=False)
class PopulationEncoder:
    """P neurons for each observed number, spiking deterministically (Tang et al. 2020, PopSAN).

    mean: (obs, P) centre of each receptive field, in units of the normalised observation.
    std: (obs, P) its width.
    threshold: membrane above which a neuron spikes and loses that much (soft reset).
    """

    kind: ClassVar[str] = "population"

    mean: NDArray[np.floating]
    std: NDArray[np.floating]
    threshold: float = 0.999

    def __post_init__(self) -> None:
        if self.mean.ndim != 2 or self.mean.shape != self.std.shape:
            raise ArtifactError(
                "population encoder: mean and std must both have shape (obs, P), found "
                f"{self.mean.shape} and {self.std.shape}. Export the policy again."
            )
        if not (np.isfinite(self.mean).all() and (self.std > 0).all() and self.threshold > 0):
            raise ArtifactError(
                "population encoder: mean must be finite, std and threshold above 0, found "
                f"{self.mean.max()}, {self.std.min()} and {self.threshold}. "
                "Export the policy again."
            )

    @property
    def observed(self) -> int:
        """Numbers taken in: obs."""
        return int(self.mean.shape[0])

    @property
    def width(self) -> int:
        """Neurons: M = obs * P; neuron i * P + p is the p-th of observation i."""
        return int(self.mean.size)

    @property
    def random(self) -> bool:
        """Whether the same observation may spike otherwise next time."""
        return False

    def encode(
        self, x: NDArray[np.floating], timesteps: int, dice: Xorshift | None = None
    ) -> NDArray[np.uint8]:
        """Spikes (B, T, M) of the normalised observations x (B, obs); no dice are thrown."""
        spikes = spike_pattern(self._drive(x), self.threshold, timesteps)
        return np.asarray(spikes.swapaxes(0, 1))

    def astype(self, dtype: DTypeLike) -> "PopulationEncoder":
        """The same encoder computing in another float type."""
        return PopulationEncoder(self.mean.astype(dtype), self.std.astype(dtype), self.threshold)

    def to_record(self) -> Tree:
        """What the file stores."""
        return {
            "mean": self.mean.astype(np.float64),
            "std": self.std.astype(np.float64),
            "threshold": self.threshold,
        }

    @classmethod
    def from_record(cls, record: Record) -> "PopulationEncoder":
        """The encoder that a file holds."""
        record.only("kind", "mean", "std", "threshold")
        return cls(record.array("mean"), record.array("std"), record.number("threshold"))

    def _drive(self, x: NDArray[np.floating]) -> NDArray[np.floating]:
        """Stimulation A (B, M), the same in every timestep."""
        # A = exp(-1/2 ((x - mean) / std)^2)
        drive = x[:, :, None] - self.mean
        drive /= self.std
        drive *= drive
        drive *= -0.5
        np.exp(drive, out=drive)
        return drive.reshape(len(x), -1)
