"""Damage of a chip, counted, and upsets by chance while it runs.

Draws of an upset are a hash of the specimen of the chip, the seed of the episode, the layer, the
timestep and the neuron (splitmix64, Steele et al. 2014): the same whatever else is drawn, and for
each robot of a batch as if it were alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Keys = NDArray[np.uint64]

_GOLDEN, _MIX, _AGAIN = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
_WORD = 1 << 64


@dataclass(frozen=True)
class Damage:
    """The parts that a fault hit.

    text: the fault as requested.
    name: key of runtime.faults.FAULTS.
    number: of the fault's unit.
    hit: how many.
    of: out of how many.
    what: the parts that were counted, such as "neurons".
    over_time: whether they are counted as the chip runs; else they are parts of the chip.
    """

    text: str
    name: str
    number: float
    hit: int
    of: int
    what: str
    over_time: bool = False

    def since(self, before: "Damage") -> "Damage":
        """Return the damage since an earlier count."""
        return replace(self, hit=self.hit - before.hit, of=self.of - before.of)


def sum_damage(each: Sequence[Sequence[Damage]]) -> tuple[Damage, ...]:
    """Sums of the damage over time of several runs of the same chip."""
    return tuple(
        replace(same[0], hit=sum(d.hit for d in same), of=sum(d.of for d in same))
        for same in zip(*each, strict=True)
    )


@dataclass(frozen=True)
class Upset:
    """A kind of fault that comes and goes while the chip runs.

    text, name: as in Damage.
    probability: of each chance.
    what: the chances, such as "spikes".
    """

    text: str
    name: str
    probability: float
    what: str


@dataclass(frozen=True)
class Upsets:
    """All upsets of a chip.

    each: by name.
    specimen: which chip of its kind it is.
    """

    each: tuple[Upset, ...]
    specimen: int

    def probability(self, name: str) -> float:
        """The probability of a kind; 0 where there is none."""
        return next((upset.probability for upset in self.each if upset.name == name), 0.0)


def keys(specimen: int, seeds: Sequence[int]) -> Keys:
    """A key (B,) for each robot, of its seed."""
    numbers = [_mix(_mix(specimen + 1) ^ (seed % _WORD)) for seed in seeds]
    return np.array(numbers, np.uint64)


def uniform(of: Keys, place: Sequence[int], size: int) -> NDArray[np.float64]:
    """Uniform numbers (B, size) in [0, 1) for the keys (B,), others at another place."""
    at = 0
    for number in place:
        at = _mix(at ^ (number % _WORD))
    steps = np.arange(1, size + 1, dtype=np.uint64) * np.uint64(_GOLDEN)
    x = (of ^ np.uint64(at))[:, None] + steps
    x = (x ^ (x >> np.uint64(30))) * np.uint64(_MIX)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(_AGAIN)
    x ^= x >> np.uint64(31)
    return np.asarray((x >> np.uint64(11)) * 2.0**-53)


def _mix(x: int) -> int:
    """splitmix64 of one number."""
    x = (x + _GOLDEN) % _WORD
    x = (x ^ (x >> 30)) * _MIX % _WORD
    x = (x ^ (x >> 27)) * _AGAIN % _WORD
    return x ^ (x >> 31)
