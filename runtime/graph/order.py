"""The order in which the nodes of a graph are computed, and which edges look back one timestep.

The delay of a node in timesteps.

The timing of a graph: in which order its nodes run, and where values are held back.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, ConventionError
from spikedeploy.runtime.graph.neurons import NEURONS, ROUNDING
from spikedeploy.runtime.graph.windows import CONVOLUTIONS

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


def delay_timesteps(name: str, node: nir.Delay, convention: Convention) -> NDArray[np.int64]:
    """The delay of each element in timesteps, which must be whole."""
    with np.errstate(over="ignore", under="ignore"):
        # later than any raster is long: the number only has to fit
        found = np.minimum(node.delay.astype(np.float64) / convention.dt, 2.0**62)
    whole = np.rint(found)
    tolerance = ROUNDING.get(node.delay.dtype.type, ROUNDING[np.float64])
    odd = np.abs(found - whole) > tolerance * np.maximum(whole, 1)
    if odd.any():
        raise ConventionError(
            f"node {name!r}: a delay of {node.delay[odd][0]:g} s is {found[odd][0]:g} timesteps of "
            f"{convention.dt:g} s, which is not whole. Choose a dt that divides it, or round it."
        )
    return np.asarray(whole, np.int64)


@dataclass(frozen=True, eq=False)
class Timing:
    """When what a node puts out is heard.

    names: of all nodes, each after those that it hears in the same timestep.
    late: edges that deliver in the next timestep.
    delays: Delay node -> (*N) timesteps that it holds values back besides its late edges.
    loops: whether any node hears itself.
    """

    names: tuple[str, ...]
    late: frozenset[Edge]
    delays: Mapping[str, NDArray[np.int64]]
    loops: bool


def timing(graph: nir.NIRGraph, convention: Convention) -> Timing:
    """The timing of a graph under a convention.

    A Delay node that holds every value back for at least one timestep opens a loop by itself, and
    then its delay counts once: I[t] = w z[t - delay]. Its late edges are its first timestep.
    """
    delays = {
        name: delay_timesteps(name, node, convention)
        for name, node in graph.nodes.items()
        if isinstance(node, nir.Delay)
    }
    waiting = {name for name, timesteps in delays.items() if timesteps.min() >= 1}
    into = {edge for edge in graph.edges if edge[1] in waiting}
    if convention.delay:
        into |= _into_weights(graph)
    in_steps, loops = order(graph, into), has_loop(graph)
    return Timing(
        # a late edge may come from a later node of the same timestep, but not of all timesteps
        names=in_steps.names if loops else order(graph).names,
        late=in_steps.late,
        delays={name: steps - (name in waiting) for name, steps in delays.items()},
        loops=loops,
    )


def _into_weights(graph: nir.NIRGraph) -> set[Edge]:
    kinds = (nir.Affine, nir.Linear, *CONVOLUTIONS)
    return {edge for edge in graph.edges if isinstance(graph.nodes[edge[1]], kinds)}
