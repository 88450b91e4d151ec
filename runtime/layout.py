"""The layout: which neuron sits on which core, and where the cores lie."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.program import Program

Counts = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Layout:
    """Neurons on cores; a mapping counts cores by the layer, a layout says them by the neuron.

    cores: of the input and of each layer, the core (N,) of each neuron.
    tiles: (K, 2) column and row of the tile of each core, on the mesh that messages travel.
    """

    cores: Mapping[str, Counts]
    tiles: Counts


def one_core_each(program: Program) -> Layout:
    """Every layer on a core of its own, all cores on one tile."""
    cores = {name: np.full(size, k) for k, (name, size) in enumerate(program.sizes.items())}
    return Layout(cores, np.zeros((len(cores), 2), np.int64))
