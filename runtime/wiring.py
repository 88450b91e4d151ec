"""The wiring of a graph: which spiking node hears which, and in what order they run."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import nir
import numpy as np
from numpy.typing import NDArray

from runtime.discrete import SPIKING
from runtime.errors import RuleError
from runtime.order import Edge, order, sources

Floats = NDArray[np.float64]

WEIGHTED = (nir.Affine, nir.Linear)
KNOWN = (nir.Input, nir.Output, *WEIGHTED, *SPIKING)


@dataclass(frozen=True, eq=False)
class Wire:
    """One connection of a layer.

    source: the spiking node or the input that it comes from.
    weight: (M, N) axon-major, float.
    late: whether it closes a loop, and so delivers one timestep later.
    """

    source: str
    weight: Floats
    late: bool


@dataclass(frozen=True, eq=False)
class Wiring:
    """A graph as layers of spiking nodes.

    input: name of the input.
    width: M of the input.
    layers: names of the spiking nodes, each after those that it hears without feedback.
    wires: of each layer.
    bias: (N,) of each layer.
    output: the spiking node that the output listens to.
    readout: the affine node between them, or None.
    """

    input: str
    width: int
    layers: tuple[str, ...]
    wires: dict[str, tuple[Wire, ...]]
    bias: dict[str, Floats]
    output: str
    readout: nir.NIRNode | None


def wiring(graph: nir.NIRGraph) -> Wiring:
    """The wiring of a graph of weights and spiking nodes; others are refused."""
    _check_kinds(graph)
    source, sink = _only(graph, nir.Input), _only(graph, nir.Output)
    ordered = order(graph)
    layers = tuple(name for name in ordered.names if _is_spiking(graph, name))
    output, readout = _end(graph, sink)
    return Wiring(
        input=source,
        width=int(np.prod(graph.nodes[source].input_type["input"])),
        layers=layers,
        wires={name: tuple(_wires(graph, name, ordered.late)) for name in layers},
        bias={name: _bias(graph, name) for name in layers},
        output=output,
        readout=readout,
    )


def _check_kinds(graph: nir.NIRGraph) -> None:
    for name in sorted(graph.nodes):
        node = graph.nodes[name]
        if not isinstance(node, KNOWN):
            raise RuleError(
                f"node {name!r}: {type(node).__name__} has no place on a chip yet; possible are "
                f"{', '.join(kind.__name__ for kind in KNOWN)}. Run it in float."
            )
        if isinstance(node, SPIKING) and node.v_threshold.ndim != 1:
            raise RuleError(
                f"node {name!r}: neurons have shape {node.v_threshold.shape}; a chip needs them in "
                "one row. Flatten the layer."
            )


def _only(graph: nir.NIRGraph, kind: type[nir.NIRNode]) -> str:
    found = [name for name in sorted(graph.nodes) if isinstance(graph.nodes[name], kind)]
    if len(found) != 1:
        raise RuleError(
            f"the graph has {len(found)} {kind.__name__} nodes ({', '.join(found)}); a chip needs "
            "one. Join them, or run the graph in float."
        )
    return str(found[0])


def _is_spiking(graph: nir.NIRGraph, name: str) -> bool:
    return isinstance(graph.nodes[name], SPIKING)


def _wires(graph: nir.NIRGraph, name: str, late: Collection[Edge]) -> Iterator[Wire]:
    """Every path of at most one weighted node into a spiking node."""
    for before in sources(graph, name):
        node = graph.nodes[before]
        if not isinstance(node, WEIGHTED):
            size = graph.nodes[name].v_threshold.size
            yield Wire(before, np.eye(size), (before, name) in late)
            continue
        for source in sources(graph, before):
            if isinstance(graph.nodes[source], WEIGHTED):
                raise RuleError(
                    f"nodes {source!r} and {before!r}: two maps in a row without spikes between. "
                    "Multiply them into one."
                )
            weight = np.ascontiguousarray(node.weight.T, dtype=np.float64)
            yield Wire(source, weight, (source, before) in late or (before, name) in late)


def _bias(graph: nir.NIRGraph, name: str) -> Floats:
    total = np.zeros(graph.nodes[name].v_threshold.size)
    for before in sources(graph, name):
        if isinstance(graph.nodes[before], nir.Affine):
            total += graph.nodes[before].bias
    return total


def _end(graph: nir.NIRGraph, sink: str) -> tuple[str, nir.NIRNode | None]:
    """The spiking node before the output and the map between them, if any."""
    last = _single(graph, sink)
    if _is_spiking(graph, last):
        return last, None
    layer = _single(graph, last)
    if not isinstance(graph.nodes[last], WEIGHTED) or not _is_spiking(graph, layer):
        raise RuleError(
            f"node {sink!r}: the output must come from a spiking node, or from one through one "
            f"map; found {layer!r} -> {last!r}. Run the graph in float."
        )
    return layer, graph.nodes[last]


def _single(graph: nir.NIRGraph, name: str) -> str:
    before = sources(graph, name)
    if len(before) != 1:
        raise RuleError(
            f"node {name!r}: {len(before)} nodes lead to it ({', '.join(before)}); on the way out "
            "of a chip there must be one. Join them, or run the graph in float."
        )
    return str(before[0])
