"""The load of a core: what the synapses of a block of neurons take."""

from dataclasses import dataclass

import numpy as np

from runtime.limits import Limits
from runtime.synapse_words import list_bits
from runtime.topology import Connection, Population


@dataclass(frozen=True)
class Load:
    """What one core of a division holds, where it is fullest.

    memory: synaptic memory [bit], or None where the chip's is not known.
    axons_in: different sources, the always-on axon of biases among them.
    """

    memory: int | None
    axons_in: int


def load(population: Population, limits: Limits, lists: int, block: int) -> Load:
    """What the fullest core holds when a core takes `block` neurons."""
    each = [_load(connection, limits, lists, block) for connection in population.heard]
    memory = None if limits.memory is None else sum(found.memory or 0 for found in each)
    axons = sum(found.axons_in for found in each)
    if limits.input_cores and population.biased:
        axons += 1
        if memory is not None and limits.memory is not None:
            ones = np.array([[block]])
            memory += int(list_bits(ones, block, limits.memory, delayed=False)[0])
    return Load(memory, axons)


def _load(connection: Connection, limits: Limits, lists: int, block: int) -> Load:
    fan = connection.fan
    if fan.weight is None:
        return _estimated(connection, limits, block)
    starts = np.arange(0, fan.into.size, block)
    signs = [fan.weight > 0, fan.weight < 0] if lists == 2 else [fan.weight != 0]
    counts = [np.add.reduceat(sign, starts, axis=1, dtype=np.int64) for sign in signs]
    axons = int(np.count_nonzero(sum(counts), axis=0).max())
    if limits.memory is None:
        return Load(None, axons)
    bits = sum(list_bits(count, block, limits.memory, fan.delayed) for count in counts)
    return Load(int(np.max(bits)), axons)


def _estimated(connection: Connection, limits: Limits, block: int) -> Load:
    """Where synapses are not listed: as many sources as they could have, each with its share."""
    fan = connection.fan
    synapses = block * int(fan.into.max())
    axons = min(synapses, fan.out.size)
    if limits.memory is None or not axons:
        return Load(None if limits.memory is None else 0, axons)
    each = np.full((axons, 1), -(-synapses // axons))
    return Load(int(list_bits(each, block, limits.memory, fan.delayed)[0]), axons)
