"""Soundness: what must be true of a NIR graph before anything is computed with it.

`nir` itself accepts NaN time constants, biases of the wrong length and names that cannot be read
back, so the checks are here, and each message names the node, what was found and what to do.
"""

import nir
import numpy as np
from numpy.typing import NDArray

from runtime.discrete import CURRENT_BASED, LEAKY, NEURONS
from runtime.edges import check_edges
from runtime.errors import ArtifactError
from runtime.shapes import infer_shapes

# kinds whose every field is an array of numbers, except for what nir derives
NUMERIC = (nir.Affine, nir.Linear, nir.Scale, nir.Threshold, *NEURONS)
DERIVED = ("input_type", "output_type", "metadata")
REMEDY = "Export the network again, or correct the node."


def check_graph(graph: nir.NIRGraph) -> None:
    """Refuse a graph that is not sound; fills in the shapes that NIR infers."""
    check_edges(graph)
    for name in sorted(graph.nodes):
        _check_name(name)
        _check_node(name, graph.nodes[name])
    _check_ends(graph)
    infer_shapes(graph)


def _check_name(name: str) -> None:
    if not name or "/" in name or name == ".":
        raise ArtifactError(
            f"node {name!r}: HDF5 cannot hold this name. Choose one that is not empty, not '.' "
            "and has no '/'."
        )


def _check_node(name: str, node: nir.NIRNode) -> None:
    if isinstance(node, nir.NIRGraph):
        raise ArtifactError(
            f"node {name!r}: graphs inside graphs are not supported. Flatten the graph first."
        )
    for field, value in sorted(vars(node).items()):
        if isinstance(value, np.ndarray) or (isinstance(node, NUMERIC) and field not in DERIVED):
            _check_values(name, field, value)
    if isinstance(node, nir.Affine):
        _same_shape(name, "bias", node.bias.shape, node.weight.shape[:-1])
    if isinstance(node, CURRENT_BASED):
        _same_shape(name, "w_in", node.w_in.shape, node.r.shape)
    taus = ("tau",) if isinstance(node, LEAKY) else ("tau_syn", "tau_mem")
    for field in taus if isinstance(node, (*LEAKY, *CURRENT_BASED)) else ():
        _check_time_constant(name, field, getattr(node, field))


def _check_values(name: str, field: str, value: object) -> None:
    found = np.asarray(value)
    if found.dtype.kind not in "fiu":
        raise ArtifactError(f"node {name!r}: {field} holds {found.dtype}, not numbers. {REMEDY}")
    if found.ndim == 0:
        raise ArtifactError(
            f"node {name!r}: {field} is a single number without a shape. Give one value per neuron."
        )
    if not np.isfinite(found).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(found))[0])
        raise ArtifactError(
            f"node {name!r}: {field} holds {found[index]} at index {index}; every value must be "
            f"finite. {REMEDY}"
        )


def _same_shape(name: str, field: str, found: tuple[int, ...], wanted: tuple[int, ...]) -> None:
    if found != wanted:
        raise ArtifactError(
            f"node {name!r}: {field} has shape {found}; the node's other parameters need "
            f"{wanted}. {REMEDY}"
        )


def _check_time_constant(name: str, field: str, tau: NDArray[np.generic]) -> None:
    if tau.size and tau.min() <= 0:
        raise ArtifactError(
            f"node {name!r}: {field} holds {tau.min():g} s; a time constant must be above 0. "
            f"{REMEDY}"
        )


def _check_ends(graph: nir.NIRGraph) -> None:
    for kind, found in (("Input", graph.inputs), ("Output", graph.outputs)):
        if not found:
            raise ArtifactError(f"the graph has no {kind} node. Add one and an edge to it.")
    for name, node in {**graph.inputs, **graph.outputs}.items():
        shape = np.asarray(node.output_type["output"])
        if shape.dtype.kind not in "iu" or shape.ndim != 1 or not (shape > 0).all():
            raise ArtifactError(
                f"node {name!r}: shape is {shape.tolist()}; it must be whole numbers above 0. "
                f"{REMEDY}"
            )
