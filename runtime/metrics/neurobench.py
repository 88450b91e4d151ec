"""NeuroBench's numbers, by its own names and formulas: what its release 2.3.0 makes of a network.

Its numbers are those of a torch module built of snnTorch's neurons; here they follow from the file
and from what was recorded, and equal its own to the last bit. A sample is one inference. What its
numbers leave out or count in a way of its own is in docs/metrics.md.
"""

from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.float_model.spatial import convolution
from spikedeploy.runtime.metrics.memory import packed_bytes

WEIGHTED = (nir.Affine, nir.Linear, nir.Conv1d, nir.Conv2d)
FLOAT32 = 4  # [bytes]
# what each of snnTorch's neurons keeps besides: the factor of graded spikes, and the kind of reset
KEPT = 4 + 8  # [bytes]
# operations of an update, by neuron and reset: the table of neuron_operations.py
NEURON_OPERATIONS = {
    "Leaky": {"subtract": 4, "zero": 4},
    "Synaptic": {"subtract": 6, "zero": 8},
}


@dataclass(frozen=True)
class NeuroBench:
    """What NeuroBench says of a network and of what it did; means over the samples.

    parameter_count: weights and biases.
    footprint: [bytes] of those in float32, unless the file holds them as integers, and of the
        constants of the neurons.
    footprint_packed: [bytes] of the weights and biases in the chip's widths; our own.
    connection_sparsity: part of all weights that is 0, to 4 decimals.
    activation_sparsity: part of all neuron-timesteps without a spike.
    activation_sparsity_by_layer: the same of each layer.
    effective_macs, effective_acs: non-zero inputs times non-zero weights, of the matrices and
        timesteps in which some input is neither 0 nor 1, and of the others.
    dense: all inputs times all weights.
    membrane_updates: membranes that changed from one timestep to the next, and all in the first;
        None where membranes were not recorded.
    effective_neuron_ops, neuron_dense_ops: those, and all, times the operations of an update.
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
        """The same by NeuroBench's names; Footprint_packed is ours."""
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
    """NeuroBench's numbers of inferences from zero states.

    graph: of the file; parameters are counted there.
    program: what ran; operations are counted there, and so are weights that rounding made 0.
    spikes: (B, T, N) of the input and of each layer.
    membranes: (B, T, N) of each layer after each timestep, resets included.
    """
    samples = len(spikes[program.input])
    acs, macs = synaptic_operations(program, spikes)
    timesteps = spikes[program.input].shape[1]
    layers = {layer.name: spikes[layer.name] for layer in program.layers}
    updates = _updates(membranes) if membranes is not None else None
    operations = neuron_operations(program)
    each = {layer.name: timesteps * layer.size for layer in program.layers}
    return NeuroBench(
        parameter_count=parameter_count(graph),
        footprint=footprint(graph),
        footprint_packed=packed_bytes(program),
        connection_sparsity=connection_sparsity(graph),
        activation_sparsity=sparsity(layers.values()),
        activation_sparsity_by_layer={name: sparsity([rows]) for name, rows in layers.items()},
        effective_macs=macs / samples,
        effective_acs=acs / samples,
        dense=float(dense(graph) * timesteps),
        membrane_updates=sum(updates.values()) / samples if updates else None,
        effective_neuron_ops=_total(updates, operations) / samples if updates else None,
        neuron_dense_ops=float(_total(each, operations)),
    )


def parameter_count(graph: nir.NIRGraph) -> int:
    """Weights and biases; constants of neurons are no parameters unless they are trained."""
    return sum(array.size for node in _weighted(graph) for array in _parameters(node))


def footprint(graph: nir.NIRGraph) -> int:
    """[bytes] of the parameters, and of the constants that snnTorch's neurons keep in buffers."""
    parameters = sum(
        array.size * _width(array) for node in _weighted(graph) for array in _parameters(node)
    )
    return parameters + sum(map(_buffers, graph.nodes.values()))


def connection_sparsity(graph: nir.NIRGraph) -> float:
    """Part of all weights that is 0, where there are any; biases do not count."""
    weights = [node.weight for node in _weighted(graph)]
    if not weights:
        return 0.0
    zeros = sum(weight.size - np.count_nonzero(weight) for weight in weights)
    # divided in float32 and rounded, as theirs is
    return round(float(np.float32(zeros) / np.float32(sum(w.size for w in weights))), 4)


def sparsity(rasters: Any) -> float:  # noqa: ANN401
    """Part of all neuron-timesteps of some rasters without a spike."""
    rasters = list(rasters)
    every = sum(rows.size for rows in rasters)
    return float((every - sum(np.count_nonzero(rows) for rows in rasters)) / every)


