"""Traffic between cores: the messages that spikes cause under a layout, and their distances.

A ledger counts one message for each spike and each postsynaptic layer, as if every layer were on a
core of its own. With a layout of neurons on cores, a spike is one message to each core that holds a
postsynaptic neuron, as in SANA-FE: layers on one core share it, a layer on several cores takes
several, and a spike without synapses takes none.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import Ledger

Counts = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Layout:
    """The core of every neuron, and the place of every core.

    cores: of the input and of each layer, (N,) core of each neuron.
    tiles: (K, 2) column and row of the tile of each core, on the mesh of the network on chip.
    """

    cores: Mapping[str, Counts]
    tiles: Counts


@dataclass(frozen=True)
class Traffic:
    """Messages between cores; spikes to the host are not included.

    message: packets.
    hop_x, hop_y: hops between tiles of all packets, along rows and along columns.
    """

    message: int
    hop_x: int
    hop_y: int


def traffic(program: Program, spikes: Mapping[str, Counts], layout: Layout) -> Traffic:
    """The traffic of spikes, given by their number (N,) for each neuron of the input and layers."""
    message = hop_x = hop_y = 0
    for source, reached in _reached_cores(program, layout).items():
        packets = spikes[source].astype(np.int64)[:, None] * reached
        own = layout.tiles[layout.cores[source]]
        across, along = np.abs(own[:, None] - layout.tiles[None]).transpose(2, 0, 1)
        message += int(packets.sum())
        hop_x += int((packets * across).sum())
        hop_y += int((packets * along).sum())
    return Traffic(message, hop_x, hop_y)


def placed_messages(ledger: Ledger, program: Program, cores: Mapping[str, int]) -> float:
    """Messages of an inference where layers take several cores, at most.

    Every message to a layer, those of the bias axon too, goes to each of its cores, as if each had
    synapses of every neuron; those to the host stay. Equal to the ledger's on one core a layer.

    cores: of each layer; 1 where it is not named.
    """
    sent, spikes = ledger.by_layer("message"), ledger.by_layer("spike_in")
    found = 0
    for layer in program.layers:
        inside = spikes[layer.name] + ledger.timesteps * (layer.bias_fan_out > 0)
        found += sent[layer.name] + inside * (cores.get(layer.name, 1) - 1)
    return found / max(ledger.inferences, 1)


def total(parts: Iterable[Traffic]) -> Traffic:
    """The sum of the parts."""
    columns = zip(*((part.message, part.hop_x, part.hop_y) for part in parts), strict=True)
    return Traffic(*map(sum, columns))


def _reached_cores(program: Program, layout: Layout) -> dict[str, NDArray[np.bool_]]:
    """Whether each neuron of a source has synapses on each core, (N, K)."""
    reached = {
        name: np.zeros((size, len(layout.tiles)), np.bool_) for name, size in program.sizes.items()
    }
    for layer in program.layers:
        for synapses in layer.synapses:
            for core in np.unique(layout.cores[layer.name]):
                on_core = layout.cores[layer.name] == core
                reached[synapses.source][:, core] |= synapses.weight[:, on_core].any(axis=1)
    return reached
