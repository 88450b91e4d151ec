"""Names and edges in an order in which importers run the nodes as NIR means.

Norse 1.1.0 (nirtorch.load) visits nodes depth first, along edges in the order of the file; the node
that it visits last is its output. A node with several sources runs when the first of them did.
snnTorch 1.0.0 wraps each loop of a neuron and its weights, and nirtorch 2.6 cannot run what comes
of it; it runs a loop of three nodes.
"""

from collections.abc import Container

import nir
import numpy as np

from spikedeploy.exporters.importers.neurons import Importer, refusal
from spikedeploy.runtime.graph.neurons import SPIKING
from spikedeploy.runtime.graph.order import order

Nodes = dict[str, nir.NIRNode]
Edges = list[tuple[str, str]]


def in_order(nodes: Nodes, edges: Edges, tool: Importer) -> tuple[Nodes, Edges]:
    """Nodes and edges (sorted) of the same graph, which the tool runs in the right order."""
    if tool.name == "snntorch":
        return _without_loops_of_two(nodes, edges)
    if tool.name == "norse" and not _right(visits(nodes, sorted(edges)), nodes, edges):
        return _numbered(nodes, edges, tool)
    return nodes, sorted(edges)


def visits(nodes: Nodes, edges: Edges, output: str = "") -> list[str]:
    """Nodes as Norse runs them; with `output`, its branch is the last at each node."""
    found: dict[str, None] = {}
    waiting = [name for name, node in nodes.items() if isinstance(node, nir.Input)][:1]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name] = None
            targets = [target for source, target in edges if source == name]
            if output:
                targets.sort(key=lambda target: output in _reached(target, edges, found))
            waiting += reversed(targets)
    return list(found)


def _reached(name: str, edges: Edges, without: Container[str]) -> set[str]:
    """Nodes that paths from this one lead to, past those that are left out."""
    found: set[str] = set()
    new = {name}
    while new := {each for each in new if each not in without} - found:
        found |= new
        new = {target for source, target in edges if source in new}
    return found


def _right(visited: list[str], nodes: Nodes, edges: Edges) -> bool:
    """Whether the Output comes last, and as many edges lead back as loops need."""
    at = {name: place for place, name in enumerate(visited)}
    if at.keys() != nodes.keys() or not isinstance(nodes[visited[-1]], nir.Output):
        return False
    back = sum(at[source] >= at[target] for source, target in edges)
    return back == len(order(nir.NIRGraph(nodes, edges, type_check=False)).late)


def _numbered(nodes: Nodes, edges: Edges, tool: Importer) -> tuple[Nodes, Edges]:
    """The graph with names that sort as it must be visited: what returns in a loop comes first."""
    output = next(name for name, node in nodes.items() if isinstance(node, nir.Output))
    wanted = visits(nodes, sorted(edges), output)
    if not _right(wanted, nodes, edges):
        reason = "it runs a node when the first of its sources did, and a node here waits for more"
        raise refusal(tool, reason)
    names = {name: f"n{place:03}_{name}" for place, name in enumerate(wanted)}
    again = {names[name]: nodes[name] for name in wanted}
    return again, sorted((names[source], names[target]) for source, target in edges)


def _without_loops_of_two(nodes: Nodes, edges: Edges) -> tuple[Nodes, Edges]:
    """The graph with a node more, which changes nothing, in each loop of a neuron and weights."""
    nodes, kept = dict(nodes), set(edges)
    for source, target in sorted(edges):
        if isinstance(nodes[source], SPIKING) and (target, source) in edges:
            between = f"{target}_in"
            while between in nodes:
                between += "_"
            nodes[between] = nir.Linear(np.eye(nodes[source].v_threshold.size))
            kept = kept - {(source, target)} | {(source, between), (between, target)}
    return nodes, sorted(kept)
