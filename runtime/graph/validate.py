"""Validation of a NIR graph: its names, nodes, edges and ports, before anything is computed.

`nir` itself accepts NaN time constants, biases of the wrong length and names that cannot be read
back. Each message names the node or edge, what was found, and what to do.
"""

from collections import Counter

import nir
import numpy as np

from spikedeploy.runtime.errors import ArtifactError, node_error
from spikedeploy.runtime.graph.discretisation import CURRENT_BASED, LEAKY, NEURONS, SPIKING
from spikedeploy.runtime.graph.order import neighbours, reach
from spikedeploy.runtime.graph.shapes import (
    CONVOLUTIONS,
    DENSE,
    POOLS,
    Shape,
    infer_shapes,
    whole_numbers,
)

# kinds whose fields are all arrays of numbers, except for those that nir derives
_NUMERIC = (*DENSE, nir.Scale, nir.Threshold, nir.Delay, *NEURONS)
_KINDS = (nir.Input, nir.Output, *_NUMERIC, *CONVOLUTIONS, *POOLS, nir.Flatten)
# of a graph: more take seconds; a node is a whole layer
MAX_NODES = 1 << 12
MAX_EDGES = 1 << 16
_CONNECT = "Connect it or remove it."
DERIVED_FIELDS = ("input_type", "output_type", "metadata")


def check_graph(graph: nir.NIRGraph) -> None:
    """Raise ArtifactError where a graph cannot be computed; writes its shapes into its nodes."""
    check_nodes(graph)
    for kind, found in (("Input", graph.inputs), ("Output", graph.outputs)):
        if not found:
            raise ArtifactError(f"the graph has no {kind} node. Add one and an edge to it.")
        for name, node in found.items():
            shape = np.asarray(node.output_type["output"])
            if shape.dtype.kind not in "iu" or shape.ndim != 1 or not shape.size or shape.min() < 1:
                raise node_error(name, f"shape is {shape.tolist()}, not whole numbers above 0")
    infer_shapes(graph)
    driven = reach(graph.inputs, neighbours(graph.edges))
    used = reach(graph.outputs, neighbours((target, source) for source, target in graph.edges))
    for name in sorted(graph.nodes):
        if name not in driven:
            raise node_error(name, "no edges lead to it from an Input", _CONNECT)
        if name not in used:
            raise node_error(name, "no edges lead from it to an Output", _CONNECT)


def check_nodes(graph: nir.NIRGraph) -> None:
    """Raise ArtifactError where an edge or the parameters of a node are wrong."""
    check_edges(graph)
    if len(graph.nodes) > MAX_NODES:
        raise ArtifactError(
            f"the graph has {len(graph.nodes)} nodes; at most {MAX_NODES}. Write the neurons of a "
            "layer as one node, or divide the network."
        )
    for name, node in sorted(graph.nodes.items()):
        if name in ("", ".") or set(name) & {"/", "\0"}:
            raise node_error(name, "HDF5 cannot hold this name", "Choose another.")
        _check_node(name, node)


def check_edges(graph: nir.NIRGraph, path: str = "") -> None:
    """Raise ArtifactError where an edge is none of two nodes, or is there twice.

    path: of the graph inside an outer one, ending in a dot.
    """
    where = f"in node {path[:-1]!r}: " if path else ""
    for name in graph.nodes:
        if not isinstance(name, str):
            raise ArtifactError(f"{where}node {name!r}: HDF5 cannot hold this name. Use a string.")
    if len(graph.edges) > MAX_EDGES:
        raise ArtifactError(
            f"{where}{len(graph.edges)} edges; at most {MAX_EDGES}. Write the synapses between "
            "neurons as one Linear node, not as edges."
        )
    for edge, times in Counter(graph.edges).items():
        if fault := _edge_fault(graph, edge, times):
            shown = " -> ".join(map(repr, edge))
            raise ArtifactError(f"{where}edge {shown} {fault}. Correct it, or export again.")


