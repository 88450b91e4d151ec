"""nengo-loihi's emulator in integers: https://github.com/nengo/nengo-loihi.

A trace of one layer runs the compartments alone: what arrives is summed here, each weight times
2^(6 + exponent), as its synapses do, and inputs act in the timestep of their row. A trace with
`layers` runs the whole emulator, with its inputs, axons, synapses and probes: row t is its
timestep t + 1, an input sent for the timestep of its row arrives in the next, as the spikes of
neurons do, and probes read at the end of a timestep. Registers that wrap are warned of, which is no
error here.
"""

import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
from nengo_loihi.block import Axon, LoihiBlock, Synapse
from nengo_loihi.emulator.interface import BlockInfo, CompartmentState, EmulatorInterface
from nengo_loihi.inputs import SpikeInput
from nengo_loihi.probe import LoihiProbe

PACKAGES = ("nengo-loihi", "nengo", "numpy")
QUANTITIES = {"u": "current", "v": "voltage", "s": "spiked"}


def record(trace: dict[str, Any]) -> dict[str, Any]:
    """Currents u, membranes v and spikes s, (T, N), of the trace's network and input."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if "layers" in trace:
            return {"layers": _emulated(np.array(trace["input_spikes"]), trace["layers"])}
        params = trace["params"]
        weights = _integers(params["weights"], params["weight_exp"])
        block = _block(weights.shape[1], params)
        state = CompartmentState(BlockInfo([block]), False)
        return _run(state, np.array(trace["input_spikes"]) @ weights)


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


def _emulated(raster: Any, layers: list[dict[str, Any]]) -> list[dict[str, Any]]:  # noqa: ANN401
    """Currents, membranes and spikes of layers that the raster (T, M) runs through."""
    source = SpikeInput(raster.shape[1])
    for step, row in enumerate(raster, start=1):
        source.add_spikes(step, np.flatnonzero(row))
    blocks: list[LoihiBlock] = []
    for params in layers:
        block = _block(len(params["weights"]), params)
        _connect(blocks[-1] if blocks else source, block, params["weights"])
        if "weights_input" in params:
            _connect(source, block, params["weights_input"])
        blocks.append(block)
    probes = [
        {name: LoihiProbe(target=block, key=key) for name, key in QUANTITIES.items()}
        for block in blocks
    ]
    everything = [probe for each in probes for probe in each.values()]
    model = SimpleNamespace(blocks=blocks, inputs=[source], probes=everything, dt=0.001)
    with EmulatorInterface(model, seed=0) as emulator:
        emulator.run_steps(len(raster))
        return [
            {
                name: np.array(emulator.collect_probe_output(probe)).astype(np.int64).tolist()
                for name, probe in each.items()
            }
            for each in probes
        ]


def _connect(source: Any, target: LoihiBlock, weights: Any) -> None:  # noqa: ANN401
    """Synapses with these weights (post, pre) from an input or a block to a block."""
    axons = _integers(weights, 0).astype(np.int32)
    synapse, axon = Synapse(len(axons)), Axon(len(axons))
    synapse.weights = [row[None] for row in axons]
    synapse.indices = [np.arange(axons.shape[1], dtype=np.int32)[None]] * len(axons)
    axon.target = synapse
    target.add_synapse(synapse)
    source.add_axon(axon)


def _integers(weights: Any, exponent: int) -> Any:  # noqa: ANN401
    """Weights (pre, post) in units of the states, from mantissas (post, pre)."""
    return np.array(weights, np.int64).T << (6 + exponent)


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
