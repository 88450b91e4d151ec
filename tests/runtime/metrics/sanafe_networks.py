"""Random networks on SANA-FE's Loihi, whose chip is its own arch/loihi.yaml, and on ours."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.bench.nets import SHIFT, layer
from lab.bench.nets import program as feed_forward
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.metrics.energy import cost, event_counts
from spikedeploy.runtime.metrics.energy_tables import TABLES

Weights = NDArray[Any]

# sizes, density, threshold, decay factors of membrane and current [/4096], loops, bias
NETWORKS = {
    "dense": ([20, 30, 10], 1.0, 200, 4096, 0, False, 0),
    "sparse": ([20, 30, 10], 0.3, 200, 3000, 0, False, 0),
    "large": ([64, 200, 100, 10], 0.2, 400, 3500, 0, False, 0),
    "recurrent": ([64, 100, 40, 10], 0.2, 300, 3500, 0, True, 0),
    "current": ([20, 30, 10], 0.5, 300, 3072, 2048, False, 0),
    "current-recurrent-biased": ([20, 30, 10], 0.5, 300, 3072, 2048, True, 20),
}


def program(case: str, seed: int) -> Program:
    """The network of that name with random weights."""
    sizes, density, threshold, membrane, current, loops, bias = NETWORKS[case]
    rng = np.random.default_rng(seed)

    def weights(rows: int, columns: int, most: int) -> Weights:
        drawn = rng.integers(-most * 2 // 3, most, (rows, columns))
        return (drawn * (rng.random((rows, columns)) < density)).astype(np.int16)

    layers = []
    for k, (before, size) in enumerate(pairwise(sizes), start=1):
        made = layer(k, weights(before, size, 120), (current, membrane), 1)
        loop = (Synapses(made.name, weights(size, size, 40), delay=1),) if loops else ()
        layers.append(
            replace(
                made,
                synapses=(*made.synapses, *loop),
                voltage_bias=(bias << SHIFT) * (rng.random(size) < 0.2),
                threshold=(threshold << SHIFT) * np.ones(size, np.int64),
                start=0,
            )
        )
    return feed_forward(layers)


@dataclass(frozen=True, eq=False)
class Layout:
    """The core of every neuron, and the place of every core.

    cores: of the input and of each layer, (N,) core of each neuron.
    tiles: (K, 2) column and row of the tile of each core, on the mesh of the network on chip.
    """

    cores: Mapping[str, Weights]
    tiles: Weights


@dataclass(frozen=True)
class MessageTraffic:
    """Messages between cores; spikes to the host are not included.

    message: packets.
    hop_x, hop_y: hops between tiles of all packets, along rows and along columns.
    """

    message: int
    hop_x: int
    hop_y: int


def traffic(program: Program, spikes: Mapping[str, Weights], layout: Layout) -> MessageTraffic:
    """The messages of spikes, given by their number (N,) for each neuron of the input and layers.

    Of several inferences, give the sums of their spikes.
    """
    message = hop_x = hop_y = 0
    for source, reached in _reached_cores(program, layout).items():
        packets = spikes[source].astype(np.int64)[:, None] * reached
        own = layout.tiles[layout.cores[source]]
        across, along = np.abs(own[:, None] - layout.tiles[None]).transpose(2, 0, 1)
        message += int(packets.sum())
        hop_x += int((packets * across).sum())
        hop_y += int((packets * along).sum())
    return MessageTraffic(message, hop_x, hop_y)


def _reached_cores(program: Program, layout: Layout) -> dict[str, NDArray[np.bool_]]:
    """Mask (N, K) of the cores on which each neuron of a source has synapses."""
    reached = {
        name: np.zeros((size, len(layout.tiles)), np.bool_) for name, size in program.sizes.items()
    }
    for each in program.layers:
        for synapses in each.synapses:
            cores, onto = layout.cores[each.name], reached[synapses.source]
            for axon in np.flatnonzero(synapses.fan_out).tolist():
                onto[axon, cores[synapses.row(axon)[1] != 0]] = True
    return reached


def energy(ledger: Ledger, sent: MessageTraffic) -> float:
    """Energy of a run [J], with the messages between placed cores."""
    return cost({**event_counts(ledger), **vars(sent)}, TABLES["sanafe"].joules)


def one_core_each(program: Program) -> Layout:
    """Every layer on a core of its own, all cores on one tile."""
    cores = {name: np.full(size, k) for k, (name, size) in enumerate(program.sizes.items())}
    return Layout(cores, np.zeros((len(cores), 2), np.int64))


def scatter(network: Program, seed: int, cores: int = 12) -> Layout:
    """Neurons placed at random on twelve cores, four to a tile."""
    rng = np.random.default_rng(seed)
    where = {name: rng.integers(0, cores, size) for name, size in network.sizes.items()}
    # their tiles are numbered along columns, of four each
    tiles = np.array([divmod(core // 4, 4) for core in range(cores)])
    return Layout(where, tiles)


def run(network: Program, raster: Weights) -> tuple[Ledger, dict[str, Weights]]:
    """Our machine after the raster, and the spikes of every neuron."""
    machine = Machine(network, trace=True)
    machine.infer(raster[None])
    seen = {name: rows.spikes[0].sum(axis=0) for name, rows in machine.recordings.items()}
    return machine.ledger, {"input": raster.sum(axis=0), **seen}


def simulate(network: Program, raster: Weights, layout: Layout) -> dict[str, Any]:
    """Results of SANA-FE for the same network on the same cores."""
    # an extra of the tests
    import sanafe

    architecture, net = sanafe.load_loihi(), sanafe.Network()
    groups = {"input": net.create_neuron_group("input", network.width)}
    for k, neuron in enumerate(groups["input"].neurons):
        spikes = {"spikes": raster[:, k].astype(int).tolist()}
        neuron.set_attributes(soma_hw_name=f"loihi_inputs[{k}]", model_attributes=spikes)
    for each in network.layers:
        groups[each.name] = neurons(net, each)
    for each in network.layers:
        for synapses in each.synapses:
            matrix = synapses.dense().weight
            pairs = np.argwhere(matrix)
            weights = {"weight": matrix[tuple(pairs.T)].astype(float).tolist()}
            source, target = groups[synapses.source], groups[each.name]
            source.connect_neurons_sparse(target, weights, [tuple(p) for p in pairs.tolist()])
    cores = architecture.cores()
    for name, group in groups.items():
        for neuron, core in zip(group.neurons, layout.cores[name].tolist(), strict=True):
            neuron.map_to_core(cores[core])
    simulator = sanafe.SpikingChip(architecture)
    simulator.load(net)
    return simulator.sim(len(raster), perf_trace=True)


def neurons(net: Any, layer: Layer) -> Any:
    """A group of SANA-FE's neurons, in units of weights: 64 of our state units."""
    constants = {
        "threshold": float(layer.threshold[0] / 64),
        "reset_mode": "hard",
        "reset": 0.0,
        "leak_decay": float(layer.membrane_decay[0] / 4096),
        "input_decay": float(layer.current_decay[0] / 4096),
    }
    group = net.create_neuron_group(
        layer.name,
        layer.size,
        soma_hw_name="loihi_lif",
        default_synapse_hw_name="loihi_dense_synapse",
        model_attributes=constants,
    )
    for neuron, bias in zip(group.neurons, (layer.voltage_bias / 64).tolist(), strict=True):
        if bias:
            neuron.set_attributes(model_attributes={"bias": bias})
    return group
