"""Soundness: what must be true of a NIR graph before anything is computed with it.

`nir` itself accepts NaN time constants, biases of the wrong length and names that cannot be read
back, so the checks are here, and each message names the node, what was found and what to do.

The edges of a graph: pairs of nodes that exist, each once, and a way through every node.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import CURRENT_BASED, LEAKY, NEURONS, SPIKING
from spikedeploy.runtime.graph.shapes import infer_shapes
from spikedeploy.runtime.graph.windows import CONVOLUTIONS, POOLS, whole_numbers

REMEDY = "Export the network again, or correct the edge."


def check_edges(graph: nir.NIRGraph, path: str = "") -> None:
    """Refuse edges that make no graph; `path` is where an inner graph is, with a dot behind."""
    where = f"in node {path[:-1]!r}: " if path else ""
    for name in graph.nodes:
        if not isinstance(name, str):
            raise ArtifactError(
                f"{where}node {name!r}: HDF5 cannot hold this name. Choose a text instead."
            )
    for edge in graph.edges:
        _check_edge(graph, edge, where)
    doubles = sorted(edge for edge, times in Counter(graph.edges).items() if times > 1)
    if doubles:
        source, target = doubles[0]
        raise ArtifactError(
            f"{where}edge {source!r} -> {target!r} is there twice, which tools read as one or as a "
            "sum. Remove one."
        )


def check_connected(graph: nir.NIRGraph) -> None:
    """Refuse nodes that no input reaches, and nodes from which no output is reached."""
    turned = [(target, source) for source, target in graph.edges]
    after, before = _reached(graph.inputs, graph.edges), _reached(graph.outputs, turned)
    for name in sorted(graph.nodes):
        if name not in after:
            raise ArtifactError(
                f"node {name!r}: no edges lead to it from an Input, so that nothing would ever "
                "arrive. Connect it or remove it."
            )
        if name not in before:
            raise ArtifactError(
                f"node {name!r}: no edges lead from it to an Output, so that nobody would hear it. "
                "Connect it or remove it."
            )


def _reached(starts: Iterable[str], edges: Iterable[tuple[str, str]]) -> set[str]:
    """The starts and every node on a way from them."""
    ahead = defaultdict(list)
    for source, target in edges:
        ahead[source].append(target)
    found, waiting = set(starts), list(starts)
    while waiting:
        new = set(ahead[waiting.pop()]) - found
        found |= new
        waiting.extend(new)
    return found


def _check_edge(graph: nir.NIRGraph, edge: object, where: str) -> None:
    if not (isinstance(edge, tuple) and len(edge) == 2):
        raise ArtifactError(f"{where}edge {edge!r} is not a pair (source, target). {REMEDY}")
    source, target = edge
    for name in edge:
        if name not in graph.nodes:
            raise ArtifactError(
                f"{where}edge {source!r} -> {target!r}: there is no node {name!r}; the nodes are "
                f"{', '.join(sorted(graph.nodes))}. Correct the edge or add the node."
            )
    if isinstance(graph.nodes[target], nir.Input):
        raise ArtifactError(
            f"{where}edge {source!r} -> {target!r} goes into an Input node. Point it at the node "
            "that follows."
        )
    if isinstance(graph.nodes[source], nir.Output):
        raise ArtifactError(
            f"{where}edge {source!r} -> {target!r} comes out of an Output node. Let it start at "
            "the node before."
        )


# kinds whose every field is an array of numbers, except for what nir derives
DENSE = (nir.Affine, nir.Linear)
NUMERIC = (*DENSE, nir.Scale, nir.Threshold, nir.Delay, *NEURONS)
KINDS = (nir.Input, nir.Output, *NUMERIC, *CONVOLUTIONS, *POOLS, nir.Flatten)
DERIVED = ("input_type", "output_type", "metadata")
WRITE_AGAIN = "Export the network again, or correct the node."


def check_graph(graph: nir.NIRGraph) -> None:
    """Refuse a graph that is not sound; fills in the shapes that NIR infers."""
    check_edges(graph)
    for name in sorted(graph.nodes):
        _check_name(name)
        _check_node(name, graph.nodes[name])
    _check_ends(graph)
    infer_shapes(graph)
    check_connected(graph)


def _check_name(name: str) -> None:
    if name in ("", ".") or set(name) & {"/", "\0"}:
        raise ArtifactError(
            f"node {name!r}: HDF5 cannot hold this name. Choose one that is not empty, not '.' "
            "and has no '/' and no zero byte."
        )


def _check_node(name: str, node: nir.NIRNode) -> None:
    if not isinstance(node, KINDS):
        raise ArtifactError(
            f"node {name!r}: {type(node).__name__} is no primitive of NIR that has a meaning here. "
            f"Write it with {', '.join(kind.__name__ for kind in KINDS)}."
        )
    for field, value in sorted(vars(node).items()):
        if isinstance(value, np.ndarray) or (isinstance(node, NUMERIC) and field not in DERIVED):
            _check_values(name, field, value)
    if isinstance(node, DENSE):
        _check_dense(name, node)
    if isinstance(node, CONVOLUTIONS):
        _check_convolution(name, node)
    if isinstance(node, NEURONS):
        _check_neurons(name, node)
    if isinstance(node, nir.Delay) and node.delay.min() < 0:
        raise ArtifactError(
            f"node {name!r}: delay holds {node.delay.min():g} s; nothing arrives before it left. "
            f"{WRITE_AGAIN}"
        )


def _check_dense(name: str, node: nir.NIRNode) -> None:
    if node.weight.ndim < 2:
        raise ArtifactError(
            f"node {name!r}: weight has shape {node.weight.shape}; it must be (N, M). {WRITE_AGAIN}"
        )
    if isinstance(node, nir.Affine):
        _same_shape(name, "bias", node.bias.shape, node.weight.shape[:-1])


def _check_convolution(name: str, node: nir.NIRNode) -> None:
    axes = 3 if isinstance(node, nir.Conv1d) else 4
    for field in ("weight", "bias"):
        _check_values(name, field, getattr(node, field))
    if node.weight.ndim != axes:
        raise ArtifactError(
            f"node {name!r}: weight has shape {node.weight.shape}; a {type(node).__name__} needs "
            f"{axes} axes: features, channels of a group, kernel. {WRITE_AGAIN}"
        )
    (groups,) = whole_numbers(name, "groups", node.groups, 1, least=1)
    if len(node.weight) % groups:
        raise ArtifactError(
            f"node {name!r}: {len(node.weight)} features cannot be divided into {groups} groups. "
            f"{WRITE_AGAIN}"
        )
    _same_shape(name, "bias", node.bias.shape, node.weight.shape[:1])


def _check_neurons(name: str, node: nir.NIRNode) -> None:
    for field in sorted(set(vars(node)) - set(DERIVED)):
        _same_shape(name, field, getattr(node, field).shape, node.r.shape)
    taus = ("tau",) if isinstance(node, LEAKY) else ("tau_syn", "tau_mem")
    for field in taus if isinstance(node, (*LEAKY, *CURRENT_BASED)) else ():
        _check_time_constant(name, field, getattr(node, field))
    if isinstance(node, SPIKING) and (node.v_threshold < node.v_reset).any():
        low = node.v_threshold < node.v_reset
        raise ArtifactError(
            f"node {name!r}: v_threshold holds {node.v_threshold[low][0]:g}, below its v_reset "
            f"{node.v_reset[low][0]:g}: a spike would bring on the next. {WRITE_AGAIN}"
        )


def _check_values(name: str, field: str, value: object) -> None:
    found = np.asarray(value)
    if found.dtype.kind not in "fiu":
        raise ArtifactError(
            f"node {name!r}: {field} holds {found.dtype}, not numbers. {WRITE_AGAIN}"
        )
    if found.ndim == 0:
        raise ArtifactError(
            f"node {name!r}: {field} is a single number without a shape. Give one value per neuron."
        )
    if not found.size:
        raise ArtifactError(f"node {name!r}: {field} is empty, {found.shape}. {WRITE_AGAIN}")
    if not np.isfinite(found).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(found))[0])
        raise ArtifactError(
            f"node {name!r}: {field} holds {found[index]} at index {index}; every value must be "
            f"finite. {WRITE_AGAIN}"
        )


def _same_shape(name: str, field: str, found: tuple[int, ...], wanted: tuple[int, ...]) -> None:
    if found != wanted:
        raise ArtifactError(
            f"node {name!r}: {field} has shape {found}; the node's other parameters need "
            f"{wanted}. {WRITE_AGAIN}"
        )


def _check_time_constant(name: str, field: str, tau: NDArray[np.generic]) -> None:
    if tau.size and tau.min() <= 0:
        raise ArtifactError(
            f"node {name!r}: {field} holds {tau.min():g} s; a time constant must be above 0. "
            f"{WRITE_AGAIN}"
        )


def _check_ends(graph: nir.NIRGraph) -> None:
    for kind, found in (("Input", graph.inputs), ("Output", graph.outputs)):
        if not found:
            raise ArtifactError(f"the graph has no {kind} node. Add one and an edge to it.")
    for name, node in {**graph.inputs, **graph.outputs}.items():
        shape = np.asarray(node.output_type["output"])
        if shape.dtype.kind not in "iu" or shape.ndim != 1 or not shape.size or shape.min() < 1:
            raise ArtifactError(
                f"node {name!r}: shape is {shape.tolist()}; it must be whole numbers above 0. "
                f"{WRITE_AGAIN}"
            )
