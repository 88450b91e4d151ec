"""Recorded runs of Xylo, as xylosim's layers are built and recorded."""

from dataclasses import replace

import numpy as np

from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.runtime.traces.fields import Fields, Integers, Work
from spikedeploy.runtime.traces.verify import TraceFile, chain_trace, layer_of, table_of

_HIDDEN, _OUTPUT = "hidden", "output"
_STATE = -1 << 16, 1 << 16
_RECORDED = (
    {
        "current": (("i_syn",), *_STATE),
        "current 2": (("i_syn2",), *_STATE),
        "membrane": (("v_mem",), *_STATE),
        "spikes": (("hidden_spikes",), *_STATE),
    },
    {
        "current": (("i_syn_out",), *_STATE),
        "membrane": (("v_mem_out",), *_STATE),
        "spikes": (("out_spikes",), *_STATE),
    },
)
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
    work, width = Work(fields, len(counts)), counts.shape[1]
    hidden = _hidden(spec, registers, width, work)
    output = _output(spec, registers, hidden.size, work)
    convention = Convention(1e-3, reset="subtract", delay=used.delay, source="the trace")
    program = Program(used, convention, "input", width, (hidden, output), _OUTPUT, None)
    return chain_trace(fields, [spec, spec], program, counts, _RECORDED, _REPEATED)


def _hidden(spec: Fields, registers: XyloArithmetic, width: int, work: Work) -> Layer:
    weights = _weights(spec, "weights_in", 0, registers)
    if weights.shape[0] != width:
        found, remedy = f"has {weights.shape[0]} rows", f"Write one for each of {width} inputs."
        raise spec.wrong("weights_in", found, remedy)
    size, aliases = weights.shape[1], _aliases(spec, weights.shape[1])
    synapses = _synapses("input", weights, 0)
    if spec.has_content("weights_rec"):
        recurrent = _weights(spec, "weights_rec", 1, registers)
        if recurrent.shape[:2] != (size, size):
            remedy = f"Write {size} rows of {size} neurons."
            raise spec.wrong("weights_rec", f"has shape {recurrent.shape}", remedy)
        synapses += _synapses(_HIDDEN, recurrent, 1)
    axons = sum(len(s.weight) for s in synapses) + sum(map(len, aliases), len(aliases))
    work.add(size, sum(s.weight.size for s in synapses), axons)
    layer = _layer(spec, _HIDDEN, synapses, ("dash_syn", "dash_syn_2"), registers)
    return replace(layer, aliases=aliases)


def _output(spec: Fields, registers: XyloArithmetic, hidden: int, work: Work) -> Layer:
    weights = _weights(spec, "weights_out", 2, registers)
    if weights.shape[2] > 1:
        raise spec.wrong("weights_out", f"has shape {weights.shape}", "Outputs have one synapse.")
    if len(weights) != hidden:
        remedy = f"Write a row for each of the {hidden} hidden neurons."
        raise spec.wrong("weights_out", f"has {len(weights)} rows", remedy)
    work.add(weights.shape[1], weights.size, len(weights))
    return _layer(spec, _OUTPUT, _synapses(_HIDDEN, weights, 1), ("dash_syn_out",), registers)


def _synapses(source: str, weights: Integers, delay: int) -> list[Synapses]:
    return [Synapses(source, weights[:, :, k], delay, current=k) for k in range(weights.shape[2])]


def _layer(
    spec: Fields,
    name: str,
    synapses: list[Synapses],
    dashes: tuple[str, ...],
    registers: XyloArithmetic,
) -> Layer:
    end, size = "_out" if name == _OUTPUT else "", synapses[0].weight.shape[1]
    limit = registers.state.limit

    def dash(name: str) -> Integers:
        default = 0 if name == "dash_syn_2" else None
        return spec.row(name, size=size, default=default, least=0, most=registers.dash_max)

    return layer_of(
        name,
        synapses,
        spec.row(f"threshold{end}", size=size, least=-limit - 1, most=limit),
        dash(f"dash_mem{end}"),
        current_decay=np.stack([dash(each) for each in dashes]),
        voltage_bias=spec.row(f"bias{end}", size=size, default=0, least=-limit - 1, most=limit),
    )


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


def _weights(spec: Fields, name: str, place: int, registers: XyloArithmetic) -> Integers:
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
    limits = {"least": 0, "most": registers.shift_max}
    if spec.name(_SHIFTS[place]):
        return np.asarray(found << spec.row(_SHIFTS[place], size=1, **limits))
    return np.asarray(found << spec.row("weight_shift", size=3, default=0, **limits)[place])