def synaptic_operations(program: Program, spikes: Mapping[str, NDArray[Any]]) -> tuple[int, int]:
    """Effective ACs and MACs of all samples: the non-zero inputs of each matrix times its fan-out.

    Only what a matrix hears within its window counts: of a loop, not the last timestep's spikes.
    """
    acs = macs = 0
    for presynaptic, fan_out in _heard(program, spikes):
        # over batch and neurons: an input that is no spike makes its timestep one of MACs
        graded = (presynaptic > 1).any(axis=(0, 2))
        operations = (presynaptic != 0).sum(axis=0) @ fan_out
        acs += int(operations[~graded].sum())
        macs += int(operations[graded].sum())
    return acs, macs


def dense(graph: nir.NIRGraph) -> int:
    """Operations of a timestep without sparsity: all inputs times all weights, zeros included."""
    return sum(_taps(name, node) for name, node in graph.nodes.items() if _is_weighted(node))


def neuron_operations(program: Program) -> dict[str, int]:
    """Operations of an update in each layer; without a current that lasts, a neuron is Leaky."""
    reset = program.convention.reset
    return {
        layer.name: NEURON_OPERATIONS["Synaptic" if layer.current_decay.any() else "Leaky"][reset]
        for layer in program.layers
    }


def _heard(
    program: Program, spikes: Mapping[str, NDArray[Any]]
) -> Iterator[tuple[NDArray[Any], NDArray[np.int64]]]:
    """What each matrix hears (B, T - lag, M), and the non-zero weights (M,) of its rows."""
    for layer, lags in zip(program.layers, program.lags, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            rows = spikes[synapses.source]
            yield rows[:, : rows.shape[1] - lag], synapses.fan_out
    for tap in (tap for outlet in program.outlets for tap in outlet.taps):
        if tap.weight is not None:
            rows = spikes[tap.layer]
            fan_out = np.count_nonzero(tap.weight, axis=1).astype(np.int64)
            yield rows[:, : max(rows.shape[1] - tap.lag, 0)], fan_out
    if program.readout is not None:
        rows = spikes[program.output]
        fan_out = np.count_nonzero(program.readout.weight, axis=1).astype(np.int64)
        yield rows[:, : rows.shape[1] - program.readout.lag], fan_out


def _updates(membranes: Mapping[str, NDArray[Any]]) -> dict[str, int]:
    """Membranes of each layer that changed, all in the first timestep."""
    return {
        name: rows[:, 0].size + int(np.count_nonzero(rows[:, 1:] != rows[:, :-1]))
        for name, rows in membranes.items()
    }


def _total(counts: Mapping[str, int], prices: Mapping[str, int]) -> int:
    return sum(count * prices[name] for name, count in counts.items())


def _taps(name: str, node: nir.NIRNode) -> int:
    """Products of weights and inputs; of a convolution those outside its input are none."""
    if not isinstance(node, (nir.Conv1d, nir.Conv2d)):
        return int(node.weight.size)
    ones = copy(node)
    ones.weight, ones.bias = np.ones(node.weight.shape), np.zeros(len(node.weight))
    # nir forgets the groups in the channels
    shape = (node.weight.shape[1] * node.groups, *map(int, node.input_type["input"][1:]))
    return int(convolution(name, ones, np.float64)(np.ones((1, 1, *shape))).sum())


def _is_weighted(node: nir.NIRNode) -> bool:
    return isinstance(node, WEIGHTED)


def _weighted(graph: nir.NIRGraph) -> list[nir.NIRNode]:
    return [node for node in graph.nodes.values() if _is_weighted(node)]


def _parameters(node: nir.NIRNode) -> Iterator[NDArray[Any]]:
    yield node.weight
    if not isinstance(node, nir.Linear):
        yield np.asarray(node.bias)


def _width(array: NDArray[Any]) -> int:
    """[bytes] of a number: torch's default where it is a float."""
    return array.itemsize if array.dtype.kind in "iu" else FLOAT32


def _buffers(node: nir.NIRNode) -> int:
    """[bytes] of the buffers that snnTorch's neuron of this kind has before it runs."""
    if not hasattr(node, "v_threshold"):
        return 0
    decays = [getattr(node, name, 1.0) for name in ("tau", "tau_mem") if hasattr(node, name)]
    constants = [node.v_threshold, *(decays or [1.0])]
    if hasattr(node, "tau_syn"):
        constants.append(node.tau_syn)
    return KEPT + FLOAT32 * sum(map(_numbers, constants))


def _numbers(constant: Any) -> int:  # noqa: ANN401
    """One where all neurons share it."""
    values = np.asarray(constant)
    return 1 if np.all(values == values.flat[0]) else values.size
