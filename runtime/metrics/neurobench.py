"""NeuroBench's metrics, by its own names and formulas (release 2.3.0).

NeuroBench measures a torch module of snnTorch's neurons; here the same numbers follow from the file
and the recorded spikes, equal to the last bit. A sample is one inference. What the metrics leave
out, or count in a way of their own, is in docs/evidence.md.
"""

from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.float_model import convolution
from spikedeploy.runtime.metrics.traffic import packed_bytes

_WEIGHTED = (nir.Affine, nir.Linear, nir.Conv1d, nir.Conv2d)
_FLOAT32 = 4  # [bytes]
# further buffers of a snnTorch neuron: the factor of graded spikes, and the reset mechanism
_EXTRA_BUFFERS = 4 + 8  # [bytes]
# operations of an update, by neuron and reset: the table in NeuroBench's neuron_operations.py
_NEURON_OPERATIONS = {
    "Leaky": {"subtract": 4, "zero": 4},
    "Synaptic": {"subtract": 6, "zero": 8},
}


def neurobench(
    graph: nir.NIRGraph,
    program: Program,
    spikes: Mapping[str, NDArray[Any]],
    membranes: Mapping[str, NDArray[Any]] | None = None,
) -> dict[str, Any]:
    """NeuroBench's metrics, by its names, of inferences that started from zero states.

    Counts are means over the samples.

    ParameterCount: weights and biases; constants of neurons count only where they are trained.
    Footprint: [bytes] of those in float32, unless the file holds them as integers, and of the
        constants of the neurons.
    Footprint_packed: [bytes] of weights and biases in the chip's widths; not of NeuroBench.
    ConnectionSparsity: fraction of all weights that is 0, to 4 decimals.
    ActivationSparsity, ActivationSparsityByLayer: fraction of all neurons and timesteps without a
        spike, of the layers that can spike; 0 where none can.
    SynapticOperations: products of non-zero inputs and non-zero weights; "Effective_MACs" in the
        timesteps in which some input of the matrix is neither 0 nor 1, "Effective_ACs" in the
        others; "Dense" those of all inputs and all weights.
    MembraneUpdates: membranes that changed from one timestep to the next, and all in the first;
        None where membranes were not recorded.
    NeuronOperations: those updates, and all neurons and timesteps, times the operations of one.

    graph: of the file, for the parameters.
    program: that ran, for the operations; a weight that rounding made 0 is none of them.
    spikes: (B, T, N) of the input and of each layer.
    membranes: (B, T, N) of each layer after each timestep, resets included.
    """
    samples, timesteps, _ = spikes[program.input].shape
    acs, macs = _synaptic_operations(program, _sent(program, spikes, membranes))
    layers = {layer.name: spikes[layer.name] for layer in program.spiking}
    each = {layer.name: _operations(program, layer) for layer in program.layers}
    updates = operations = None
    if membranes is not None:
        changes = _updates(membranes)
        updates = sum(changes.values()) / samples
        operations = sum(n * each[name] for name, n in changes.items()) / samples
    dense = sum(layer.size * each[layer.name] for layer in program.layers)
    return {
        "ParameterCount": sum(array.size for array in _parameters(graph)),
        "Footprint": footprint(graph),
        "Footprint_packed": packed_bytes(program),
        "ConnectionSparsity": connection_sparsity(graph),
        "ActivationSparsity": sparsity(layers.values()),
        "ActivationSparsityByLayer": {name: sparsity([rows]) for name, rows in layers.items()},
        "SynapticOperations": {
            "Effective_MACs": macs / samples,
            "Effective_ACs": acs / samples,
            "Dense": float(dense_operations(graph) * timesteps),
        },
        "MembraneUpdates": updates,
        "NeuronOperations": {
            "Effective Neuron Ops": operations,
            "Neuron Dense Ops": float(timesteps * dense),
        },
    }


def footprint(graph: nir.NIRGraph) -> int:
    """Size [bytes] of the parameters, and of the constants in the buffers of snnTorch's neurons."""
    sizes = (array.size * _width(array) for array in _parameters(graph))
    return sum(sizes) + sum(map(_buffers, graph.nodes.values()))


def connection_sparsity(graph: nir.NIRGraph) -> float:
    """Fraction of all weights that is 0, biases not counted; 0 where there are no weights."""
    weights = [node.weight for node in _weighted(graph).values()]
    if not weights:
        return 0.0
    zeros = sum(weight.size - np.count_nonzero(weight) for weight in weights)
    # divided in float32 and rounded, as NeuroBench does
    return round(float(np.float32(zeros) / np.float32(sum(w.size for w in weights))), 4)


def sparsity(rasters: Iterable[NDArray[Any]]) -> float:
    """Fraction of all neurons and timesteps of some rasters without a spike; 0 of none."""
    counts = [(rows.size, np.count_nonzero(rows)) for rows in rasters]
    every, spiking = (sum(column) for column in zip(*counts, strict=True)) if counts else (0, 0)
    return float((every - spiking) / every) if every else 0.0


