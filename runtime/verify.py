"""Verifying: a recorded run once more on our arithmetic, and the first place where it differs."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.fields import Integers
from runtime.interpreter import LayerTrace, trace
from runtime.trace_file import TraceFile, read_trace

# in the order in which a neuron computes them
QUANTITIES = ("current", "current 2", "membrane", "spikes")


@dataclass(frozen=True)
class Difference:
    """The first number that is not as recorded.

    step: row of the trace, counted from 0.
    layer, neuron: whose it is; neurons are counted from 0.
    quantity: one of QUANTITIES.
    expected, found: in the trace, and here.
    """

    step: int
    layer: str
    neuron: int
    quantity: str
    expected: int
    found: int

    def describe(self) -> str:
        """One line for people."""
        return (
            f"step {self.step}, {self.layer}, neuron {self.neuron}, {self.quantity}: "
            f"expected {self.expected}, found {self.found}"
        )


@dataclass(frozen=True)
class Verdict:
    """What became of a trace.

    chip: in whose reading it was replayed.
    source: who recorded it.
    steps: T.
    compared: numbers that were compared.
    passed_over: membranes at spikes that the source's probe does not show.
    difference: None where all numbers are equal.
    unread: fields of the file that mean nothing to the reader.
    """

    chip: str
    source: str
    steps: int
    compared: int
    passed_over: int
    difference: Difference | None
    unread: tuple[str, ...]

    @property
    def equal(self) -> bool:
        """Whether every compared number is as recorded."""
        return self.difference is None

    def as_json(self) -> dict[str, Any]:
        """Everything, for machines."""
        return {"equal": self.equal, **asdict(self)}


def verify(path: Path) -> Verdict:
    """Replay a trace file by the specification of the arithmetic."""
    recorded = read_trace(path)
    ran = trace(recorded.program, recorded.raster)
    found = {name: _quantities(layer) for name, layer in ran.items()}
    masks = _masks(recorded, found)
    return Verdict(
        chip=recorded.program.chip.name,
        source=recorded.source,
        steps=recorded.raster.shape[1],
        compared=sum(int(mask.sum()) for mask in masks.values()),
        passed_over=sum(int((~mask).sum()) for mask in masks.values()),
        difference=_first(recorded, found, masks),
        unread=recorded.unread,
    )


def _quantities(layer: LayerTrace) -> dict[str, Integers]:
    """What a layer did, by quantity: (T, N)."""
    current = layer.current[0]
    currents = [current] if current.ndim == 2 else list(current.swapaxes(0, 1))
    named = dict(zip(QUANTITIES, currents, strict=False))
    return {**named, "membrane": layer.membrane[0], "spikes": layer.spikes[0].astype(np.int64)}


def _masks(
    recorded: TraceFile, found: Mapping[str, Mapping[str, Integers]]
) -> dict[tuple[str, str], NDArray[np.bool_]]:
    """(T, N) of each layer and quantity: where to compare."""
    masks = {}
    for layer, quantities in recorded.recorded.items():
        for quantity, expected in quantities.items():
            mask = np.ones(expected.shape, np.bool_)
            if recorded.blind_at_spikes and quantity == "membrane":
                mask = quantities.get("spikes", found[layer]["spikes"]) == 0
            masks[layer, quantity] = mask
    return masks


def _first(
    recorded: TraceFile,
    found: Mapping[str, Mapping[str, Integers]],
    masks: Mapping[tuple[str, str], NDArray[np.bool_]],
) -> Difference | None:
    """The earliest difference; within a timestep in the order of layers and quantities."""
    first = None
    for layer, quantities in recorded.recorded.items():
        for quantity in (q for q in QUANTITIES if q in quantities):
            expected, ours = quantities[quantity], found[layer][quantity]
            wrong = np.argwhere((expected != ours) & masks[layer, quantity])
            if len(wrong) and (first is None or wrong[0][0] < first.step):
                step, neuron = (int(i) for i in wrong[0])
                values = int(expected[step, neuron]), int(ours[step, neuron])
                first = Difference(step, layer, neuron, quantity, *values)
    return first
