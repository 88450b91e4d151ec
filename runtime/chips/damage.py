"""Damage of a chip, counted, and upsets by chance while it runs.

Draws of an upset are a hash of the specimen of the chip, the seed of the episode, the layer, the
timestep and the neuron (splitmix64, Steele et al. 2014): the same whatever else is drawn, and for
each robot of a batch as if it were alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

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


_FLIPS, _LOST, _SPURIOUS, _BIT = range(4)  # streams of draws
_KINDS = {"state-flips": _FLIPS, "lost-spikes": _LOST, "spurious-spikes": _SPURIOUS}


class UpsetDraws:
    """The draws of a batch of B robots, and how often something was hit.

    seeds: (B,) of their episodes.
    window: how many windows have run since then.
    counts: (3, 2) hits and chances of each kind.
    """

    def __init__(self, upsets: Upsets, batch: int) -> None:
        self.upsets = upsets
        self.counts = np.zeros((len(_KINDS), 2), np.int64)
        self.seed(range(batch))

    def seed(self, seeds: Sequence[int]) -> None:
        """Start the draws of these episodes; counts go on."""
        self.seeds = np.array(seeds, np.int64)
        self._keys: Keys = keys(self.upsets.specimen, self.seeds.tolist())
        self.window = 0

    @property
    def damage(self) -> tuple[Damage, ...]:
        """Hits of each upset so far, and chances."""
        found = []
        for each in self.upsets.each:
            hit, of = self.counts[_KINDS[each.name]].tolist()
            found.append(
                Damage(each.text, each.name, each.probability, hit, of, each.what, over_time=True)
            )
        return tuple(found)

    def upset_spikes(self, layer: int, step: int, sent: NDArray[Any]) -> NDArray[Any]:
        """The spikes (B, N) that arrive of those that were sent."""
        arriving = sent
        fired = sent != 0
        if self.upsets.probability("lost-spikes"):
            lost = self._hit("lost-spikes", (layer, step), fired)
            arriving = np.where(lost, 0, arriving).astype(sent.dtype)
        if self.upsets.probability("spurious-spikes"):
            made_up = self._hit("spurious-spikes", (layer, step), ~fired)
            arriving = np.where(made_up, 1, arriving).astype(sent.dtype)
        return arriving

    def flip(self, layer: int, step: int, membrane: NDArray[Any], bits: int) -> NDArray[Any]:
        """Membranes (B, N) after bits have flipped, in registers of so many bits."""
        if not self.upsets.probability("state-flips"):
            return membrane
        flips = self._hit("state-flips", (layer, step), np.ones(membrane.shape, np.bool_))
        if not flips.any():
            return membrane
        size = membrane.shape[1]
        which = (uniform(self._keys, (_BIT, layer, self.window, step), size) * bits).astype(int)
        stored = (membrane & ((1 << bits) - 1)) ^ (np.int64(1) << which)
        flipped = np.where(stored >> (bits - 1), stored - (1 << bits), stored)
        return np.where(flips, flipped, membrane)

    def _hit(
        self, name: str, place: tuple[int, int], chances: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """The chances (B, N) that are hit."""
        layer, step = place
        stream = _KINDS[name]
        draws = uniform(self._keys, (stream, layer, self.window, step), chances.shape[1])
        hit = chances & (draws < self.upsets.probability(name))
        self.counts[stream] += np.count_nonzero(hit), np.count_nonzero(chances)
        return np.asarray(hit)


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
