"""Recorded runs of Xylo, as xylosim's layers are built and recorded."""

from dataclasses import replace

import numpy as np

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.xylo import XyloArithmetic, XyloRegisters
from spikedeploy.runtime.traces.fields import Fields, Integers, Work
from spikedeploy.runtime.traces.verify import (
    PROSE,
    TraceFile,
    nothing_to_compare,
    recorded_tables,
    table_of,
)

_HIDDEN, _OUTPUT = "hidden", "output"
_STATE = -1 << 16, 1 << 16
# layer -> quantity -> its name in the file, and what it may be
_RECORDED = {
    _HIDDEN: {
        "current": (("i_syn",), *_STATE),
        "current 2": (("i_syn2",), *_STATE),
        "membrane": (("v_mem",), *_STATE),
        "spikes": (("hidden_spikes",), *_STATE),
    },
    _OUTPUT: {
        "current": (("i_syn_out",), *_STATE),
        "membrane": (("v_mem_out",), *_STATE),
        "spikes": (("out_spikes",), *_STATE),
    },
}
_INPUT = ("input_counts", "input_spikes", "input")
_SHIFTS = ("weight_shift_in", "weight_shift_rec", "weight_shift_out")
_REPEATED = {"chip", "steps", "params"}


def xylo_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields: hidden neurons with recurrent synapses, and output neurons."""
    spec = fields.merged_with(fields.group("params"))
    used = datasheet(chip)
    registers = used.arithmetic
    if not isinstance(registers, XyloArithmetic):
        raise fields.wrong("chip", f"{chip} does not count events", "Name a Xylo.")
    counts = table_of(spec, _INPUT, 0, 255, index="input_spikes_index")
    work = Work(fields, len(counts))
    hidden = _hidden(spec, registers, counts.shape[1], work)
    output = _output(spec, registers, work)
    if (found := output.synapses[0].weight.shape[0]) != hidden.size:
        remedy = f"Write a row for each of the {hidden.size} hidden neurons."
        raise spec.wrong("weights_out", f"has {found} rows", remedy)
    recorded = {
        layer.name: recorded_tables(spec, _RECORDED[layer.name], (len(counts), layer.size))
        for layer in (hidden, output)
    }
    unread = spec.unread - PROSE - _REPEATED
    if not any(recorded.values()):
        raise nothing_to_compare(fields, unread, "v_mem or out_spikes")
    return TraceFile(
        source=fields.text("source") or fields.text("name") or chip,
        program=_program(used, counts.shape[1], hidden, output),
        raster=counts.astype(np.uint8)[None],
        recorded=recorded,
        blind_at_spikes=False,
        unread=tuple(sorted(unread)),
    )


def _program(chip: Chip, width: int, hidden: Layer, output: Layer) -> Program:
    convention = Convention(1e-3, reset="subtract", delay=chip.delay, source="the trace")
    return Program(chip, convention, "input", width, (hidden, output), _OUTPUT, None)


def _aliases(spec: Fields, size: int) -> tuple[tuple[int, ...], ...]:
    """The neurons that each neuron's spikes are counted for too."""
    if not spec.has_content("aliases"):
        return ()
    rows = spec.lists("aliases", least=0, most=size - 1)
    if len(rows) != size:
        raise spec.wrong("aliases", f"has {len(rows)} lists", f"Write {size}, one for each neuron.")
    if own := [n for n, others in enumerate(rows) if n in others]:
        raise spec.wrong("aliases", f"of neuron {own[0]} name itself", "Name other neurons.")
    return rows


def _hidden(spec: Fields, registers: XyloRegisters, width: int, work: Work) -> Layer:
    weights = _weights(spec, "weights_in", 0, registers)
    if weights.shape[0] != width:
        raise spec.wrong(
            "weights_in", f"has {weights.shape[0]} rows", f"Write one for each of {width} inputs."
        )
    size, aliases = weights.shape[1], _aliases(spec, weights.shape[1])
    axons = weights.shape[2] * width + sum(map(len, aliases), len(aliases))
    count = weights.size
    synapses = [Synapses("input", weights[:, :, k], 0, current=k) for k in range(weights.shape[2])]
    if spec.has_content("weights_rec"):
        recurrent = _weights(spec, "weights_rec", 1, registers)
        if recurrent.shape[:2] != (size, size):
            remedy = f"Write {size} rows of {size} neurons."
            raise spec.wrong("weights_rec", f"has shape {recurrent.shape}", remedy)
        axons, count = axons + recurrent.shape[2] * size, count + recurrent.size
        each = range(recurrent.shape[2])
        synapses += [Synapses(_HIDDEN, recurrent[:, :, k], 1, current=k) for k in each]
    work.add(size, count, axons)
    dashes = [_dash(spec, name, registers, size) for name in ("dash_syn", "dash_syn_2")]
    layer = _layer(spec, _HIDDEN, tuple(synapses), dashes, registers)
    return replace(layer, aliases=aliases)


def _output(spec: Fields, registers: XyloRegisters, work: Work) -> Layer:
    weights = _weights(spec, "weights_out", 2, registers)
    if weights.shape[2] > 1:
        raise spec.wrong("weights_out", f"has shape {weights.shape}", "Outputs have one synapse.")
    work.add(weights.shape[1], weights.size, len(weights))
    synapses = Synapses(_HIDDEN, weights[:, :, 0], 1)
    dash = _dash(spec, "dash_syn_out", registers, weights.shape[1])
    return _layer(spec, _OUTPUT, (synapses,), [dash], registers)


def _layer(
    spec: Fields,
    name: str,
    synapses: tuple[Synapses, ...],
    dashes: list[Integers],
    registers: XyloRegisters,
) -> Layer:
    end, size = "_out" if name == _OUTPUT else "", synapses[0].weight.shape[1]
    limit = registers.state.limit
    bias = spec.row(f"bias{end}", size=size, default=0, least=-limit - 1, most=limit)
    return Layer(
        name=name,
        synapses=synapses,
        bias=np.zeros(size, np.int64),
        voltage_bias=bias,
        threshold=spec.row(f"threshold{end}", size=size, least=-limit - 1, most=limit),
        current_decay=np.stack(dashes),
        membrane_decay=_dash(spec, f"dash_mem{end}", registers, size),
        scale=1.0,
        start=0,
    )


def _weights(spec: Fields, name: str, place: int, registers: XyloRegisters) -> Integers:
    """(M, N, K) weights as they are added, after the shift of their matrix."""
    edge = 1 << (registers.weight_bits - 1)
    found = spec.array(name, axes=3, least=-edge, most=edge - 1)
    if found.ndim == 1:  # a single neuron, one weight for each of its inputs
        found = found[:, None]
    if found.ndim < 2:
        raise spec.wrong(name, "is a single number", "Write [pre][post][synapse].")
    found = found.reshape(*found.shape[:2], -1)
    if found.shape[2] > registers.currents:
        remedy = f"A neuron has {registers.currents} synapses at most."
        raise spec.wrong(name, f"has shape {found.shape}", remedy)
    shifts = spec.row("weight_shift", size=3, default=0, least=0, most=registers.shift_max)
    own = spec.row(_SHIFTS[place], size=1, default=shifts[place], least=0, most=registers.shift_max)
    return np.asarray(found << own)


def _dash(spec: Fields, name: str, registers: XyloRegisters, size: int) -> Integers:
    default = 0 if name == "dash_syn_2" else None
    return spec.row(name, size=size, default=default, least=0, most=registers.dash_max)
