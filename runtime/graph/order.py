"""Execution order and timing of a graph: when each node runs, and which edges deliver later.

NIR states neither which edge of a loop is the delayed one nor how a delay in seconds becomes
timesteps; both are decided here, once for the float model and the compiler.
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
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS

Edge: TypeAlias = tuple[str, str]

# edges that are looked at while loops are opened one by one; a check of all chips does so often
_MOST_LOOP_WORK = 1 << 17


@dataclass(frozen=True)
class _Order:
    """An execution order of the nodes.

    names: of all nodes, each after its sources, except over late edges.
    late: edges that deliver in the next timestep.
    """

    names: tuple[str, ...]
    late: frozenset[Edge]


@dataclass(frozen=True, eq=False)
class Timing:
    """When each node runs, and when its output arrives.

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
    delays = {
        name: delay_timesteps(name, node, convention)
        for name, node in graph.nodes.items()
        if isinstance(node, nir.Delay)
    }
    delaying = {name for name, timesteps in delays.items() if timesteps.min() >= 1}
    late = {edge for edge in graph.edges if edge[1] in delaying}
    if convention.delay:
        weights = (nir.Affine, nir.Linear, *CONVOLUTIONS)
        late |= {edge for edge in graph.edges if isinstance(graph.nodes[edge[1]], weights)}
    if pipelined := convention.clock == "pipelined":
        late = _out_of_spikes(graph)  # of a Delay the timesteps come on top
    stepwise, loops = order(graph, late), len(in_waves(graph.nodes, graph.edges)) < len(graph.nodes)
    return Timing(
        # without loops a node runs for all timesteps at once, after its late sources too
        names=stepwise.names if loops else order(graph).names,
        late=stepwise.late,
        delays={
            name: steps - (name in delaying and not pipelined) for name, steps in delays.items()
        },
        loops=loops,
    )


def delay_timesteps(name: str, node: nir.Delay, convention: Convention) -> NDArray[np.int64]:
    """The delay (*N) of each element [timesteps]; ConventionError where dt does not divide it."""
    with np.errstate(over="ignore", under="ignore"):
        # longer than any raster: the number only has to fit into an int64
        steps = np.minimum(node.delay.astype(np.float64) / convention.dt, 2.0**62)
    whole = np.rint(steps)
    tolerance = ROUNDING.get(node.delay.dtype.type, ROUNDING[np.float64])
    fractional = np.abs(steps - whole) > tolerance * np.maximum(whole, 1)
    if fractional.any():
        raise ConventionError(
            f"node {name!r}: a delay of {node.delay[fractional][0]:g} s is "
            f"{steps[fractional][0]:g} timesteps of {convention.dt:g} s, which is not whole. "
            "Choose a dt that divides it, or round it."
        )
    return np.asarray(whole, np.int64)


def order(graph: nir.NIRGraph, late: Iterable[Edge] = ()) -> _Order:
    """Topological order; each loop is opened at an edge by which a neuron's output returns to it.

    Which edge of a loop is late is not in NIR. As in Norse and SpikingJelly it is the one that
    leaves a neuron towards the neuron of the loop that is nearest to the input. A loop without a
    neuron raises ArtifactError.

    late: edges that deliver in the next timestep anyway, and so impose no order.
    """
    delayed = set(late)
    done: list[str] = []
    pending, work = set(graph.nodes), 0
    while pending:
        prompt = [edge for edge in graph.edges if edge not in delayed and edge[0] in pending]
        ready = in_waves(pending, prompt)
        done += ready
        pending.difference_update(ready)
        if pending:
            if (work := work + len(prompt)) > _MOST_LOOP_WORK:
                raise ArtifactError(
                    f"the loops through {len(pending)} nodes are too many to open one by one. Join "
                    "nodes that are connected both ways into one recurrent layer."
                )
            delayed |= _feedback(graph, pending, delayed)
    return _Order(tuple(done), frozenset(delayed))


def in_waves(names: Collection[str], edges: Iterable[Edge]) -> list[str]:
    """The names, each after its sources: all that are ready, sorted, then all ready after those.

    What lies in a loop of the edges, or behind one, is missing.
    """
    left, targets = dict.fromkeys(names, 0), _targets(edges)
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


