"""The wiring of a graph: which nodes of neurons are connected, and in what order they run.

Neurons without a threshold are readouts: an Output alone may receive their membranes.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.linear import LINEAR, Linear, LinearBlock
from spikedeploy.runtime.compiler.program import HostOutput, ReadoutTerm
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.graph.neurons import NEURONS, SPIKING
from spikedeploy.runtime.graph.order import timing
from spikedeploy.runtime.graph.ports import Port, ports

Floats = NDArray[np.float64]

_KNOWN = (nir.Input, nir.Output, *LINEAR, *NEURONS)


@dataclass(frozen=True, eq=False)
class _Connection:
    """One connection of a layer.

    source: the spiking node or the input that it comes from.
    weight: (M, N) axon-major, float.
    lag: [timesteps] from a spike to its arrival, as the graph and its convention say.
    """

    source: str
    weight: Floats
    lag: int


@dataclass(frozen=True, eq=False)
class LayerGraph:
    """A graph as layers of neurons; neurons of any shape in a row, in C order.

    input: name of the input; those of several Input nodes, joined.
    inputs: the Input nodes, side by side in the input's axons.
    layers: names of the nodes of neurons, each after its sources of the same timestep.
    connections: of each layer.
    bias: (N,) of each layer.
    outlets: the Output nodes.
    """

    input: str
    inputs: tuple[Port, ...]
    layers: tuple[str, ...]
    connections: dict[str, tuple[_Connection, ...]]
    bias: dict[str, Floats]
    outlets: tuple[HostOutput, ...]

    @property
    def width(self) -> int:
        """M of the input."""
        return sum(port.size for port in self.inputs)


def wiring(
    graph: nir.NIRGraph, convention: Convention, sigma_delta: Collection[str] = ()
) -> LayerGraph:
    """The wiring of a graph; nodes that neither spike nor are linear are refused.

    sigma_delta: names of nodes that send graded spikes, although NIR calls them integrators.
    """
    _check_kinds(graph)
    when = timing(graph, convention)
    linear, inputs = Linear(graph, when, convention), ports(graph.inputs)
    layers = tuple(name for name in when.names if isinstance(graph.nodes[name], NEURONS))
    regions = {name: linear.region(name) for name in (*layers, *sorted(graph.outputs))}
    for layer in layers:
        _check_sources(graph, regions[layer], sigma_delta)
    name = ", ".join(port.name for port in inputs)
    while name in layers:
        name = f"{name}, inputs"
    return LayerGraph(
        input=name,
        inputs=inputs,
        layers=layers,
        connections={layer: _connections(linear, regions[layer], name, inputs) for layer in layers},
        bias={layer: linear.bias(regions[layer]) for layer in layers},
        outlets=tuple(_outlet(graph, linear, regions[p.name], p) for p in ports(graph.outputs)),
    )


def _check_kinds(graph: nir.NIRGraph) -> None:
    for name in sorted(graph.nodes):
        node = graph.nodes[name]
        if not isinstance(node, _KNOWN):
            raise RuleError(
                f"rule primitive: node {name!r}: {type(node).__name__} has no place on a chip, "
                "whose neurons send spikes and whose synapses are linear; possible are "
                f"{', '.join(kind.__name__ for kind in _KNOWN)}. Replace it, or run it in float."
            )


def _check_sources(graph: nir.NIRGraph, region: LinearBlock, sigma_delta: Collection[str]) -> None:
    """Refuse neurons that receive membranes: between neurons there are only spikes."""
    for source in region.sources:
        node = graph.nodes[source]
        if source in sigma_delta:
            continue
        if isinstance(node, NEURONS) and not isinstance(node, SPIKING):
            raise RuleError(
                f"rule primitive: node {source!r}: {type(node).__name__} does not spike, and node "
                f"{region.target!r} receives its membranes; only an Output can. Give it a "
                "threshold, or run it in float."
            )


def _connections(
    linear: Linear, region: LinearBlock, name: str, inputs: Sequence[Port]
) -> tuple[_Connection, ...]:
    """The connections onto a layer by source and lag; those of all Inputs as one matrix."""
    rows = _rows(inputs)
    presynaptic: dict[tuple[str, int], Floats] = {}
    for source in region.sources:
        for lag, matrix in linear.matrices(region, source).items():
            if source not in rows:
                presynaptic[source, lag] = matrix
            elif len(rows) == 1:
                presynaptic[name, lag] = matrix
            else:
                width = sum(port.size for port in inputs)
                all_ = presynaptic.setdefault((name, lag), np.zeros((width, matrix.shape[1])))
                all_[rows[source]] = matrix
    return tuple(_Connection(source, matrix, lag) for (source, lag), matrix in presynaptic.items())


def _rows(inputs: Sequence[Port]) -> dict[str, slice]:
    """The axons of each Input node among those of the input."""
    rows, first = {}, 0
    for port in inputs:
        rows[port.name] = slice(first, first + port.size)
        first += port.size
    return rows


def _outlet(graph: nir.NIRGraph, linear: Linear, region: LinearBlock, port: Port) -> HostOutput:
    """What an Output node receives from the layers; the host computes it."""
    for source in region.sources:
        if not isinstance(graph.nodes[source], NEURONS):
            raise RuleError(
                f"rule outputs: node {port.name!r}: the output must come from neurons; it "
                f"is connected to the input {source!r} without neurons between. Put "
                "some there, or run the graph in float."
            )
    taps = [
        ReadoutTerm(source, None if _is_identity(matrix) else matrix, lag)
        for source in region.sources
        for lag, matrix in linear.matrices(region, source).items()
    ]
    return HostOutput(port, tuple(taps), linear.bias(region))


def _is_identity(matrix: Floats) -> bool:
    square = matrix.shape[0] == matrix.shape[1]
    return (
        square
        and bool((np.diagonal(matrix) == 1).all())
        and (np.count_nonzero(matrix) == len(matrix))
    )
