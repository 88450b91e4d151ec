"""A compiled program as the specification from which Rockpool configures a Xylo.

Names and shapes are those of `config_from_specification` in `rockpool.devices.xylo` (3.1.0). All
layers but the last are one population of hidden neurons there.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spikedeploy.exporters.check import ParityCheck, compare_integers, random_spikes
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.traces.fields import Fields
from spikedeploy.runtime.traces.layered import xylo_trace

MARK = "spikedeploy export --to xylo"

Specification = dict[str, Any]


def check_chip(name: str | None) -> str:
    """The chip; ConfigError where it is no Xylo, or none was named."""
    if name is None or not name.startswith("xylo"):
        other = "" if name is None else f"{name} is none: "
        raise ConfigError(
            f"--to xylo: {other}choose a Xylo with --chip xylo-a2, xylo-a3 or xylo-imu"
        )
    return name


def specification(program: Program) -> Specification:
    """The arguments, as plain data: weights (pre, post, synapse), the rest for each neuron."""
    _check(program)
    hidden, output = program.layers[:-1], program.layer(program.output)
    size = sum(layer.size for layer in hidden)
    currents = max(len(layer.current_decay) for layer in hidden)
    incoming = np.zeros((program.width, size, currents), np.int64)
    recurrent = np.zeros((size, size, currents), np.int64)
    first = places(hidden)
    for layer in hidden:
        target = slice(first[layer.name], first[layer.name] + layer.size)
        for synapses in layer.synapses:
            outer = synapses.source == program.input
            start = 0 if outer else first[synapses.source]
            rows = slice(start, start + len(synapses.weight))
            (incoming if outer else recurrent)[rows, target, synapses.current] += synapses.weight
    outgoing = np.zeros((size, output.size), np.int64)
    for synapses in output.synapses:
        start = first[synapses.source]
        outgoing[start : start + len(synapses.weight)] += synapses.weight
    matrices = {"weights_in": incoming, "weights_rec": recurrent, "weights_out": outgoing}
    shifts = {f"weight_shift_{name}": 0 for name in ("in", "rec", "out")}
    found = {name: rows.tolist() for name, rows in matrices.items()} | shifts
    return found | _neurons(hidden, output, currents)


def places(layers: Sequence[Layer]) -> dict[str, int]:
    """Number of each layer's first neuron among the hidden ones."""
    ends = np.cumsum([layer.size for layer in layers])
    return {layer.name: int(end) - layer.size for layer, end in zip(layers, ends, strict=True)}


def _neurons(hidden: Sequence[Layer], output: Layer, currents: int) -> Specification:
    found: Specification = {
        "dash_mem": _each(hidden, "membrane_decay"),
        "dash_mem_out": _each([output], "membrane_decay"),
        "dash_syn": [int(x) for layer in hidden for x in layer.current_decay[0]],
        "dash_syn_out": [int(x) for x in output.current_decay[0]],
        "threshold": _each(hidden, "threshold"),
        "threshold_out": _each([output], "threshold"),
    }
    if currents > 1:
        second = [layer.current_decay[1:].sum(axis=0) for layer in hidden]
        found["dash_syn_2"] = [int(x) for rows in second for x in rows]
    # what is given switches biases on
    if any(layer.voltage_bias.any() for layer in (*hidden, output)):
        found["bias_hidden"] = _each(hidden, "voltage_bias")
        found["bias_out"] = _each([output], "voltage_bias")
    return found


def _each(layers: Sequence[Layer], field: str) -> list[int]:
    return [int(x) for layer in layers for x in np.ravel(getattr(layer, field))]


def _check(program: Program) -> None:
    last = program.layers[-1]
    if not program.output_apart or last.name != program.output or program.host_outputs:
        raise ConfigError(
            "--to xylo: several layers, or hidden neurons, leave the chip; a specification has one "
            "population of output neurons. Put a spiking layer behind them."
        )
    silent = [layer.name for layer in program.layers if not layer.spiking]
    if silent or program.damage or program.upsets is not None:
        what = f"layer {silent[0]!r} is read by its membranes" if silent else "the chip has faults"
        raise ConfigError(f"--to xylo: {what}, of which a specification says nothing.")


def document(program: Program, found: Specification) -> dict[str, Any]:
    """The content of the file: the specification, and how to read its populations and time."""
    output = program.layer(program.output)
    return {
        "made_by": MARK,
        "chip": program.chip.name,
        "dt": program.convention.dt,
        "hidden_layers": places(program.layers[:-1]),
        "output_layer": output.name,
        # of the output for an input timestep, behind that input
        "late": output.start - _wait(program),
        "remarks": list(program.remarks),
        "specification": found,
    }


def compare_spikes(program: Program, found: Specification, timesteps: int) -> ParityCheck:
    """Compare the spikes of every layer by the specification, read as a trace, with the program."""
    raster = random_spikes(np.random.default_rng(0), 1, timesteps, program.width)
    wait, steps = _wait(program), program.steps(program.rows(timesteps))
    played = np.zeros((steps, program.width), np.uint8)
    played[wait : wait + timesteps] = raster[0, : steps - wait]
    renamed = {("bias" if name == "bias_hidden" else name): rows for name, rows in found.items()}
    silent = [[0] * len(found["threshold_out"])] * steps
    record = {**renamed, "input_counts": played.tolist(), "out_spikes": silent}
    read = xylo_trace(Fields({"params": record}, "the specification"), program.chip.name)
    ran, wanted = trace(read.program, read.raster), trace(program, raster)
    first = {**places(program.layers[:-1]), program.output: 0}
    seen = {}
    for layer in program.layers:
        rows = ran["output" if layer.name == program.output else "hidden"].spikes[0]
        own = slice(first[layer.name], first[layer.name] + layer.size)
        seen[layer.name] = rows[layer.start : layer.start + timesteps, own]
    spikes = {layer.name: wanted[layer.name].spikes[0] for layer in program.layers}
    name = f"the specification, as {program.chip.name} reads it"
    return compare_integers(name, spikes, seen)


def _wait(program: Program) -> int:
    """Timesteps that an input waits, so that layers start together."""
    return next(
        synapses.delay
        for layer in program.layers
        for synapses in layer.synapses
        if synapses.source == program.input
    )