def _targets(edges: Iterable[Edge]) -> dict[str, list[str]]:
    """The targets of each source."""
    found: dict[str, list[str]] = {}
    for source, target in edges:
        found.setdefault(source, []).append(target)
    return found


def sources(graph: nir.NIRGraph) -> dict[str, list[str]]:
    """Names of the nodes with an edge to each, sorted, which fixes the order of summation."""
    found: dict[str, list[str]] = {name: [] for name in graph.nodes}
    for source, target in sorted(graph.edges):
        found[target].append(source)
    return found


def _out_of_spikes(graph: nir.NIRGraph) -> set[Edge]:
    """Edges that leave an Input or neurons towards neurons, whose spikes arrive a timestep late."""
    waiting = [name for name, node in graph.nodes.items() if isinstance(node, NEURONS)]
    found, before, seen = set[Edge](), sources(graph), set[str]()
    while waiting:
        for source in before[target := waiting.pop()]:
            if isinstance(graph.nodes[source], (nir.Input, *NEURONS)):
                found.add((source, target))
            elif source not in seen:
                seen.add(source)
                waiting.append(source)
    return found


def _feedback(graph: nir.NIRGraph, pending: set[str], delayed: set[Edge]) -> set[Edge]:
    """Edges by which spikes return to the neuron of a loop that is nearest to the input."""
    prompt = [edge for edge in graph.edges if edge not in delayed]
    before = _targets((target, source) for source, target in prompt)
    loops = _loops(pending, _targets(prompt), before)
    neurons = [name for name in loops if isinstance(graph.nodes[name], NEURONS)]
    depth = _depth(graph)
    for first in sorted(neurons, key=lambda name: (depth.get(name, len(graph.nodes)), name)):
        if returning := set(_returning(graph, first, loops[first], before)):
            return returning
    more = f" and {len(loops) - 20} more" if len(loops) > 20 else ""
    raise ArtifactError(
        f"the loop through {', '.join(sorted(loops)[:20])}{more} has no neuron in it, so that a "
        "value would depend on itself within one timestep. Put a neuron into the loop or open it."
    )


def _loops(
    pending: set[str], after: Mapping[str, list[str]], before: Mapping[str, list[str]]
) -> dict[str, set[str]]:
    """For each node on a path back to itself, all nodes on such paths (Kosaraju's algorithm)."""
    loops: dict[str, set[str]] = {}
    left = set(pending)
    for name in reversed(_by_finish(pending, after)):
        if name not in left:
            continue
        loop, waiting = {name}, [name]
        left.remove(name)
        while waiting:
            new = left.intersection(before.get(waiting.pop(), ()))
            left -= new
            loop |= new
            waiting.extend(new)
        if len(loop) > 1 or name in after.get(name, ()):
            loops.update(dict.fromkeys(loop, loop))
    return loops


def _by_finish(names: set[str], after: Mapping[str, list[str]]) -> list[str]:
    """The names, each when all that it leads to are there, but for loops."""
    done, seen = list[str](), set[str]()
    for first in sorted(names):
        path = [] if first in seen else [(first, iter(after.get(first, ())))]
        seen.add(first)
        while path:
            new = next((t for t in path[-1][1] if t in names and t not in seen), None)
            if new is None:
                done.append(path.pop()[0])
            else:
                seen.add(new)
                path.append((new, iter(after.get(new, ()))))
    return done


def _returning(
    graph: nir.NIRGraph, first: str, loop: set[str], before: Mapping[str, list[str]]
) -> Iterator[Edge]:
    """Edges of the loop that leave a neuron and reach `first` without another in between."""
    seen = {first}
    waiting = [first]
    while waiting:
        target = waiting.pop()
        for source in loop.intersection(before.get(target, ())):
            if isinstance(graph.nodes[source], NEURONS):
                yield source, target
            elif source not in seen:
                seen.add(source)
                waiting.append(source)


def _depth(graph: nir.NIRGraph) -> dict[str, int]:
    """Edges on the shortest path from an input to each node."""
    depth, targets = dict.fromkeys(graph.inputs, 0), _targets(graph.edges)
    waiting = list(depth)
    for here in waiting:
        for target in targets.get(here, ()):
            if target not in depth:
                depth[target] = depth[here] + 1
                waiting.append(target)
    return depth
