"""Random bytes as a chip draws them: one xorshift32 generator for each neuron of each robot.

    x ^= x << 13 ; x ^= x >> 17 ; x ^= x << 5         the triple of (Marsaglia 2003, p. 4)

A step is linear over GF(2), so T steps from a state are the exclusive or of T steps from each of
its four bytes, which are looked up: the same bits as step by step, in a tenth of the time.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

States = NDArray[np.uint32]
_u32 = np.uint32  # constants are uint32, or NumPy would widen the states


class Xorshift:
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
