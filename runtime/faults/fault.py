"""What a kind of fault is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program

# a program, a number and a generator -> its layers with the fault, how many were hit, of how many
Break = Callable[
    [Program, float, np.random.Generator], tuple[Sequence[Layer], int, int]
]  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """A kind of fault; without `hurt` it comes and goes while the chip runs.

    meaning: what is wrong, in a clause.
    unit: of its number.
    levels: numbers of levels 1, 2 and 3.
    bounds: (lowest, highest) number that may be given.
    what: that is counted.
    source: where the levels come from.
    hurt: the layers of a program with the fault.
    """

    meaning: str
    unit: str
    levels: tuple[float, float, float]
    bounds: tuple[float, float]
    what: str
    source: str
    hurt: Break | None = None


def drawn(size: int, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which of `size` are hit: this share of them, at least one; more of them include fewer."""
    hit = np.zeros(size, np.bool_)
    hit[rng.permutation(size)[: max(1, round(share * size)) if share else 0]] = True
    return hit
