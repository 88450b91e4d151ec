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
from spikedeploy.runtime.graph.windows import CONVOLUTIONS

Edge: TypeAlias = tuple[str, str]


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
    loops: whether the graph has a loop.
    """

    names: tuple[str, ...]
    late: frozenset[Edge]
    delays: Mapping[str, NDArray[np.int64]]
    loops: bool


def timing(graph: nir.NIRGraph, convention: Convention) -> Timing:
    """The timing of a graph under a convention.

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
        late |= _into_weights(graph)
    stepwise, loops = order(graph, late), _has_loop(graph)
    return Timing(
        # without loops a node runs for all timesteps at once, after its late sources too
        names=stepwise.names if loops else order(graph).names,
        late=stepwise.late,
        delays={name: steps - (name in delaying) for name, steps in delays.items()},
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
    done: dict[str, None] = {}
    pending = set(graph.nodes)
    edges = tuple(graph.edges)
    while pending:
        blocked = {
            target
            for source, target in edges
            if source in pending and (source, target) not in delayed
        }
        ready = sorted(pending - blocked)
        if not ready:
            delayed |= _feedback(graph, pending, delayed)
        done.update(dict.fromkeys(ready))
        pending.difference_update(ready)
    return _Order(tuple(done), frozenset(delayed))


def _has_loop(graph: nir.NIRGraph) -> bool:
    """Whether any node reaches itself over the edges."""
    pending = set(graph.nodes)
    while pending:
        blocked = {target for source, target in graph.edges if source in pending} & pending
        if blocked == pending:
            return True
        pending = blocked
    return False


def sources(graph: nir.NIRGraph, name: str) -> list[str]:
    """Names of the nodes with an edge to this one, sorted, which fixes the order of summation."""
    return sorted(source for source, target in graph.edges if target == name)


def _into_weights(graph: nir.NIRGraph) -> set[Edge]:
    kinds = (nir.Affine, nir.Linear, *CONVOLUTIONS)
    return {edge for edge in graph.edges if isinstance(graph.nodes[edge[1]], kinds)}


def _feedback(graph: nir.NIRGraph, pending: set[str], delayed: set[Edge]) -> set[Edge]:
    """Edges by which spikes return to the neuron of a loop that is nearest to the input."""
    loops = {name: loop for name in pending if (loop := _loop(graph, name, delayed))}
    neurons = [name for name in loops if isinstance(graph.nodes[name], NEURONS)]
    depth = _depth(graph)
    for first in sorted(neurons, key=lambda name: (depth.get(name, len(graph.nodes)), name)):
        if returning := set(_returning(graph, first, loops[first], delayed)):
            return returning
    raise ArtifactError(
        f"the loop through {', '.join(sorted(loops))} has no neuron in it, so that a value would "
        "depend on itself within one timestep. Put a neuron into the loop or open it."
    )


def _loop(graph: nir.NIRGraph, name: str, delayed: set[Edge]) -> set[str]:
    """Nodes on any path from this node back to itself."""
    edges = [edge for edge in graph.edges if edge not in delayed]
    descendants = _descendants(name, edges)
    ancestors = _descendants(name, [(target, source) for source, target in edges])
    return descendants & ancestors


def _descendants(start: str, edges: list[Edge]) -> set[str]:
    reached: set[str] = set()
    waiting = [start]
    while waiting:
        here = waiting.pop()
        new = {target for source, target in edges if source == here} - reached
        reached |= new
        waiting.extend(new)
    return reached


def _returning(
    graph: nir.NIRGraph, first: str, loop: set[str], delayed: set[Edge]
) -> Iterator[Edge]:
    """Edges of the loop that leave a neuron and reach `first` without another in between."""
    seen = {first}
    waiting = [first]
    while waiting:
        target = waiting.pop()
        for source in loop.intersection(_prompt_sources(graph, target, delayed)):
            if isinstance(graph.nodes[source], NEURONS):
                yield source, target
            elif source not in seen:
                seen.add(source)
                waiting.append(source)


def _prompt_sources(graph: nir.NIRGraph, name: str, delayed: Collection[Edge]) -> list[str]:
    """Sources whose output arrives in the same timestep."""
    return [source for source in sources(graph, name) if (source, name) not in delayed]


def _depth(graph: nir.NIRGraph) -> dict[str, int]:
    """Edges on the shortest path from an input to each node."""
    depth = dict.fromkeys(graph.inputs, 0)
    waiting = list(depth)
    for here in waiting:
        for source, target in graph.edges:
            if source == here and target not in depth:
                depth[target] = depth[here] + 1
                waiting.append(target)
    return depth
