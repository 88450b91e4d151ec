"""A compiled program as the specification from which Rockpool configures a Xylo.

Names and shapes are those of `config_from_specification` in `rockpool.devices.xylo` (3.1.0). All
layers but the last are one population of hidden neurons there.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError

Specification = dict[str, Any]


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
            "--to program: several layers, or hidden neurons, leave the chip; a Xylo has one "
            "population of output neurons. Put a spiking layer behind them."
        )
    silent = [layer.name for layer in program.layers if not layer.spiking]
    if silent or program.damage or program.upsets is not None:
        what = f"layer {silent[0]!r} is read by its membranes" if silent else "the chip has faults"
        raise ConfigError(f"--to program: {what}, of which a specification says nothing.")
