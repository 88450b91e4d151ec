"""NeuroBench's metrics, by its own names and formulas (release 2.3.0).

NeuroBench measures a torch module of snnTorch's neurons; here the same numbers follow from the file
and the recorded spikes, equal to the last bit. A sample is one inference. What the metrics leave
out, or count in a way of their own, is in docs/evidence.md.
"""

from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True)
class NeuroBench:
    """NeuroBench's metrics of a network and its inferences; counts are means over the samples.

    parameter_count: weights and biases.
    footprint: [bytes] of those in float32, unless the file holds them as integers, and of the
        constants of the neurons.
    footprint_packed: [bytes] of weights and biases in the chip's widths; not of NeuroBench.
    connection_sparsity: fraction of all weights that is 0, to 4 decimals.
    activation_sparsity: fraction of all neurons and timesteps without a spike, of the layers that
        can spike; 0 where none can.
    activation_sparsity_by_layer: that of each layer.
    effective_macs, effective_acs: products of non-zero inputs and non-zero weights; MACs in the
        timesteps in which some input of the matrix is neither 0 nor 1, ACs in the others.
    dense: products of all inputs and all weights.
    membrane_updates: membranes that changed from one timestep to the next, and all in the first;
        None where membranes were not recorded.
    effective_neuron_ops, neuron_dense_ops: membrane updates, and all neurons and timesteps, times
        the operations of an update.
    """

    parameter_count: int
    footprint: int
    footprint_packed: float | None
    connection_sparsity: float
    activation_sparsity: float
    activation_sparsity_by_layer: Mapping[str, float]
    effective_macs: float
    effective_acs: float
    dense: float
    membrane_updates: float | None
    effective_neuron_ops: float | None
    neuron_dense_ops: float

    def as_json(self) -> dict[str, Any]:
        """Return the metrics by NeuroBench's names, and Footprint_packed, which is none."""
        return {
            "ParameterCount": self.parameter_count,
            "Footprint": self.footprint,
            "Footprint_packed": self.footprint_packed,
            "ConnectionSparsity": self.connection_sparsity,
            "ActivationSparsity": self.activation_sparsity,
            "ActivationSparsityByLayer": dict(self.activation_sparsity_by_layer),
            "SynapticOperations": {
                "Effective_MACs": self.effective_macs,
                "Effective_ACs": self.effective_acs,
                "Dense": self.dense,
            },
            "MembraneUpdates": self.membrane_updates,
            "NeuronOperations": {
                "Effective Neuron Ops": self.effective_neuron_ops,
                "Neuron Dense Ops": self.neuron_dense_ops,
            },
        }


def neurobench(
    graph: nir.NIRGraph,
    program: Program,
    spikes: Mapping[str, NDArray[Any]],
    membranes: Mapping[str, NDArray[Any]] | None = None,
) -> NeuroBench:
    """NeuroBench's metrics of inferences that started from zero states.

    graph: of the file, for the parameters.
    program: that ran, for the operations; a weight that rounding made 0 is none of them.
    spikes: (B, T, N) of the input and of each layer.
    membranes: (B, T, N) of each layer after each timestep, resets included.
    """
    samples, timesteps, _ = spikes[program.input].shape
    acs, macs = _synaptic_operations(program, _sent(program, spikes, membranes))
    layers = {layer.name: spikes[layer.name] for layer in program.spiking}
    updates = operations = None
    if membranes is not None:
        changes = _updates(membranes)
        updates = sum(changes.values()) / samples
        operations = sum(n * _operations(program, name) for name, n in changes.items()) / samples
    dense = sum(layer.size * _operations(program, layer.name) for layer in program.layers)
    return NeuroBench(
        parameter_count=parameter_count(graph),
        footprint=footprint(graph),
        footprint_packed=packed_bytes(program),
        connection_sparsity=connection_sparsity(graph),
        activation_sparsity=sparsity(layers.values()),
        activation_sparsity_by_layer={name: sparsity([rows]) for name, rows in layers.items()},
        effective_macs=macs / samples,
        effective_acs=acs / samples,
        dense=float(dense_operations(graph) * timesteps),
        membrane_updates=updates,
        effective_neuron_ops=operations,
        neuron_dense_ops=float(timesteps * dense),
    )


def parameter_count(graph: nir.NIRGraph) -> int:
    """Weights and biases; NeuroBench counts constants of neurons only where they are trained."""
    return sum(array.size for node in _weighted(graph) for array in _parameters(node))


def footprint(graph: nir.NIRGraph) -> int:
    """Size [bytes] of the parameters, and of the constants in the buffers of snnTorch's neurons."""
    parameters = sum(
        array.size * _width(array) for node in _weighted(graph) for array in _parameters(node)
    )
    return parameters + sum(map(_buffers, graph.nodes.values()))


