"""The shapes of a graph, walked along its edges: what each node takes and what it puts out.

`nir` infers shapes too, but takes the height of a kernel for its width, the channels of one group
for all of them, and 'same' for unchanged whatever the stride. So what it says is not used.

The work of a graph: numbers and multiplications of one timestep, known before any is done.
"""

import math
from collections.abc import Mapping

import nir
import numpy as np

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.windows import (
    CONVOLUTIONS,
    LARGEST,
    POOLS,
    Shape,
    convolution_window,
    placed,
    pool_window,
    whole_numbers,
)

# multiplications of a node in one timestep beyond which it is a mistake; large networks for images
# have as many in all layers together
MOST = 1 << 33
# numbers that the windows of a convolution may be at once
WINDOWS = 1 << 26


def check_work(graph: nir.NIRGraph, shapes: Mapping[str, tuple[Shape, Shape]]) -> None:
    """Refuse a graph of which one timestep would fill the memory or take minutes."""
    numbers = 0
    for name, (takes, puts) in sorted(shapes.items()):
        node = graph.nodes[name]
        numbers += math.prod(puts)
        if numbers > LARGEST:
            raise ArtifactError(
                f"node {name!r}: it and the nodes before it put out {numbers} numbers in a "
                f"timestep; at most {LARGEST} for all. Correct its shape, or divide the network."
            )
        if (found := multiplications(name, node, puts)) > MOST:
            raise ArtifactError(
                f"node {name!r}: {found} multiplications in a timestep; at most {MOST}. Correct "
                "its kernel or its shape."
            )
        if isinstance(node, CONVOLUTIONS) and (found := _windows(node, takes, puts)) > WINDOWS:
            raise ArtifactError(
                f"node {name!r}: its windows hold {found} numbers; at most {WINDOWS}. Correct its "
                "kernel or its shape."
            )


def multiplications(name: str, node: nir.NIRNode, puts: Shape) -> int:
    """Multiplications, or additions of a pool, in one timestep."""
    if isinstance(node, (nir.Affine, nir.Linear)):
        return int(node.weight.size)
    if isinstance(node, CONVOLUTIONS):
        return int(node.weight.size) * math.prod(puts[1:])
    if isinstance(node, POOLS):
        return math.prod(puts) * math.prod(pool_window(name, node).kernel)
    return math.prod(puts)


def _windows(node: nir.NIRNode, takes: Shape, puts: Shape) -> int:
    """Numbers of all windows of a convolution."""
    return int(takes[0] * math.prod(puts[1:]) * math.prod(node.weight.shape[2:]))


DENSE = (nir.Affine, nir.Linear)


def infer_shapes(graph: nir.NIRGraph) -> None:
    """Write its shapes into every node; those that disagree along an edge are refused by name."""
    before: dict[str, list[str]] = {name: [] for name in graph.nodes}
    for source, target in graph.edges:
        before[target].append(source)
    shapes = _shapes(graph, before)
    check_work(graph, shapes)
    for source, target in sorted(graph.edges):
        puts, takes = shapes[source][1], shapes[target][0]
        if puts != takes:
            raise ArtifactError(
                f"edge {source!r} -> {target!r}: the shapes of the graph disagree: {source!r} puts "
                f"out {puts}, {target!r} takes {takes}. Correct one of the two nodes."
            )
    for name, (takes, puts) in shapes.items():
        node = graph.nodes[name]
        node.input_type = {"input": np.array(takes)}
        node.output_type = {"output": np.array(puts)}
        if isinstance(node, CONVOLUTIONS) and node.input_shape is None:
            node.input_shape = takes[1:] if isinstance(node, nir.Conv2d) else takes[1]


def _shapes(graph: nir.NIRGraph, before: Mapping[str, list[str]]) -> dict[str, tuple[Shape, Shape]]:
    """What each node takes and puts out."""
    shapes: dict[str, tuple[Shape, Shape]] = {}
    waiting = sorted(graph.nodes)
    while waiting:
        later = []
        for name in waiting:
            known = [shapes[source][1] for source in before[name] if source in shapes]
            takes = _stated(name, graph.nodes[name]) or (known[0] if known else None)
            if takes is None:
                later.append(name)
            else:
                shapes[name] = takes, _output(name, graph.nodes[name], takes)
        if len(later) == len(waiting):
            raise ArtifactError(
                f"node {later[0]!r}: its shape is not known, because no edge from a node with a "
                "known shape leads to it. Connect it to the input, or remove it."
            )
        waiting = later
    return shapes


