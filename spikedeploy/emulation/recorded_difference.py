"""The first difference between a recording and the float twin, and its likeliest cause.

Other conventions are tried, in the order in which they are usually to blame: reset, delay, dt,
threshold rule, then integrator, the tool that wrote the file, and rounding; then two of them
together.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.rasters import Raster
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.artifact.writers.writer import WRITERS
from spikedeploy.runtime.convention import Integrator, Reset, Spikes
from spikedeploy.runtime.errors import SpikedeployError
from spikedeploy.runtime.float_model import FloatGraph

Changes = dict[str, Any]

# of membranes, which no spike rounds, beside their largest: float32 against float64
_TOLERANCE = 1e-4
# of tools and their defaults; 1e-6 undoes Norse's, 1 is for time constants in timesteps
_TIMESTEPS = (1e-4, 1e-3, 1e-2, 1.0, 1e-6)
_CHOICES: dict[str, tuple[Any, ...]] = {
    "reset": get_args(Reset),
    "delay": (0, 1),
    "dt": _TIMESTEPS,
    "spikes": get_args(Spikes),
    "integrator": get_args(Integrator),
    "written_by": tuple(WRITERS),
}
_OPTIONS = {"written_by": "from"}


@dataclass(frozen=True)
class RecordedDifference:
    """The first output that is not the recorded one.

    count: of outputs that differ, of `compared`.
    """

    inference: int
    timestep: int
    neuron: tuple[int, ...]
    expected: float
    found: float
    count: int

    def describe(self) -> str:
        """Where, and both numbers."""
        neuron = ", ".join(map(str, self.neuron))
        return (
            f"inference {self.inference}, timestep {self.timestep}, neuron {neuron}: your "
            f"framework {self.expected:g}, our float {self.found:g}"
        )


def difference(
    artifact: Artifact,
    inputs: Raster,
    outputs: Raster,
    dtype: type[np.floating[Any]] = np.float64,
) -> RecordedDifference | None:
    """The first difference in time."""
    found = FloatGraph(artifact, dtype).run(inputs)["output"]
    apart = _apart(found, outputs)
    if not apart.any():
        return None
    places = np.argwhere(apart)
    first = places[np.lexsort((places[:, 0], places[:, 1]))[0]]
    place = tuple(int(n) for n in first)
    return RecordedDifference(
        place[0],
        place[1],
        place[2:],
        float(outputs[place]),
        float(found[place]),
        int(apart.sum()),
    )


def _apart(found: NDArray[Any], wanted: NDArray[Any]) -> NDArray[np.bool_]:
    whole = all(np.array_equal(rows, np.rint(rows)) for rows in (found, wanted))
    tolerance = 0.0 if whole else _TOLERANCE * float(np.abs(wanted).max())
    return np.asarray(np.abs(found - wanted.astype(np.float64)) > tolerance)


def likeliest_cause(
    path: Path,
    given: Changes,
    artifact: Artifact,
    inputs: Raster,
    outputs: Raster,
    first: RecordedDifference,
) -> tuple[tuple[str, ...], tuple[str, int] | None]:
    """The options that make both equal; or else the nearest one, and how many outputs differ."""
    counts: dict[str, int] = {}
    singles = list(_singles(given, artifact))
    for changes in singles:
        if (other := read_with(path, given, changes)) is None:
            continue
        found = difference(other, inputs, outputs)
        if found is None:
            return _words(changes), None
        counts[_words(changes)[0]] = found.count
    if difference(artifact, inputs, outputs, np.float32) is None:
        return ("rounding to float32",), None
    # most pairs fail at the timestep of the first difference already
    upto = first.timestep + 1
    for one, two in combinations(singles, 2):
        if one.keys() & two.keys() or (other := read_with(path, given, one | two)) is None:
            continue
        if difference(other, inputs[:, :upto], outputs[:, :upto]) is None and (
            difference(other, inputs, outputs) is None
        ):
            return _words(one | two), None
    nearest = min(counts, key=lambda words: counts[words], default=None)
    better = nearest is not None and counts[nearest] < first.count
    return (), (nearest, counts[nearest]) if nearest is not None and better else None


def _singles(given: Changes, artifact: Artifact) -> Iterator[Changes]:
    """Every other choice of every option, one at a time."""
    for option, choices in _CHOICES.items():
        if option == "written_by" and {"like", "written_by"} & given.keys():
            continue
        now = given.get(option, getattr(artifact.convention, option, None))
        yield from ({option: choice} for choice in choices if choice != now)


def read_with(path: Path, given: Changes, changes: Changes) -> Artifact | None:
    """The file read with other options; None where they contradict it, or one another."""
    try:
        return load(path, **{**given, **changes})
    except SpikedeployError:
        pass
    # what no option of the tool says can still be to blame; dt and gains go together
    late = {name: value for name, value in changes.items() if name not in ("dt", "written_by")}
    early = {name: value for name, value in changes.items() if name not in late}
    try:
        read = load(path, **{**given, **early})
        return replace(read, convention=read.convention.with_options(late)) if late else None
    except SpikedeployError:
        return None


def _words(changes: Changes) -> tuple[str, ...]:
    """Options as they are typed."""
    return tuple(
        f"--{_OPTIONS.get(name, name)} {value:g}"
        if isinstance(value, float)
        else f"--{_OPTIONS.get(name, name)} {value}"
        for name, value in changes.items()
    )