def _sent(
    program: Program,
    spikes: Mapping[str, NDArray[Any]],
    membranes: Mapping[str, NDArray[Any]] | None,
) -> dict[str, NDArray[Any]]:
    """(B, T, N) of what each layer sends: spikes, or 2 for a membrane, which is no spike."""
    sent, (batch, timesteps, _) = dict(spikes), spikes[program.input].shape
    for layer in (*program.layers, *program.host):
        if not layer.spiking:
            recorded = (membranes or {}).get(layer.name, np.ones((batch, timesteps, layer.size)))
            sent[layer.name] = np.where(recorded != 0, np.uint8(2), np.uint8(0))
    return sent


def _synaptic_operations(program: Program, sent: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
    """Effective ACs and MACs of all samples: non-zero inputs of each matrix times their fan-out.

    Only spikes that arrive within the inference count: in a loop, not those of the last timestep.
    """
    matrices = [
        (synapses.source, synapses.fan_out, lag)
        for layer, lags in zip(program.layers, program.lags, strict=True)
        for synapses, lag in zip(layer.synapses, lags, strict=True)
    ]
    matrices += [(s.source, s.fan_out, s.delay) for layer in program.host for s in layer.synapses]
    matrices += [
        (term.layer, np.count_nonzero(term.weight, axis=1).astype(np.int64), term.lag)
        for term in program.output_terms
        if term.weight is not None
    ]
    acs = macs = 0
    for source, fan_out, lag in matrices:
        presynaptic = sent[source][:, : max(sent[source].shape[1] - lag, 0)]
        # an input beyond 1 of any sample makes the operations of its timestep MACs
        graded = (np.abs(presynaptic) > 1).any(axis=(0, 2))
        operations = (presynaptic != 0).sum(axis=0) @ fan_out
        acs += int(operations[~graded].sum())
        macs += int(operations[graded].sum())
    return acs, macs


def dense_operations(graph: nir.NIRGraph) -> int:
    """Operations of a timestep: all inputs times all weights, zeros included."""
    return sum(_products(name, node) for name, node in _weighted(graph).items())


def dense_products(graph: nir.NIRGraph) -> int:
    """Return `dense_operations` without identities into the output, which compute nothing."""
    last = {source for source, target in graph.edges if target in graph.outputs}
    weights = [node.weight for name, node in _weighted(graph).items() if name in last]
    return dense_operations(graph) - sum(int(w.size) for w in weights if is_identity(w))


def is_identity(weight: NDArray[Any]) -> bool:
    """Return True if a matrix only hands on what arrives."""
    square = weight.ndim == 2 and weight.shape[0] == weight.shape[1]
    return square and np.array_equal(weight, np.eye(len(weight)))


def _operations(program: Program, layer: Layer) -> int:
    """Operations of an update in a layer; a neuron whose current does not last is Leaky."""
    kind = "Synaptic" if layer.current_decay.any() else "Leaky"
    return _NEURON_OPERATIONS[kind][program.convention.reset]


def _updates(membranes: Mapping[str, NDArray[Any]]) -> dict[str, int]:
    """Number of membranes in each layer that changed, all in the first timestep included."""
    return {
        name: rows[:, 0].size + int(np.count_nonzero(rows[:, 1:] != rows[:, :-1]))
        for name, rows in membranes.items()
    }


def _products(name: str, node: nir.NIRNode) -> int:
    """Products of weights and inputs; a convolution has none with its padding."""
    if not isinstance(node, (nir.Conv1d, nir.Conv2d)):
        return int(node.weight.size)
    ones = copy(node)
    ones.weight, ones.bias = np.ones(node.weight.shape), np.zeros(len(node.weight))
    # nir infers the channels of one group only
    shape = (node.weight.shape[1] * node.groups, *map(int, node.input_type["input"][1:]))
    return int(convolution(name, ones, np.float64)(np.ones((1, 1, *shape))).sum())


def _weighted(graph: nir.NIRGraph) -> dict[str, nir.NIRNode]:
    return {name: node for name, node in graph.nodes.items() if isinstance(node, _WEIGHTED)}


def _parameters(graph: nir.NIRGraph) -> Iterator[NDArray[Any]]:
    """All weights and biases."""
    for node in _weighted(graph).values():
        yield node.weight
        if not isinstance(node, nir.Linear):
            yield np.asarray(node.bias)


def _width(array: NDArray[Any]) -> int:
    """Size [bytes] of a value: floats are float32, torch's default."""
    return array.itemsize if array.dtype.kind in "iu" else _FLOAT32


def _buffers(node: nir.NIRNode) -> int:
    """Size [bytes] of the buffers of snnTorch's neuron of this kind before it runs."""
    if not hasattr(node, "v_threshold"):
        return 0
    decays = [getattr(node, name) for name in ("tau", "tau_mem") if hasattr(node, name)]
    constants = [node.v_threshold, *(decays or [1.0])]
    if hasattr(node, "tau_syn"):
        constants.append(node.tau_syn)
    arrays = [np.asarray(constant) for constant in constants]
    stored = (1 if np.all(each == each.flat[0]) else each.size for each in arrays)
    return _EXTRA_BUFFERS + _FLOAT32 * sum(stored)
