"""Parameters in whole numbers, as some tools write them, as floats of the same values.

Unsigned numbers have no negative, and of the smallest signed one the magnitude does not fit: what
is computed of them would be wrong without a word.
"""

import copy

import nir
import numpy as np

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import NEURONS
from spikedeploy.runtime.graph.shapes import DENSE
from spikedeploy.runtime.graph.windows import CONVOLUTIONS

# kinds with parameters, which are arrays of numbers, one for each synapse or neuron
_KINDS = (*DENSE, *CONVOLUTIONS, nir.Scale, nir.Threshold, nir.Delay, *NEURONS)
# geometry of a convolution, which stays in whole numbers; types are derived
_OTHERS = {
    "stride", "padding", "dilation", "groups", "input_shape", "input_type", "output_type",
    "metadata",
}  # fmt: skip
_LARGEST = 1 << 53


def with_floats(graph: nir.NIRGraph) -> nir.NIRGraph:
    """The graph with whole parameters in float64; itself where there are none."""
    nodes = {name: _node(name, node) for name, node in graph.nodes.items()}
    if all(node is graph.nodes[name] for name, node in nodes.items()):
        return graph
    return nir.NIRGraph(nodes, list(graph.edges), metadata=graph.metadata, type_check=False)


def _node(name: str, node: nir.NIRNode) -> nir.NIRNode:
    whole = {
        field: value
        for field, value in vars(node).items()
        if field not in _OTHERS and isinstance(value, np.ndarray) and value.dtype.kind in "iu"
    }
    if not isinstance(node, _KINDS) or not whole:
        return node
    other = copy.copy(node)
    for field, value in whole.items():
        # max and min in Python, whose numbers do not wrap
        if max(int(value.max()), -int(value.min())) > _LARGEST:
            raise ArtifactError(
                f"node {name!r}: {field} holds whole numbers beyond {_LARGEST}, which no float "
                "holds. Scale them down."
            )
        setattr(other, field, value.astype(np.float64))
    return other
