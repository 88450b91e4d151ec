"""Time of an inference on Xylo: clock cycles of its core, by rockpool's model.

There is no energy: for Xylo only the power of whole tasks is published, none of an operation.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.metrics.energy import EnergyEstimate

# [clock cycles] rockpool 3.1, devices/xylo/syns61201 cycles_model; the same for all Xylos
_INPUT_LOOP = 3.5
_HIDDEN_UPDATE = 7
_OUTPUT_UPDATE = 8
_HIDDEN_FIXED = 19
_OUTPUT_FIXED = 12
_CLOCK = 50e6  # [Hz] rockpool's default for the core
_MARGIN = 0.2  # safety margin of rockpool


def xylo_time(
    program: Program, spikes: Mapping[str, NDArray[Any]], clock: float = _CLOCK
) -> EnergyEstimate:
    """Time of an inference [s], up to that with rockpool's margin.

    spikes: (B, T, N) of the input and of each layer.
    clock: [Hz] frequency of the core.
    """
    timesteps = spikes[program.input].shape[1]
    seconds = timesteps * xylo_clocks(program, spikes) / clock
    return EnergyEstimate(seconds, seconds, seconds * (1 + _MARGIN))


def xylo_clocks(program: Program, spikes: Mapping[str, NDArray[Any]]) -> float:
    """Mean clock cycles of a timestep; several events of a neuron cost as much as one.

    spikes: (B, T, N) of the input and of each layer.
    """
    outputs = program.layer(program.output).size
    clocks = float(_OUTPUT_FIXED * outputs)
    for layer in program.layers:
        if layer.name == program.output:
            continue
        rate = _rate(spikes[layer.name])
        # in = Nin (3.5 p_in N + 1)      out = N p (1 + 8 Nout)
        clocks += program.width * (_INPUT_LOOP * _rate(spikes[program.input]) * layer.size + 1)
        clocks += layer.size * rate * (1 + _OUTPUT_UPDATE * outputs)
        clocks += layer.size * _hidden(layer, rate)
    return clocks


def _hidden(layer: Layer, rate: float) -> float:
    """Clock cycles of one hidden neuron, its recurrent synapses and its spikes."""
    loops = [s for s in layer.synapses if s.source == layer.name and s.current == 0]
    fan_out = sum(float(synapses.fan_out.mean()) for synapses in loops)
    # aliases of a neuron, and neurons that have it as an alias: the same on average
    alias = sum(map(len, layer.aliases)) / layer.size
    both = alias * alias
    spiking = (
        2 * max(rate, both)
        + 3 * max(rate * alias, both)
        + rate
        + max(rate, alias) * alias
    )  # fmt: skip
    return _HIDDEN_UPDATE * fan_out * rate + 3 + _HIDDEN_FIXED + spiking


def _rate(raster: NDArray[Any]) -> float:
    return float(np.count_nonzero(raster) / raster.size)


# name, as arithmetics give it -> [s] of an inference
TIME_MODELS: dict[str, Callable[[Program, Mapping[str, NDArray[Any]]], EnergyEstimate]] = {
    "xylo-clocks": xylo_time
}