def _edge_fault(graph: nir.NIRGraph, edge: tuple[str, ...], times: int) -> str:
    """What is wrong with an edge; empty where nothing is."""
    if len(edge) != 2:
        return "is not a pair (source, target)"
    if missing := [name for name in edge if name not in graph.nodes]:
        return f"names {missing[0]!r}, and there is no node {missing[0]!r}"
    source, target = edge
    if isinstance(graph.nodes[target], nir.Input):
        return "goes into an Input node"
    if isinstance(graph.nodes[source], nir.Output):
        return "comes out of an Output node"
    return "is there twice, which some tools read as one edge and some as a sum" * (times > 1)


def _check_node(name: str, node: nir.NIRNode) -> None:
    if not isinstance(node, _KINDS):
        known = ", ".join(kind.__name__ for kind in _KINDS)
        found = f"{type(node).__name__} is no primitive of NIR that is supported"
        raise node_error(name, found, f"Write it with {known}.")
    numeric = set(vars(node)) - set(DERIVED_FIELDS) if isinstance(node, _NUMERIC) else set()
    for field, value in sorted(vars(node).items()):
        if isinstance(value, np.ndarray) or field in numeric:
            _check_values(name, field, value)
    if isinstance(node, DENSE):
        if node.weight.ndim < 2:
            raise node_error(name, f"weight has shape {node.weight.shape}; it must be (N, M)")
        if isinstance(node, nir.Affine):
            _check_shape(name, "bias", node.bias.shape, node.weight.shape[:-1])
    if isinstance(node, CONVOLUTIONS):
        _check_convolution(name, node)
    if isinstance(node, NEURONS):
        check_neurons(name, node)
    if isinstance(node, nir.Delay) and node.delay.min() < 0:
        raise node_error(name, f"delay holds {node.delay.min():g} s; a delay must be 0 or more")


def _check_convolution(name: str, node: nir.NIRNode) -> None:
    kind, axes = type(node).__name__, 3 if isinstance(node, nir.Conv1d) else 4
    for field in ("weight", "bias"):
        _check_values(name, field, getattr(node, field))
    if node.weight.ndim != axes:
        raise node_error(name, f"weight has shape {node.weight.shape}; a {kind} needs {axes} axes")
    (groups,) = whole_numbers(name, "groups", node.groups, 1, 1)
    if len(node.weight) % groups:
        found = f"{len(node.weight)} features cannot be divided into {groups} groups"
        raise node_error(name, found)
    _check_shape(name, "bias", node.bias.shape, node.weight.shape[:1])


def check_neurons(name: str, node: nir.NIRNode) -> None:
    """Raise ArtifactError where parameters of neurons have two shapes, or are none of neurons."""
    for field in sorted(set(vars(node)) - set(DERIVED_FIELDS)):
        _check_shape(name, field, getattr(node, field).shape, node.r.shape)
    taus = ("tau",) if isinstance(node, LEAKY) else ("tau_syn", "tau_mem")
    for field in taus if isinstance(node, (*LEAKY, *CURRENT_BASED)) else ():
        if (tau := getattr(node, field)).min() <= 0:
            found = f"{field} holds {tau.min():g} s; a time constant must be above 0"
            raise node_error(name, found)
    if isinstance(node, SPIKING) and (low := node.v_threshold < node.v_reset).any():
        threshold, reset = node.v_threshold[low][0], node.v_reset[low][0]
        raise node_error(name, f"v_threshold holds {threshold:g}, below its v_reset {reset:g}")


def _check_values(name: str, field: str, value: object) -> None:
    found = np.asarray(value)
    if found.dtype.kind not in "fiu":
        raise node_error(name, f"{field} holds {found.dtype}, not numbers")
    if found.ndim == 0:
        shapeless = f"{field} is a single number without a shape"
        raise node_error(name, shapeless, "Give one value per neuron.")
    if not found.size:
        raise node_error(name, f"{field} is empty, {found.shape}")
    if not np.isfinite(found).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(found))[0])
        endless = field in ("tau", "r") and bool(np.isposinf(found).all())
        hint = " (snnTorch writes it for beta 1: --from snntorch reads that)" if endless else ""
        where = f"{field} holds {found[index]} at index {index}"
        raise node_error(name, f"{where}; every value must be finite{hint}")


def _check_shape(name: str, field: str, found: Shape, wanted: Shape) -> None:
    if found != wanted:
        others = "the node's other parameters"
        raise node_error(name, f"{field} has shape {found}; {others} need {wanted}")
