"""Traffic: the messages that spikes become on a chip of many cores, and how far they go.

A ledger knows no cores: it counts a message for each spike and each layer that hears it, as if
every layer sat on a core of its own. With a layout, a spike becomes a message to each core that
holds a neuron which it reaches, as in SANA-FE: layers that share a core share the message, layers
on several cores take several, and a spike that reaches nothing takes none.

The layout: which neuron sits on which core, and where the cores lie.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program

Counts = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Layout:
    """Neurons on cores; a mapping counts cores by the layer, a layout says them by the neuron.

    cores: of the input and of each layer, the core (N,) of each neuron.
    tiles: (K, 2) column and row of the tile of each core, on the mesh that messages travel.
    """

    cores: Mapping[str, Counts]
    tiles: Counts


def one_core_each(program: Program) -> Layout:
    """Every layer on a core of its own, all cores on one tile."""
    cores = {name: np.full(size, k) for k, (name, size) in enumerate(program.sizes.items())}
    return Layout(cores, np.zeros((len(cores), 2), np.int64))


@dataclass(frozen=True)
class Traffic:
    """What travels between cores; spikes to the host are not among it.

    message: packets.
    hop_x, hop_y: steps from tile to tile of all packets, along rows and along columns.
    """

    message: int
    hop_x: int
    hop_y: int


def traffic(program: Program, spikes: Mapping[str, Counts], layout: Layout) -> Traffic:
    """What the spikes (N,) of each neuron of the input and of each layer become."""
    message = hop_x = hop_y = 0
    for source, reached in _reached(program, layout).items():
        packets = spikes[source].astype(np.int64)[:, None] * reached
        here = layout.tiles[layout.cores[source]]
        across, along = np.abs(here[:, None] - layout.tiles[None]).transpose(2, 0, 1)
        message += int(packets.sum())
        hop_x += int((packets * across).sum())
        hop_y += int((packets * along).sum())
    return Traffic(message, hop_x, hop_y)


def joined(parts: Iterable[Traffic]) -> Traffic:
    """The sum of several."""
    columns = zip(*((part.message, part.hop_x, part.hop_y) for part in parts), strict=True)
    return Traffic(*map(sum, columns))


def _reached(program: Program, layout: Layout) -> dict[str, NDArray[np.bool_]]:
    """Which cores (N, K) each neuron of a source reaches."""
    reached = {
        name: np.zeros((size, len(layout.tiles)), np.bool_) for name, size in program.sizes.items()
    }
    for layer in program.layers:
        for synapses in layer.synapses:
            for core in np.unique(layout.cores[layer.name]):
                there = layout.cores[layer.name] == core
                reached[synapses.source][:, core] |= synapses.weight[:, there].any(axis=1)
    return reached
