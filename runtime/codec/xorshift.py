"""Random bytes as a chip makes them: one xorshift32 generator for each neuron of each robot.

    x ^= x << 13 ; x ^= x >> 17 ; x ^= x << 5         the triple of (Marsaglia 2003, p. 4)

A step is linear over bits, so T steps from a state are the exclusive or of T steps from each of its
four bytes, and those are looked up: the bits of going step by step, in a tenth of the time.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

States = NDArray[np.uint32]
_u32 = np.uint32  # of constants, so that nothing is widened


class Xorshift:
    """The generators of some robots, which all begin anew with a new object.

    seed: of the episode.
    width: M, generators of one robot.
    """

    def __init__(self, seed: int, width: int) -> None:
        self.seed, self.width = seed, width
        # (robots, M), a row more for each robot that comes along
        self._state = np.empty((0, width), np.uint32)

    def draw(self, robots: int, timesteps: int) -> NDArray[np.uint8]:
        """The next bytes (B, T, M) of the first B robots."""
        if robots > len(self._state):
            new = np.arange(len(self._state), robots)
            self._state = np.concatenate([self._state, first_states(self.seed, self.width, new)])
        drawn = ahead(self._state[:robots], timesteps)
        self._state[:robots] = drawn[-1]
        # the upper byte of each state
        upper: NDArray[np.uint8] = (drawn >> _u32(24)).astype(np.uint8)
        return np.asarray(upper.swapaxes(0, 1))

    def in_turn(self, inferences: int, timesteps: int) -> NDArray[np.uint8]:
        """The next bytes (S, T, M) of the first robot, for S inferences one after another."""
        return np.concatenate([self.draw(1, timesteps) for _ in range(inferences)])


def step(x: States) -> States:
    """The states after one step: the definition."""
    x = x ^ (x << _u32(13))
    x = x ^ (x >> _u32(17))
    after: States = x ^ (x << _u32(5))
    return after


def ahead(x: States, timesteps: int) -> States:
    """The states (T, ...) after 1, 2, ... T steps from the states (...)."""
    tables = _tables(timesteps)
    drawn: States = tables[0].take(x & _u32(255), axis=1)
    for place in (1, 2, 3):
        drawn ^= tables[place].take(x >> _u32(8 * place) & _u32(255), axis=1)
    return drawn


def first_states(seed: int, width: int, robots: NDArray[np.integer[Any]]) -> States:
    """The states (B, M) before the first step: different for all neurons of all robots, never 0.

    seed: 64 bits.
    """
    places = robots[:, None].astype(np.uint32) * _u32(width) + np.arange(width, dtype=np.uint32)
    low, high = np.array([[seed % 2**32], [seed // 2**32 % 2**32]], np.uint32)
    # x = mix(mix(mix(low + golden ratio) + high) + robot M + neuron)
    begun = mix(mix(low + _u32(0x9E3779B9)) + high)
    first: States = np.maximum(mix(begun + places), _u32(1))
    return first


def mix(x: States) -> States:
    """MurmurHash3's finaliser (Appleby 2011): a permutation that spreads every bit over all."""
    x = (x ^ (x >> _u32(16))) * _u32(0x85EBCA6B)
    x = (x ^ (x >> _u32(13))) * _u32(0xC2B2AE35)
    mixed: States = x ^ (x >> _u32(16))
    return mixed


@lru_cache(maxsize=8)
def _tables(timesteps: int) -> States:
    """States (4, T, 256) after each step from every value of each byte; 4 KiB a timestep."""
    x = np.arange(256, dtype=np.uint32) << (_u32(8) * np.arange(4, dtype=np.uint32)[:, None])
    tables = np.empty((4, timesteps, 256), np.uint32)
    for t in range(timesteps):
        x = step(x)
        tables[:, t] = x
    return tables
