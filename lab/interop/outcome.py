"""What came of a case: whether a peer opens it, and whether its spikes are the same."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_OUTPUT = 1e-4  # of the largest output: what float32 may round


@dataclass(frozen=True)
class SpikesCompared:
    """Spikes of a peer beside ours.

    compared: spikes and absences of them, over all layers and timesteps.
    differ: of them.
    first: timestep, layer and neuron of the first difference; None where there is none.
    output: whether the output is equal too: "equal", "differs" or "another shape".
    """

    compared: int
    differ: int
    first: tuple[int, str, int] | None
    output: str

    def record(self) -> dict[str, Any]:
        """All of it as data."""
        first = None if self.first is None else list(self.first)
        return {**vars(self), "first": first}


def compared(
    theirs: Mapping[str, NDArray[Any]], ours: Mapping[str, NDArray[Any]]
) -> SpikesCompared:
    """Compare layers (T, N) in their order; the last is the output.

    Names need not agree: what is written for Norse may have others.
    """
    total, differ, first = 0, 0, None
    *layers, (_, output) = zip(theirs.values(), ours.items(), strict=True)
    for found, (name, wanted) in layers:
        unequal = found != wanted
        total, differ = total + unequal.size, differ + int(np.count_nonzero(unequal))
        if unequal.any():
            timestep, neuron = (int(each) for each in np.argwhere(unequal)[0])
            if first is None or timestep < first[0]:
                first = (timestep, name, neuron)
    return SpikesCompared(total, differ, first, _output(theirs["output"], output[1]))


def _output(found: NDArray[Any], wanted: NDArray[Any]) -> str:
    if found.shape != wanted.shape:
        return "another shape"
    limit = _OUTPUT * max(float(np.abs(wanted).max()), 1e-12)
    return "equal" if np.abs(found - wanted).max() <= limit else "differs"
