"""Execution order and timing of a graph: when each node runs, and which edges deliver later.

NIR states neither which edge of a loop is the delayed one nor how a delay in seconds becomes
timesteps; both are decided here, once for the float model and the compiler.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, ConventionError, node_error
from spikedeploy.runtime.graph.discretisation import NEURONS, ROUNDING
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS

Edge: TypeAlias = tuple[str, str]
Neighbours: TypeAlias = Mapping[str, Collection[str]]

# edges that are looked at while loops are opened one by one; a check of all chips does so often
_MOST_LOOP_WORK = 1 << 17


class Order(NamedTuple):
    """An execution order of the nodes.

    names: of all nodes, each after its sources, except over late edges.
    late: edges that deliver in the next timestep.
    """

    names: tuple[str, ...]
    late: frozenset[Edge]


@dataclass(frozen=True, eq=False)
class Timing:
    """The order in which nodes run, and the delays of their outputs.

    names: of all nodes, each after its sources of the same timestep.
    late: edges that deliver in the next timestep.
    delays: of each Delay node, (*N) timesteps besides the one of its late edges.
    loops: True if the graph has a loop.
    """

    names: tuple[str, ...]
    late: frozenset[Edge]
    delays: Mapping[str, NDArray[np.int64]]
    loops: bool


def timing(graph: nir.NIRGraph, convention: Convention) -> Timing:
    """The timing of a graph under a convention.

    Where the clock is pipelined, what leaves an Input or neurons for neurons is a timestep late.
    A Delay node that holds every value back for at least one timestep opens a loop by itself; its
    edges are late then, and that timestep is part of its delay: I[t] = w z[t - delay].
    """
    nodes, pipelined = graph.nodes, convention.clock == "pipelined"
    delays = {
        name: delay_timesteps(name, node, convention)
        for name, node in nodes.items()
        if isinstance(node, nir.Delay)
    }
    delaying = {name for name, timesteps in delays.items() if timesteps.min() >= 1}
    if pipelined:  # of a Delay the timesteps come on top
        neurons = [name for name, node in nodes.items() if isinstance(node, NEURONS)]
        late = _edges_onto(neurons, sources(graph), nodes, (nir.Input, *NEURONS))
    else:
        weights = (nir.Affine, nir.Linear, *CONVOLUTIONS) if convention.delay else ()
        late = {
            edge
            for edge in graph.edges
            if edge[1] in delaying or isinstance(nodes[edge[1]], weights)
        }
    names = tuple(in_waves(nodes, graph.edges))
    if loops := len(names) < len(nodes):
        names, closing = order(graph, late)
        late = set(closing)
    steps = {n: each - (n in delaying and not pipelined) for n, each in delays.items()}
    # without loops a node runs for all timesteps at once, after its late sources too
    return Timing(names, frozenset(late), steps, loops)


def delay_timesteps(name: str, node: nir.Delay, convention: Convention) -> NDArray[np.int64]:
    """The delay (*N) of each element [timesteps]; ConventionError where dt does not divide it."""
    with np.errstate(over="ignore", under="ignore"):
        # longer than any raster: the number only has to fit into an int64
        steps = np.minimum(node.delay.astype(np.float64) / convention.dt, 2.0**62)
    whole = np.rint(steps)
    tolerance = ROUNDING.get(node.delay.dtype.type, ROUNDING[np.float64])
    fractional = np.abs(steps - whole) > tolerance * np.maximum(whole, 1)
    if fractional.any():
        delay, ratio = node.delay[fractional][0], steps[fractional][0]
        found = f"a delay of {delay:g} s is {ratio:g} timesteps of {convention.dt:g} s, not whole"
        raise node_error(name, found, "Choose a dt that divides it.", ConventionError)
    return np.asarray(whole, np.int64)


def order(graph: nir.NIRGraph, late: Iterable[Edge] = ()) -> Order:
    """Topological order; each loop is opened at an edge by which a neuron's output returns to it.

    Which edge of a loop is late is not in NIR. As in Norse and SpikingJelly it is the one that
    leaves a neuron towards the neuron of the loop that is nearest to the input. A loop without a
    neuron raises ArtifactError.

    late: edges that deliver in the next timestep anyway, and so impose no order.
    """
    delayed, done, pending, work = set(late), list[str](), set(graph.nodes), 0
    depth = _depth(graph)
    while True:
        prompt = [edge for edge in graph.edges if edge not in delayed and edge[0] in pending]
        ready = in_waves(pending, prompt)
        done += ready
        pending.difference_update(ready)
        if not pending:
            return Order(tuple(done), frozenset(delayed))
        prompt = [edge for edge in prompt if edge[0] in pending]
        after, before = neighbours(prompt), neighbours((t, s) for s, t in prompt)
        # what is left lies on loops, or between two
        inside = pending.difference(in_waves(pending, ((t, s) for s, t in prompt)))
        neurons = [name for name in inside if isinstance(graph.nodes[name], NEURONS)]
        for first in sorted(neurons, key=lambda name: (depth.get(name, len(graph.nodes)), name)):
            if (work := work + len(prompt)) > _MOST_LOOP_WORK:
                raise ArtifactError(
                    f"the loops through {len(pending)} nodes are too many to open one by one. Join "
                    "nodes that are connected both ways into one recurrent layer."
                )
            loop = reach(after.get(first, ()), after) & reach(before.get(first, ()), before)
            if first in loop:
                break
        else:
            shown = ", ".join(sorted(inside)[:20])
            raise ArtifactError(
                f"the loop through {shown} has no neuron in it, so that a value would depend on "
                "itself within one timestep. Put a neuron into the loop or open it."
            )
        near = {name: loop.intersection(before[name]) for name in loop}
        delayed |= _edges_onto([first], near, graph.nodes, NEURONS)


def in_waves(names: Collection[str], edges: Iterable[Edge]) -> list[str]:
    """The names, each after its sources: all that are ready, sorted, then all ready after those.

    What lies in a loop of the edges, or behind one, is missing.
    """
    left, targets = dict.fromkeys(names, 0), neighbours(edges)
    for source, ahead in targets.items():
        for target in ahead if source in left else ():
            if target in left:
                left[target] += 1
    ready, done = sorted(name for name, sources_ in left.items() if not sources_), list[str]()
    while ready:
        done += ready
        freed = []
        for target in (t for name in ready for t in targets.get(name, ()) if t in left):
            left[target] -= 1
            if not left[target]:
                freed.append(target)
        ready = sorted(freed)
    return done


def neighbours(edges: Iterable[Edge]) -> dict[str, list[str]]:
    """The targets of each source."""
    found: dict[str, list[str]] = {}
    for source, target in edges:
        found.setdefault(source, []).append(target)
    return found


def reach(starts: Iterable[str], near: Neighbours) -> set[str]:
    """The starts, and all that steps to neighbours lead to from them."""
    found = set(starts)
    waiting = list(found)
    while waiting:
        new = set(near.get(waiting.pop(), ())) - found
        found |= new
        waiting += new
    return found


def sources(graph: nir.NIRGraph) -> dict[str, list[str]]:
    """Names of the nodes with an edge to each, sorted, which fixes the order of summation."""
    found: dict[str, list[str]] = {name: [] for name in graph.nodes}
    for source, target in sorted(graph.edges):
        found[target].append(source)
    return found


def _edges_onto(
    targets: Collection[str],
    before: Neighbours,
    nodes: Mapping[str, nir.NIRNode],
    kinds: tuple[type[nir.NIRNode], ...],
) -> set[Edge]:
    """Edges that leave nodes of these kinds, and lead to the targets over none of them."""
    found, seen, waiting = set[Edge](), set(targets), list(targets)
    while waiting:
        for source in before[target := waiting.pop()]:
            if isinstance(nodes[source], kinds):
                found.add((source, target))
            elif source not in seen:
                seen.add(source)
                waiting.append(source)
    return found


def _depth(graph: nir.NIRGraph) -> dict[str, int]:
    """Edges on the shortest path from an input to each node."""
    depth, targets = dict.fromkeys(graph.inputs, 0), neighbours(graph.edges)
    waiting = list(depth)
    for here in waiting:
        for target in targets.get(here, ()):
            if target not in depth:
                depth[target] = depth[here] + 1
                waiting.append(target)
    return depth
