"""Event counts: events of a camera in a control step become spikes, one neuron for each pixel."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.codec.encoder import Encoder

_MOST = 255  # spikes of a neuron in a timestep, as rasters hold them


@dataclass(frozen=True, eq=False)
class EventEncoder(Encoder):
    """Counts of events to spikes.

        n = min(max(floor(x), 0), most)

    size: obs, counts of an observation, polarity after polarity.
    polarities: C of them, 1 or 2.
    most: K, the largest count that is distinguished.
    code: "channels": K channels a polarity, of which the k-th spikes where n >= k, in the first
        timestep; with K = 1 an event, or several, is one spike. "spread": one channel, which spikes
        in the first n timesteps. "counts": one channel, n spikes in the first timestep, for chips
        that take several.

    Raises ArtifactError where these contradict each other.
    """

    kind: ClassVar[str] = "events"

    size: int
    polarities: int = 2
    most: int = 1
    code: Literal["channels", "spread", "counts"] = "channels"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.polarities < 1 or self.size < 1 or self.size % self.polarities:
            raise self.wrong(f"{self.size} counts are not those of {self.polarities} polarities")
        if not 1 <= self.most <= _MOST:
            raise self.wrong(f"most must be 1 to {_MOST}, found {self.most}")

    @property
    def observed(self) -> int:
        """Counts: obs."""
        return self.size

    @property
    def width(self) -> int:
        """Neurons: M = K obs of code "channels", (c K + k - 1) obs / C + i; else obs."""
        return self.size * (self.most if self.code == "channels" else 1)

    def encode(
        self, x: NDArray[np.floating], timesteps: int, state: None = None
    ) -> NDArray[np.uint8]:
        """Spikes (B, T, M) of counts x (B, obs); no state is needed."""
        numbers = np.minimum(np.maximum(np.floor(x), 0), self.most).astype(np.uint8)
        spikes = np.zeros((len(x), timesteps, self.width), np.uint8)
        if self.code == "counts":
            spikes[:, 0] = numbers
        elif self.code == "spread":
            spikes[:] = numbers[:, None] > np.arange(timesteps)[:, None]
        else:
            levels = np.arange(1, self.most + 1)[:, None]
            grouped = numbers.reshape(len(x), self.polarities, 1, -1)
            spikes[:, 0] = (grouped >= levels).reshape(len(x), -1)
        return spikes
