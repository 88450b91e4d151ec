"""Traces of Loihi, in the words of lava, brian2_loihi, nengo-loihi and of boards."""

import numpy as np

from runtime.chip import chip as datasheet
from runtime.convention import Convention
from runtime.fields import Fields, Integers
from runtime.loihi_layer import EFFECTIVE, STATE, LoihiLayer, loihi_layer
from runtime.program import Program
from runtime.trace_file import PROSE, TraceFile, nothing_to_compare, table_of

INPUT = ("input_spikes", "input", "inputs", "in", "spikes_in", "s_in", "in_spikes")
# quantity -> what emulators call it
RECORDED = {
    "current": ("u", "current", "I", "i"),
    "membrane": ("v", "voltage", "membrane", "v_mem"),
    "spikes": ("s", "spikes", "s_out", "output_spikes", "out_spikes", "spk"),
}
# and what boards' probes are called, with one of these before or after
PROBES = ("hw", "chip", "board", "probe")
# what the files say twice, or the reading says
REPEATED = {
    "steps", "params", "layers", "dt", "exc_inh_split", "weights_effective_reported",
    "weights_exc", "weights_inh", "weights_mixed", "weight_effective", "weights_effective",
    "effective_decay_u", "effective_decay_v", "vth_effective", "bias_effective", "du", "decay_u",
    *EFFECTIVE, *INPUT,
}  # fmt: skip


def loihi_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; one layer at the top, or a list of them under `layers`."""
    specs = _layers_of(fields)
    rows = table_of(specs[0], INPUT, 0, 1, index="input_spikes_index")
    parts, size = [], rows.shape[1]
    for place, spec in enumerate(specs):
        parts.append(loihi_layer(spec, datasheet(chip), place, size))
        size = parts[-1].layer.size
    _check_alike(fields, parts)
    recorded = {
        part.layer.name: _recorded(spec, (len(rows), part.layer.size))
        for part, spec in zip(parts, specs, strict=True)
    }
    unread = set.intersection(*(spec.unread for spec in specs)) - PROSE - REPEATED
    if not any(recorded.values()):
        raise nothing_to_compare(fields, unread, "u, v or s")
    return TraceFile(
        source=fields.text("source") or fields.text("name") or chip,
        program=_program(parts, rows.shape[1]),
        raster=rows.astype(np.uint8)[None],
        recorded=recorded,
        blind_at_spikes=chip == "loihi2",  # a board's probe shows something else there
        unread=tuple(sorted(unread)),
    )


def _layers_of(fields: Fields) -> list[Fields]:
    """What each layer says; what the file says of all of them goes last."""
    shared = fields.under(fields.group("params"))
    if fields.name("layers") is None:
        return [shared]
    return [
        shared.under(layer, layer.group("params"), where=layer.where)
        for layer in fields.groups("layers")
    ]


def _probed(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names, and those with the mark of a board's probe."""
    marked = ((f"{name}_{mark}", f"{mark}_{name}") for name in names for mark in PROBES)
    return (*names, *(each for pair in marked for each in pair))


def _recorded(spec: Fields, shape: tuple[int, int]) -> dict[str, Integers]:
    """The tables (T, N) that are there, by quantity."""
    recorded = {}
    for quantity, names in RECORDED.items():
        if (name := spec.name(*_probed(names))) is None:
            continue
        limits = (0, 1) if quantity == "spikes" else (-STATE, STATE)
        recorded[quantity] = table = table_of(spec, (name,), *limits, index="trace_index")
        if table.shape != shape:
            remedy = f"The input and the weights ask for {shape}."
            raise spec.wrong(name, f"has shape {table.shape}", remedy)
    return recorded


def _check_alike(fields: Fields, parts: list[LoihiLayer]) -> None:
    """What belongs to the chip and not to a layer must be the same for all layers."""
    for option in ("refractory", "membrane", "mantissa_shift"):
        if len({getattr(part.chip.fixed, option) for part in parts}) > 1:
            raise fields.wrong(option, "differs from layer to layer", "Split the trace in two.")


def _program(parts: list[LoihiLayer], width: int) -> Program:
    chip, layers = parts[0].chip, tuple(part.layer for part in parts)
    convention = Convention(1e-3, delay=chip.delay, source="the trace")
    return Program(chip, convention, "input", width, layers, layers[-1].name, None)