def connection_sparsity(graph: nir.NIRGraph) -> float:
    """Fraction of all weights that is 0, biases not counted; 0 where there are no weights."""
    weights = [node.weight for node in _weighted(graph)]
    if not weights:
        return 0.0
    zeros = sum(weight.size - np.count_nonzero(weight) for weight in weights)
    # divided in float32 and rounded, as NeuroBench does
    return round(float(np.float32(zeros) / np.float32(sum(w.size for w in weights))), 4)


def sparsity(rasters: Any) -> float:  # noqa: ANN401
    """Fraction of all neurons and timesteps of some rasters without a spike; 0 of none."""
    rasters = list(rasters)
    every = sum(rows.size for rows in rasters)
    if not every:
        return 0.0
    return float((every - sum(np.count_nonzero(rows) for rows in rasters)) / every)


def _sent(
    program: Program,
    spikes: Mapping[str, NDArray[Any]],
    membranes: Mapping[str, NDArray[Any]] | None,
) -> dict[str, NDArray[Any]]:
    """(B, T, N) of what each layer sends: spikes, or 2 for a membrane, which is no spike."""
    sent = dict(spikes)
    for layer in program.layers:
        if not layer.spiking:
            ones = np.ones((*spikes[program.input].shape[:2], layer.size), np.uint8)
            sent[layer.name] = 2 * (ones if membranes is None else membranes[layer.name] != 0)
    for layer in program.host:
        sent[layer.name] = np.full((*spikes[program.input].shape[:2], layer.size), 2, np.uint8)
    return sent


def _synaptic_operations(program: Program, spikes: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
    """Effective ACs and MACs of all samples: non-zero inputs of each matrix times their fan-out.

    Only spikes that arrive within the inference count: in a loop, not those of the last timestep.
    """
    acs = macs = 0
    for presynaptic, fan_out in _presynaptic(program, spikes):
        # an input beyond 1 of any sample makes the operations of its timestep MACs
        graded = (np.abs(presynaptic) > 1).any(axis=(0, 2))
        operations = (presynaptic != 0).sum(axis=0) @ fan_out
        acs += int(operations[~graded].sum())
        macs += int(operations[graded].sum())
    return acs, macs


def dense_operations(graph: nir.NIRGraph) -> int:
    """Operations of a timestep: all inputs times all weights, zeros included."""
    return sum(_products(name, node) for name, node in graph.nodes.items() if _is_weighted(node))


def dense_products(graph: nir.NIRGraph) -> int:
    """Return `dense_operations` without identities into the output, which compute nothing."""
    last = {source for source, target in graph.edges if target in graph.outputs}
    weights = [graph.nodes[name].weight for name in last if _is_weighted(graph.nodes[name])]
    return dense_operations(graph) - sum(int(w.size) for w in weights if is_identity(w))


def is_identity(weight: NDArray[Any]) -> bool:
    """Return True if a matrix only hands on what arrives."""
    square = weight.ndim == 2 and weight.shape[0] == weight.shape[1]
    return square and np.array_equal(weight, np.eye(len(weight)))


def _operations(program: Program, layer: str) -> int:
    """Operations of an update in a layer; a neuron whose current does not last is Leaky."""
    kind = "Synaptic" if program.layer(layer).current_decay.any() else "Leaky"
    return _NEURON_OPERATIONS[kind][program.convention.reset]


def _presynaptic(
    program: Program, spikes: Mapping[str, NDArray[Any]]
) -> Iterator[tuple[NDArray[Any], NDArray[np.int64]]]:
    """Inputs (B, T - lag, M) of each matrix, and the non-zero weights (M,) of its rows."""
    matrices = [
        (synapses.source, synapses.fan_out, lag)
        for layer, lags in zip(program.layers, program.lags, strict=True)
        for synapses, lag in zip(layer.synapses, lags, strict=True)
    ]
    matrices += [(s.source, s.fan_out, s.delay) for layer in program.host for s in layer.synapses]
    for term in program.output_terms:
        if term.weight is not None:
            fan_out = np.count_nonzero(term.weight, axis=1).astype(np.int64)
            matrices.append((term.layer, fan_out, term.lag))
    for source, fan_out, lag in matrices:
        yield spikes[source][:, : max(spikes[source].shape[1] - lag, 0)], fan_out


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


def _is_weighted(node: nir.NIRNode) -> bool:
    return isinstance(node, _WEIGHTED)


def _weighted(graph: nir.NIRGraph) -> list[nir.NIRNode]:
    return [node for node in graph.nodes.values() if _is_weighted(node)]


def _parameters(node: nir.NIRNode) -> Iterator[NDArray[Any]]:
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
    decays = [getattr(node, name, 1.0) for name in ("tau", "tau_mem") if hasattr(node, name)]
    constants = [node.v_threshold, *(decays or [1.0])]
    if hasattr(node, "tau_syn"):
        constants.append(node.tau_syn)
    return _EXTRA_BUFFERS + _FLOAT32 * sum(map(_stored_values, constants))


def _stored_values(constant: Any) -> int:  # noqa: ANN401
    values = np.asarray(constant)
    return 1 if np.all(values == values.flat[0]) else values.size
