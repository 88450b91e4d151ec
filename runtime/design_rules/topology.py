"""The topology of a graph: its populations of neurons, and the synapses between them.

Unlike `wiring`, which a chip is compiled from, it takes any sound graph, so that every node of a
network that fits nowhere can still be told why.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.design_rules.fan import SynapseCounts, merged, one_to_one, through
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import NEURONS, SPIKING
from spikedeploy.runtime.graph.order import Edge, order, sources

Counts = NDArray[np.int64]

_POPULATIONS = (*NEURONS, nir.Threshold)
# ways to nodes without spikes, and the nodes on them: following more takes seconds
_MOST_WAYS = 1 << 16


@dataclass(frozen=True, eq=False)
class Projection:
    """All synapses of a population that come from one source by one way."""

    source: str
    target: str
    fan: SynapseCounts


@dataclass(frozen=True, eq=False)
class Population:
    """Neurons of one node.

    name: of the node.
    size: neurons, N.
    shape: of the node.
    presynaptic: the projections onto it.
    biased: whether a map adds something to it in every timestep.
    leaves: whether its spikes or membranes leave the chip.
    decays: different sets of time constants among its neurons.
    thresholds: different thresholds among them.
    """

    name: str
    size: int
    shape: tuple[int, ...]
    presynaptic: tuple[Projection, ...]
    biased: bool
    leaves: bool
    decays: int
    thresholds: int

    @property
    def fan_in(self) -> int:
        """Synapses of the neuron that has most; no more than that, where ways are many."""
        return sum(int(projection.fan.into.max()) for projection in self.presynaptic)

    @property
    def synapses(self) -> int:
        """All that reach it."""
        return sum(projection.fan.synapses for projection in self.presynaptic)

    @property
    def recurrent(self) -> bool:
        """Whether a loop closes here."""
        return any(projection.fan.late for projection in self.presynaptic)


@dataclass(frozen=True, eq=False)
class Topology:
    """The populations of a graph.

    inputs: M of each input.
    populations: in an order in which those that close no loop come after their sources.
    host: names of the maps behind the last neurons, which the host computes, and of the neurons
        that it integrates.
    """

    inputs: dict[str, int]
    populations: tuple[Population, ...]
    host: tuple[str, ...]

    def leaving(self, name: str) -> list[Projection]:
        """The projections that start in an input or population."""
        return self._leaving.get(name, [])

    @cached_property
    def _leaving(self) -> dict[str, list[Projection]]:
        found: dict[str, list[Projection]] = {}
        for projection in (c for p in self.populations for c in p.presynaptic):
            found.setdefault(projection.source, []).append(projection)
        return found

    def fan_out(self, name: str, targets: Collection[str] | None = None) -> Counts:
        """(M,) synapses that each spike of an input or population reaches, in these targets."""
        out = [c.fan.out for c in self.leaving(name) if targets is None or c.target in targets]
        return np.sum(out, axis=0) if out else np.zeros(1, np.int64)


def topology(graph: nir.NIRGraph, membranes: bool = True, graded: Collection[str] = ()) -> Topology:
    """The topology of a sound, flat graph.

    membranes: whether they can leave the chip; else the host integrates neurons without a
        threshold that only outputs are reached from.
    graded: names of nodes without a threshold that spike all the same.
    """
    names, late = _order(graph)
    before = sources(graph)
    ways = _ways(graph, names, late, before)
    ahead = _ahead(graph)
    kinds = (*SPIKING, nir.Threshold) if not membranes else _POPULATIONS
    on_chip = {n for n, node in graph.nodes.items() if isinstance(node, kinds) or n in graded}
    outputs = set(graph.outputs)
    host = _host(graph, before, ahead, on_chip)
    return Topology(
        inputs={name: _size(node) for name, node in sorted(graph.inputs.items())},
        populations=tuple(
            _population(
                graph.nodes[name],
                name,
                tuple(Projection(s, name, fan) for s, fan in _arriving(name, before, ways, late)),
                ahead[name] & (host | outputs),
            )
            for name in names
            if isinstance(graph.nodes[name], _POPULATIONS) and name not in host
        ),
        host=tuple(sorted(host)),
    )


def _order(graph: nir.NIRGraph) -> tuple[tuple[str, ...], frozenset[Edge]]:
    """Nodes in the order of the signals, and the edges that close loops."""
    try:
        ordered = order(graph)
    except ArtifactError:  # a loop without a neuron, which a Delay may open
        into = [edge for edge in graph.edges if isinstance(graph.nodes[edge[1]], nir.Delay)]
        ordered = order(graph, into)
    return ordered.names, ordered.late


def _ahead(graph: nir.NIRGraph) -> dict[str, set[str]]:
    """The targets of each node."""
    found: dict[str, set[str]] = {name: set() for name in graph.nodes}
    for source, target in graph.edges:
        found[source].add(target)
    return found


def _ways(
    graph: nir.NIRGraph,
    names: tuple[str, ...],
    late: frozenset[Edge],
    before: Mapping[str, Sequence[str]],
) -> dict[str, dict[str, SynapseCounts]]:
    """For each node by which sources, and over which fans, what it puts out is reached."""
    ways: dict[str, dict[str, SynapseCounts]] = {}
    many = 0
    for name in names:
        node = graph.nodes[name]
        if isinstance(node, (*_POPULATIONS, nir.Input)):
            ways[name] = {name: one_to_one(_size(node))}
    for name in names:
        if name not in ways:
            found: dict[str, list[SynapseCounts]] = {}
            for source, fan in _arriving(name, before, ways, late):
                found.setdefault(source, []).append(fan)
                many += 1 + len(fan.maps)
            _check_ways(name, many)
            ways[name] = {
                source: through(merged(fans), name, graph.nodes[name])
                for source, fans in found.items()
            }
    return ways


def _check_ways(name: str, many: int) -> None:
    if many > _MOST_WAYS:
        raise ArtifactError(
            f"node {name!r}: {many} ways lead by here from neurons over nodes without spikes; at "
            f"most {_MOST_WAYS}. Join nodes without spikes between them into one."
        )


def _arriving(
    name: str,
    before: Mapping[str, Sequence[str]],
    ways: dict[str, dict[str, SynapseCounts]],
    late: frozenset[Edge],
) -> Iterator[tuple[str, SynapseCounts]]:
    """What comes to a node: source and fan of every edge; a loop of maps alone is cut."""
    for near in before[name]:
        for source, fan in ways.get(near, {}).items():
            closes = (near, name) in late and not fan.late
            yield source, replace(fan, late=True) if closes else fan


def _population(
    node: nir.NIRNode, name: str, presynaptic: tuple[Projection, ...], leaving: set[str]
) -> Population:
    """The population of a node; what of it leaves the chip goes to the `leaving`."""
    return Population(
        name=name,
        size=_size(node),
        shape=tuple(int(n) for n in node.output_type["output"]),
        presynaptic=presynaptic,
        biased=any(projection.fan.biased for projection in presynaptic),
        leaves=bool(leaving),
        decays=_different(node, ("tau", "tau_syn", "tau_mem")),
        thresholds=_different(node, ("v_threshold", "threshold")),
    )


def _different(node: nir.NIRNode, fields: tuple[str, ...]) -> int:
    """Different sets of these parameters among the neurons of a node."""
    code, different = np.zeros(1, np.int64), 1
    for values in (np.ravel(getattr(node, field)) for field in fields if hasattr(node, field)):
        _, place = np.unique(values, return_inverse=True)
        # at most as many as there are neurons: the product fits
        _, code = np.unique(code * len(values) + place, return_inverse=True)
        different = int(code.max()) + 1
    return different


def _host(
    graph: nir.NIRGraph,
    before: Mapping[str, Sequence[str]],
    ahead: Mapping[str, set[str]],
    on_chip: set[str],
) -> set[str]:
    """Nodes from which only outputs are reached, and none of those that a chip computes."""
    found: set[str] = set()
    outputs = set(graph.outputs)
    waiting = list(outputs)
    while waiting:
        target = waiting.pop()
        for name in before[target]:
            inside = isinstance(graph.nodes[name], nir.Input) or name in on_chip or name in found
            if not inside and all(each in found or each in outputs for each in ahead[name]):
                found.add(name)
                waiting.append(name)
    return found


def _size(node: nir.NIRNode) -> int:
    return int(np.prod(node.output_type["output"]))
