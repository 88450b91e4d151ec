"""Compartments of nengo-loihi's emulator in integers: https://github.com/nengo/nengo-loihi.

It needs numpy below 2. Only its neurons run: what arrives is summed here, each weight times
2^(6 + exponent), as its synapses do. Inputs act in the timestep of their row. Registers that wrap
are warned of, which is not an error here.
"""

import warnings
from typing import Any

import numpy as np
from nengo_loihi.block import LoihiBlock
from nengo_loihi.emulator.interface import BlockInfo, CompartmentState

PACKAGES = ("nengo-loihi", "nengo", "numpy")


def record(trace: dict[str, Any]) -> dict[str, Any]:
    """Currents u, membranes v and spikes s, (T, N), of the trace's network and input."""
    params = trace["params"]
    weights = np.array(params["weights"], np.int64) << (6 + params["weight_exp"])
    drive = np.array(trace["input_spikes"]) @ weights.T
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _run(CompartmentState(BlockInfo([_block(len(weights), params)]), False), drive)


def _run(state: CompartmentState, drive: Any) -> dict[str, Any]:  # noqa: ANN401
    """Currents, membranes and spikes when `drive` (T, N) arrives."""
    rng = np.random.RandomState(0)  # for noise, which is off
    rows: dict[str, list[list[int]]] = {"u": [], "v": [], "s": []}
    for arriving in drive:
        state.advance_input()
        state.input[0] = arriving
        state.update(rng)
        for name, values in zip(rows, (state.current, state.voltage, state.spiked), strict=True):
            rows[name].append(values.astype(np.int64).tolist())
    return rows


def _block(size: int, params: dict[str, Any]) -> LoihiBlock:
    """Neurons whose registers hold the trace's numbers."""
    block = LoihiBlock(size)
    neurons = block.compartment
    neurons.scale_u = neurons.scale_v = False
    for name in ("decay_u", "decay_v", "bias", "refract_delay"):
        setattr(neurons, name, np.full(size, params[name], np.int32))
    neurons.vth = np.full(size, params["vth_effective"], np.int32)
    neurons.vmin, neurons.vmax = params["vmin"], params["vmax"]
    return block
