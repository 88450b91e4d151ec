"""The edges of a graph: pairs of nodes that exist, each once."""

from collections import Counter

import nir

from runtime.errors import ArtifactError

REMEDY = "Export the network again, or correct the edge."


def check_edges(graph: nir.NIRGraph, path: str = "") -> None:
    """Refuse edges that make no graph; `path` is where an inner graph is, with a dot behind."""
    where = f"in node {path[:-1]!r}: " if path else ""
    for edge in graph.edges:
        _check_edge(graph, edge, where)
    doubles = sorted(edge for edge, times in Counter(graph.edges).items() if times > 1)
    if doubles:
        source, target = doubles[0]
        raise ArtifactError(
            f"{where}edge {source!r} -> {target!r} is there twice, which tools read as one or as a "
            "sum. Remove one."
        )


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
