"""Shapes that some tools write with axes of one in front, for batch or time, taken off.

NIR counts neither. A weight matrix takes (M,), a Conv1d (C, X), a Conv2d or pool (C, Y, X); what
stands beside one with the same axes and further ones of length 1 before them has a batch.
"""

import copy
from collections.abc import Iterable

import nir
import numpy as np

from spikedeploy.runtime.graph.neurons import NEURONS
from spikedeploy.runtime.graph.shapes import DENSE
from spikedeploy.runtime.graph.windows import POOLS

_ELEMENTWISE = (*NEURONS, nir.Threshold, nir.Scale, nir.Delay)
_PORTS = (nir.Input, nir.Output)


def without_batch_axis(graph: nir.NIRGraph) -> nir.NIRGraph:
    """The graph, ports and neurons without leading axes of 1 that its weights do not have."""
    axes = _axes(graph)
    nodes = {name: _stripped(node, axes.get(name)) for name, node in graph.nodes.items()}
    if all(node is graph.nodes[name] for name, node in nodes.items()):
        return graph
    return nir.NIRGraph(nodes, list(graph.edges), metadata=graph.metadata, type_check=False)


def _axes(graph: nir.NIRGraph) -> dict[str, int]:
    """Number of axes of what arrives at a node or leaves it, where the weights beside it say so."""
    known = {name: axes for name, node in graph.nodes.items() if (axes := _own_axes(node))}
    waiting = list(known)
    near: dict[str, set[str]] = {}
    for source, target in graph.edges:
        near.setdefault(source, set()).add(target)
        near.setdefault(target, set()).add(source)
    for here in waiting:
        for name in sorted(near.get(here, ())):
            node = graph.nodes.get(name)
            if name not in known and isinstance(node, (*_ELEMENTWISE, *_PORTS)):
                known[name] = known[here]
                waiting.append(name)
    return known


def _own_axes(node: nir.NIRNode) -> int:
    """Axes that the weights of a node imply; 0 where they imply none."""
    if isinstance(node, DENSE) and np.ndim(node.weight) == 2:
        return 1
    if isinstance(node, nir.Conv1d):
        return 2
    return 3 if isinstance(node, (nir.Conv2d, *POOLS)) else 0


def _stripped(node: nir.NIRNode, axes: int | None) -> nir.NIRNode:
    if axes is None:
        return node
    if isinstance(node, _PORTS):
        shape = np.asarray(node.output_type["output"])
        extra = _extra(shape.tolist(), axes) if shape.ndim == 1 else 0
        return type(node)(shape[extra:]) if extra else node
    if not isinstance(node, _ELEMENTWISE):
        return node
    arrays = {n: value for n, value in vars(node).items() if isinstance(value, np.ndarray)}
    fewer_axes = {n: value[(0,) * _extra(value.shape, axes)] for n, value in arrays.items()}
    if all(fewer_axes[n].ndim == value.ndim for n, value in arrays.items()):
        return node
    other = copy.copy(node)
    for n, value in fewer_axes.items():
        setattr(other, n, value)
    shape = np.array(next(iter(fewer_axes.values())).shape)
    other.input_type, other.output_type = {"input": shape}, {"output": shape}
    return other


def _extra(shape: Iterable[int], axes: int) -> int:
    """How many leading axes are 1 and beyond these axes."""
    lengths = list(shape)
    found = 0
    while len(lengths) - found > axes and lengths[found] == 1:
        found += 1
    return found
