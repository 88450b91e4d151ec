"""The edges of a graph: pairs of nodes that exist, each once, and a way through every node."""

from collections import Counter, defaultdict
from collections.abc import Iterable

import nir

from runtime.errors import ArtifactError

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