def _stated(name: str, node: nir.NIRNode) -> Shape | None:
    """The shape that a node takes by itself, or None where it takes what comes."""
    if isinstance(node, POOLS):
        return None
    if isinstance(node, CONVOLUTIONS):
        return _channels_first(name, node)
    if isinstance(node, DENSE):
        return tuple(map(int, (*node.weight.shape[:-2], node.weight.shape[-1])))
    if isinstance(node, (nir.Input, nir.Output, nir.Flatten)):
        stated = node.input_type["input"]
        if stated is None:
            return None
        return whole_numbers(name, "shape", np.asarray(stated), np.size(stated), least=1)
    return _elementwise(node)


def _elementwise(node: nir.NIRNode) -> Shape:
    """The shape of a node that has one parameter for every number that it takes."""
    fields = {nir.Scale: "scale", nir.Threshold: "threshold", nir.Delay: "delay"}
    (field,) = [name for kind, name in fields.items() if isinstance(node, kind)] or ["r"]
    return tuple(map(int, getattr(node, field).shape))


def _channels_first(name: str, node: nir.NIRNode) -> Shape | None:
    """The input (C, *X) of a convolution, where the node says X."""
    axes = 1 if isinstance(node, nir.Conv1d) else 2
    if node.input_shape is None:
        return None
    extents = whole_numbers(name, "input_shape", node.input_shape, axes, least=1)
    return _channels(node), *extents


def _channels(node: nir.NIRNode) -> int:
    """C of a convolution; the weight holds those of one group."""
    return int(node.weight.shape[1]) * int(node.groups)


def _output(name: str, node: nir.NIRNode, takes: Shape) -> Shape:
    """What a node puts out when it takes this."""
    if math.prod(takes) > LARGEST:
        raise ArtifactError(
            f"node {name!r}: {takes} is more than {LARGEST} numbers. Correct its shape."
        )
    if isinstance(node, DENSE):
        return *takes[:-1], int(node.weight.shape[-2])
    if isinstance(node, CONVOLUTIONS):
        return _convolved(name, node, takes)
    if isinstance(node, POOLS):
        _check_axes(name, takes, ("C", "H", "W"))
        return takes[0], *placed(name, pool_window(name, node), takes[1:])
    if isinstance(node, nir.Flatten):
        return _flattened(name, node, takes)
    return takes


def _convolved(name: str, node: nir.NIRNode, takes: Shape) -> Shape:
    _check_axes(name, takes, ("C", "L") if isinstance(node, nir.Conv1d) else ("C", "H", "W"))
    if takes[0] != _channels(node):
        raise ArtifactError(
            f"node {name!r}: {takes[0]} channels arrive, but the weight {node.weight.shape} with "
            f"{int(node.groups)} groups is for {_channels(node)}. Correct weight or groups."
        )
    places = placed(name, convolution_window(name, node), takes[1:])
    return int(node.weight.shape[0]), *places


def _check_axes(name: str, takes: Shape, axes: tuple[str, ...]) -> None:
    if len(takes) != len(axes):
        raise ArtifactError(
            f"node {name!r}: {takes} arrives, but it takes ({', '.join(axes)}). Give the node "
            "before it that shape."
        )


def _flattened(name: str, node: nir.Flatten, takes: Shape) -> Shape:
    """The axes from start_dim to end_dim as one; the batch is not counted."""
    (start,) = whole_numbers(name, "start_dim", node.start_dim, 1, least=-len(takes))
    (end,) = whole_numbers(name, "end_dim", node.end_dim, 1, least=-len(takes))
    if max(start, end) >= len(takes) or start % len(takes) > end % len(takes):
        raise ArtifactError(
            f"node {name!r}: axes {start} to {end} cannot be flattened in {takes}; the batch does "
            "not count. Correct start_dim and end_dim."
        )
    first, last = start % len(takes), end % len(takes)
    return *takes[:first], math.prod(takes[first : last + 1]), *takes[last + 1 :]
