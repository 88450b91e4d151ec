"""Rate coding: a number becomes the spike rate of one neuron, in the arithmetic of 8 bits.

Random bytes as a chip draws them: one xorshift32 generator for each neuron of each robot.

    x ^= x << 13 ; x ^= x >> 17 ; x ^= x << 5         the triple of (Marsaglia 2003, p. 4)

A step is linear over GF(2), so T steps from a state are the exclusive or of T steps from each of
its four bytes, which are looked up. The bits equal those of single steps, in a tenth of the time.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.codec.encoder import Encoder
from spikedeploy.runtime.copies import Copyable

Mode = Literal["regular", "bernoulli"]
LEVELS = 256  # steps of a rate from 0 to 1; a rate of 1 is level 256

States = NDArray[np.uint32]
_u32 = np.uint32  # constants are uint32, or NumPy would widen the states


class Xorshift(Copyable):
    """The generators of a batch of robots, seeded when the object is made.

    seed: of the episode.
    width: M, generators of one robot.
    """

    def __init__(self, seed: int, width: int) -> None:
        self.seed, self.width = seed, width
        # (B, M); a row is added when a larger batch is drawn for the first time
        self._state = np.empty((0, width), np.uint32)

    def draw(self, robots: int, timesteps: int) -> NDArray[np.uint8]:
        """The next bytes (B, T, M) of the first B robots."""
        if robots > len(self._state):
            new = np.arange(len(self._state), robots)
            self._state = np.concatenate([self._state, first_states(self.seed, self.width, new)])
        drawn = advance(self._state[:robots], timesteps)
        self._state[:robots] = drawn[-1]
        # the upper byte of each state
        upper: NDArray[np.uint8] = (drawn >> _u32(24)).astype(np.uint8)
        return np.asarray(upper.swapaxes(0, 1))

    def draw_sequence(self, inferences: int, timesteps: int) -> NDArray[np.uint8]:
        """The next bytes (S, T, M) of the first robot, for S successive inferences."""
        return np.concatenate([self.draw(1, timesteps) for _ in range(inferences)])


@dataclass(frozen=True, eq=False)
class RateEncoder(Encoder):
    """One neuron for each observed number, in the arithmetic of an 8-bit circuit.

        n = round(256 clip((x - low) / (high - low), 0, 1))      halves to even

    low: (obs,) normalised observation of rate 0.
    high: (obs,) normalised observation of rate 1, a spike in every timestep.
    mode: "regular": in each timestep n is added to an 8-bit accumulator that starts at 128, and a
        carry is a spike; spikes are evenly spaced and short windows unbiased. "bernoulli": a spike
        where a random byte is below n.

    Raises ArtifactError where low and high are not finite or high is not above low.
    """

    kind: ClassVar[str] = "rate"

    low: NDArray[np.floating]
    high: NDArray[np.floating]
    mode: Mode = "regular"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low.ndim != 1 or self.low.shape != self.high.shape:
            found = f"{self.low.shape} and {self.high.shape}"
            raise self.wrong(f"low and high must both have shape (obs,), found {found}")
        if not (np.isfinite(self.low).all() and np.isfinite(self.high - self.low).all()):
            raise self.wrong("low and high must be finite")
        if not (self.high > self.low).all():
            worst = int((self.high <= self.low).argmax())
            found = f"{self.high[worst]} and {self.low[worst]} at index {worst}"
            raise self.wrong(f"high must be above low, found {found}")

    @property
    def observed(self) -> int:
        """Numbers of an observation: obs."""
        return int(self.low.size)

    @property
    def width(self) -> int:
        """Neurons: M = obs."""
        return int(self.low.size)

    @property
    def random(self) -> bool:
        """True of mode "bernoulli"."""
        return self.mode == "bernoulli"

    def start(self, seed: int) -> Xorshift:
        """The generators of mode "bernoulli"; mode "regular" draws nothing from them."""
        return Xorshift(seed, self.width)

    def encode(
        self, x: NDArray[np.floating], timesteps: int, state: Xorshift | None = None
    ) -> NDArray[np.uint8]:
        """Spikes (B, T, M) of the normalised observations x (B, obs).

        state: generators, which run on; None for new ones of seed 0.
        """
        levels = self.levels(x)
        if self.mode == "regular":
            return np.asarray(_carries(timesteps).take(levels, axis=1).swapaxes(0, 1))
        drawn = (state or self.start(0)).draw(len(x), timesteps)
        # s[t] = byte[t] < n
        return (drawn < levels[:, None]).view(np.uint8)

    def levels(self, x: NDArray[np.floating]) -> NDArray[np.int64]:
        """Rates n (B, obs) of normalised observations (B, obs) [1/256 spikes per timestep]."""
        share = x - self.low
        share /= self.high - self.low
        # np.clip takes three times as long at batch 1
        np.maximum(share, 0, out=share)
        np.minimum(share, 1, out=share)
        share *= LEVELS
        return np.rint(share).astype(np.int64)


@lru_cache(maxsize=16)
def _carries(timesteps: int) -> NDArray[np.uint8]:
    """Spikes (T, 257) of the accumulator for each rate n."""
    t, levels = np.arange(timesteps + 1)[:, None], np.arange(LEVELS + 1)
    # c[t] = floor((n t + 128) / 256) ; s[t] = c[t + 1] - c[t]
    carried = (t * levels + LEVELS // 2) // LEVELS
    return np.diff(carried, axis=0).astype(np.uint8)


def step(x: States) -> States:
    """States after one step: the definition."""
    x = x ^ (x << _u32(13))
    x = x ^ (x >> _u32(17))
    after: States = x ^ (x << _u32(5))
    return after


def advance(x: States, timesteps: int) -> States:
    """States (T, ...) after 1, 2, ... T steps from the states x (...)."""
    tables = _tables(timesteps)
    drawn: States = tables[0].take(x & _u32(255), axis=1)
    for byte in (1, 2, 3):
        drawn ^= tables[byte].take(x >> _u32(8 * byte) & _u32(255), axis=1)
    return drawn


def first_states(seed: int, width: int, robots: NDArray[np.integer[Any]]) -> States:
    """States (B, M) before the first step, different for all neurons of all robots, never 0.

    seed: 64 bits are used.
    robots: (B,) index of each robot.
    """
    index = robots[:, None].astype(np.uint32) * _u32(width) + np.arange(width, dtype=np.uint32)
    low, high = np.array([[seed % 2**32], [seed // 2**32 % 2**32]], np.uint32)
    # x = mix(mix(mix(low + golden ratio) + high) + robot M + neuron)
    begun = _mix(_mix(low + _u32(0x9E3779B9)) + high)
    first: States = np.maximum(_mix(begun + index), _u32(1))
    return first


def _mix(x: States) -> States:
    """MurmurHash3's finaliser (Appleby 2011): a permutation that mixes all bits."""
    x = (x ^ (x >> _u32(16))) * _u32(0x85EBCA6B)
    x = (x ^ (x >> _u32(13))) * _u32(0xC2B2AE35)
    mixed: States = x ^ (x >> _u32(16))
    return mixed


@lru_cache(maxsize=8)
def _tables(timesteps: int) -> States:
    """States (4, T, 256) after each step from every value of each byte; 4 KiB per timestep."""
    x = np.arange(256, dtype=np.uint32) << (_u32(8) * np.arange(4, dtype=np.uint32)[:, None])
    tables = np.empty((4, timesteps, 256), np.uint32)
    for t in range(timesteps):
        x = step(x)
        tables[:, t] = x
    return tables
