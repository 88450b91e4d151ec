"""A recorded run once more on our arithmetic, and the first number that differs."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.emulator.interpreter import LayerTrace, trace
from spikedeploy.runtime.traces.fields import Integers, read_json
from spikedeploy.runtime.traces.sanafe import MAKER, energy_verdict
from spikedeploy.runtime.traces.trace_file import (
    QUANTITIES,
    Difference,
    TraceFile,
    Verdict,
    maker,
    own_verdict,
    program_trace_in,
    trace_in,
)

_BLIND = "membranes at spikes, of which the board's probe shows something else"


def verify(path: Path) -> Verdict:
    """Replay a trace file by the specification of the arithmetic."""
    fields = read_json(path)
    if fields.name("program") is not None:
        return _verdict(program_trace_in(fields, path.parent))
    if (chip := maker(fields, path.stem)) == MAKER:
        return energy_verdict(fields)
    if (verdict := own_verdict(fields, chip)) is not None:
        return verdict
    return _verdict(trace_in(fields, path.stem))


def _verdict(recorded: TraceFile) -> Verdict:
    """What comes of a trace that is replayed by the interpreter."""
    ran = trace(recorded.program, recorded.raster)
    found = {name: _quantities(layer) for name, layer in ran.items()}
    masks = _masks(recorded, found)
    passed_over = sum(int((~mask).sum()) for mask in masks.values())
    return Verdict(
        chip=recorded.program.chip.name,
        source=recorded.source,
        steps=recorded.raster.shape[0] * recorded.raster.shape[1],
        compared=sum(int(mask.sum()) for mask in masks.values()),
        passed_over=passed_over,
        why=_BLIND if passed_over else "",
        difference=first_difference(recorded.recorded, found, masks),
        unread=recorded.unread,
        remarks=recorded.remarks,
    )


def _quantities(layer: LayerTrace) -> dict[str, Integers]:
    """What a layer did, by quantity: (T, N), one inference behind the other."""
    current, membrane, spikes = (
        np.concatenate(each) for each in (layer.current, layer.membrane, layer.spikes)
    )
    currents = [current] if current.ndim == 2 else list(current.swapaxes(0, 1))
    named = dict(zip(QUANTITIES, currents, strict=False))
    return {**named, "membrane": membrane, "spikes": spikes.astype(np.int64)}


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


def first_difference(
    recorded: Mapping[str, Mapping[str, Integers]],
    found: Mapping[str, Mapping[str, Integers]],
    masks: Mapping[tuple[str, str], NDArray[np.bool_]],
) -> Difference | None:
    """The earliest difference; within a timestep in the order of layers and quantities.

    recorded, found: layer -> quantity -> (T, N).
    masks: where to compare, by layer and quantity; everywhere where there is none.
    """
    first, earliest = None, None
    for layer, quantities in recorded.items():
        for quantity in (q for q in QUANTITIES if q in quantities):
            expected, ours = quantities[quantity], found[layer][quantity]
            wrong = np.argwhere((expected != ours) & masks.get((layer, quantity), True))
            if len(wrong) and (earliest is None or wrong[0][0] < earliest):
                step, neuron = (int(i) for i in wrong[0])
                values = int(expected[step, neuron]), int(ours[step, neuron])
                first, earliest = Difference(step, layer, neuron, quantity, *values), step
    return first
