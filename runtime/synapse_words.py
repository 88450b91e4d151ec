"""What synapses take of a core's memory.

Loihi's synapses lie in words of 64 bits: the synapses of an axon in blocks of up to 64, each block
with 10 bits of its own and rounded up to whole words (nengo-loihi 1.1.0, bits_per_axon). A sparse
list names the neuron of each synapse, a dense one stores every weight of the core, zeros included.
"""

import math

import numpy as np
from numpy.typing import NDArray

from runtime.limits import SynapticMemory

Counts = NDArray[np.int64]

WORD = 64
BLOCK = 64
OVERHEAD = 10
INDEX_BITS = (6, 7, 8, 9, 10, 11, 12)
DELAY_BITS = 6


def axon_bits(synapses: Counts, bits: int) -> Counts:
    """What an axon of so many synapses of so many bits takes in words [bit]."""
    blocks, rest = np.divmod(synapses, BLOCK)
    full = _words(BLOCK * bits + OVERHEAD)
    return np.asarray(blocks * full + np.where(rest, _words(rest * bits + OVERHEAD), 0))


def list_bits(counts: Counts, neurons: int, memory: SynapticMemory, delayed: bool) -> Counts:
    """What one list takes in each of k cores [bit].

    counts: (M, k) synapses of each axon in each core.
    neurons: of a core.
    delayed: whether each synapse has a delay of its own.
    """
    if memory.cost == "bits":
        return np.asarray(counts.sum(axis=0) * memory.weight_bits)
    bits = memory.weight_bits + (DELAY_BITS if delayed else 0)
    sparse = axon_bits(counts, bits + index_bits(neurons)).sum(axis=0)
    dense = np.count_nonzero(counts, axis=0) * axon_bits(np.array([neurons]), bits)
    return np.asarray(np.minimum(sparse, dense))


def index_bits(neurons: int) -> int:
    """What names one of so many neurons in a sparse list."""
    needed = math.ceil(math.log2(neurons)) if neurons > 1 else 0
    return next((bits for bits in INDEX_BITS if bits >= needed), needed)


def _words(bits: Counts | int) -> Counts:
    return np.asarray(-(-np.asarray(bits) // WORD) * WORD)
