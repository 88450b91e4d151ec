"""Delta coding (send-on-delta): a number becomes events that encode how far it has moved.

All of it is integer arithmetic after one rounding, so that float64, float32 and fixed point send
the same events unless 256 x / step lies within rounding error of halfway between two integers.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.codec.encoder import Encoder
from spikedeploy.runtime.copies import Copyable
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.metadata import INFINITE

Code = Literal["unary", "one-hot"]
PARTS = 256  # of a step: what an observation is rounded to
_MOST = 256  # events of one observation in a timestep; the table grows with its square
LARGEST = 2**30  # parts of a step; numbers beyond are clipped, so that no integer overflows


class Levels(Copyable):
    """The levels q of a batch of robots: the events sent since the episode began, with their signs.

    sent: (B, obs) int64; None before the first observations, which decide B.
    """

    def __init__(self) -> None:
        self.sent: NDArray[np.int64] | None = None

    def read(self, robots: int, observed: int) -> NDArray[np.int64]:
        """The levels (B, obs) of B robots, 0 at the beginning."""
        if self.sent is None:
            return np.zeros((robots, observed), np.int64)
        if len(self.sent) != robots:
            raise ObservationError(
                f"delta encoder: it holds the levels of {len(self.sent)} robots, the observations "
                f"are of {robots}. Call reset() between batches of different size."
            )
        return self.sent


@dataclass(frozen=True, eq=False)
class DeltaEncoder(Encoder):
    """Signed events when an observation has moved since the last event; the residual is kept.

        X = rint(256 x / step)                                          within +-2^30
        e = X - 256 q                              q: the level, 0 when an episode starts
        n = sign(e) min((|e| + 128) >> 8, most)    where |e| > threshold, else 0
        q = q + n

    step: (obs,) in units of the normalised observation; one of infinity never sends.
    most: K, largest number of events of one observation in a timestep, 1 to 256.
    code: which of the K channels of a sign spike: "unary": the first |n|; "one-hot": the |n|-th.
    threshold: distance from the level above which events are sent [1/256 steps], 128 to 256 K.

    Raises ArtifactError where these are of another kind, shape or size.
    """

    kind: ClassVar[str] = "delta"

    step: NDArray[np.floating] = field(metadata=INFINITE)
    most: int = 3
    code: Code = "unary"
    threshold: int = 154

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.step.ndim != 1 or not (self.step > 0).all():
            found = f"{self.step.min()}" if self.step.ndim == 1 else f"shape {self.step.shape}"
            raise self.wrong(f"step must have shape (obs,) and be above 0, found {found}")
        if not 1 <= self.most <= _MOST:
            raise self.wrong(f"most must be from 1 to {_MOST}, found {self.most}")
        if not PARTS // 2 <= self.threshold <= PARTS * self.most:
            most = f"{PARTS // 2} to {PARTS * self.most} (256ths of a step)"
            raise self.wrong(f"threshold must be from {most}, found {self.threshold}")

    @property
    def observed(self) -> int:
        """Numbers of an observation: obs."""
        return int(self.step.size)

    @property
    def width(self) -> int:
        """Neurons: M = obs * 2 K; (2 i + (n < 0)) K + (k - 1) is the k-th of a sign of i."""
        return 2 * self.most * self.observed

    @property
    def remembers(self) -> bool:
        """True: the spikes depend on the observations before."""
        return True

    def start(self, seed: int) -> Levels:
        """Levels of 0; the seed changes nothing."""
        return Levels()

    def encode(
        self, x: NDArray[np.floating], timesteps: int, state: Levels | None = None
    ) -> NDArray[np.uint8]:
        """Spikes (B, T, M) of the normalised observations x (B, obs).

        state: the levels, which are moved; None for those of an episode's beginning.
        """
        rows = _channels(self.most, self.code).take(self.events(x, timesteps, state), axis=0)
        return rows.reshape(len(x), timesteps, -1)

    def events(
        self, x: NDArray[np.floating], timesteps: int, state: Levels | None = None
    ) -> NDArray[np.int64]:
        """Signed numbers n (B, T, obs) of events, and the levels moved; as `encode`."""
        levels = state or self.start(0)
        sent = levels.read(*x.shape)
        table = _events(self.most, self.threshold)
        parts = self._parts(x)
        parts += len(table) // 2
        found = np.empty((timesteps, *x.shape), np.int64)
        for events in found:
            # clipped, e is an index of the table
            table.take(parts - PARTS * sent, mode="clip", out=events)
            sent = sent + events
        levels.sent = sent
        return np.asarray(found.swapaxes(0, 1))

    def _parts(self, x: NDArray[np.floating]) -> NDArray[np.int64]:
        """Observations X (B, obs) of normalised ones, rounded to halves even [1/256 steps]."""
        with np.errstate(over="ignore"):  # what is clipped anyway
            parts = x / self.step
            parts *= PARTS
        # np.clip takes three times as long at batch 1
        np.minimum(parts, LARGEST, out=parts)
        np.maximum(parts, -LARGEST, out=parts)
        np.rint(parts, out=parts)
        return parts.astype(np.int64)


@lru_cache(maxsize=16)
def _events(most: int, threshold: int) -> NDArray[np.int64]:
    """Signed numbers n of events at the distances e from -256 K - 1 to 256 K + 1, the ends too."""
    apart = np.arange(-PARTS * most - 1, PARTS * most + 2)
    far = np.abs(apart)
    # n = sign(e) min((|e| + 128) >> 8, K)    where |e| > threshold
    events = np.sign(apart) * np.minimum((far + PARTS // 2) >> 8, most)
    return np.where(far > threshold, events, 0)


@lru_cache(maxsize=16)
def _channels(most: int, code: Code) -> NDArray[np.uint8]:
    """Spikes (2 K + 1, 2 K) of n = 0 to K events, then of -K to -1, as n counts from the end."""
    k = np.arange(1, most + 1)
    n = np.concatenate([np.arange(most + 1), np.arange(-most, 0)])[:, None, None]
    sign = np.array([[1], [-1]])
    spikes = n * sign >= k if code == "unary" else n * sign == k
    rows: NDArray[np.uint8] = spikes.reshape(2 * most + 1, -1).astype(np.uint8)
    return rows
