"""The work of a graph: numbers and multiplications of one timestep, known before any is done."""

import math
from collections.abc import Mapping

import nir

from runtime.errors import ArtifactError
from runtime.windows import CONVOLUTIONS, LARGEST, POOLS, Shape, pool_window

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
