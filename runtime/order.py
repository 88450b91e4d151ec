"""The order in which the nodes of a graph are computed, and which edges look back one timestep."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import nir

from runtime.discrete import NEURONS
from runtime.errors import ArtifactError

Edge: TypeAlias = tuple[str, str]


@dataclass(frozen=True)
class Order:
    """An order for the nodes that serves every edge.

    names: each node after the sources of its edges, except for late edges.
    late: edges that deliver in the next timestep.
    """

    names: tuple[str, ...]
    late: frozenset[Edge]


def order(graph: nir.NIRGraph, late: Iterable[Edge] = ()) -> Order:
    """Topological order; loops are opened where the spikes of a neuron come back to the loop.

    Which edge of a loop is the late one is not in NIR. As in Norse and SpikingJelly it is the one
    that leaves a neuron towards the neuron of the loop that is nearest to the input. Edges that
    are `late` already are no dependencies.
    """
    delayed = set(late)
    done: dict[str, None] = {}
    pending = set(graph.nodes)
    edges = tuple(graph.edges)
    while pending:
        held = {
            target
            for source, target in edges
            if source in pending and (source, target) not in delayed
        }
        ready = sorted(pending - held)
        if not ready:
            delayed |= _feedback(graph, pending, delayed)
        done.update(dict.fromkeys(ready))
        pending.difference_update(ready)
    return Order(tuple(done), frozenset(delayed))


def has_loop(graph: nir.NIRGraph) -> bool:
    """Whether any node hears itself, over however many others."""
    pending = set(graph.nodes)
    while pending:
        held = {target for source, target in graph.edges if source in pending} & pending
        if held == pending:
            return True
        pending = held
    return False


def sources(graph: nir.NIRGraph, name: str) -> list[str]:
    """Names of the nodes with an edge to this one, sorted, so that sums have one order."""
    return sorted(source for source, target in graph.edges if target == name)


def _sources(graph: nir.NIRGraph, name: str, delayed: Collection[Edge]) -> list[str]:
    return [source for source in sources(graph, name) if (source, name) not in delayed]


def _feedback(graph: nir.NIRGraph, pending: set[str], delayed: set[Edge]) -> set[Edge]:
    """Edges that bring spikes back to the neuron of a loop that is nearest to the input."""
    loops = {name: loop for name in pending if (loop := _loop(graph, name, delayed))}
    neurons = [name for name in loops if isinstance(graph.nodes[name], NEURONS)]
    depth = _depth(graph)
    for first in sorted(neurons, key=lambda name: (depth.get(name, len(graph.nodes)), name)):
        if found := set(_returning(graph, first, loops[first], delayed)):
            return found
    raise ArtifactError(
        f"the loop through {', '.join(sorted(loops))} has no neuron in it, so that a value would "
        "depend on itself within one timestep. Put a neuron into the loop or open it."
    )


def _loop(graph: nir.NIRGraph, name: str, delayed: set[Edge]) -> set[str]:
    """Nodes on any way from this node back to itself."""
    edges = [edge for edge in graph.edges if edge not in delayed]
    after = _reached(name, edges)
    before = _reached(name, [(target, source) for source, target in edges])
    return after & before


def _reached(start: str, edges: list[Edge]) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        here = waiting.pop()
        ahead = {target for source, target in edges if source == here} - found
        found |= ahead
        waiting.extend(ahead)
    return found


def _returning(
    graph: nir.NIRGraph, first: str, loop: set[str], delayed: set[Edge]
) -> Iterator[Edge]:
    """Edges of the loop that leave a neuron and come to `first` with no neuron in between."""
    seen = {first}
    waiting = [first]
    while waiting:
        target = waiting.pop()
        for source in loop.intersection(_sources(graph, target, delayed)):
            if isinstance(graph.nodes[source], NEURONS):
                yield source, target
            elif source not in seen:
                seen.add(source)
                waiting.append(source)


def _depth(graph: nir.NIRGraph) -> dict[str, int]:
    """Edges on the shortest way from an input to each node."""
    depth = dict.fromkeys(graph.inputs, 0)
    waiting = list(depth)
    for here in waiting:
        for source, target in graph.edges:
            if source == here and target not in depth:
                depth[target] = depth[here] + 1
                waiting.append(target)
    return depth
