"""Everything between spikes as matrices: weights, windows, sums and delays, one for each lag.

A chain without spikes in it is linear but for its biases. So what it does to a unit impulse of a
source is a row of its matrix, and what it does to nothing is its bias.
"""

import math
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass
from typing import TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import build_node
from spikedeploy.runtime.graph.order import Timing, in_waves, sources
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, POOLS, multiplications

Floats: TypeAlias = NDArray[np.float64]
# what arrives how many timesteps late, (R, *shape)
Parts: TypeAlias = dict[int, Floats]

# impulses are cheap through these: most rows of their input are zero
_DENSE = (nir.Affine, nir.Linear)
_BIASED = (nir.Affine, *CONVOLUTIONS)
LINEAR = (nir.Linear, *_BIASED, *POOLS, nir.Scale, nir.Flatten, nir.Delay)

# bytes of matrices beyond which a network is a mistake on a chip: 33 million weights
_LARGEST = 1 << 28
# multiplications that finding a matrix may take
_HARDEST = 1 << 34
# edges that impulses may follow, over all targets
_MOST_VISITS = 1 << 18
# numbers that the impulses sent at once may fill, and how many are sent at most
_ENOUGH = 1 << 22
_MOST = 256


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """The nodes without spikes that lead to one target.

    target: name of a spiking node or an Output.
    names: of the nodes, each after its sources.
    sources: the spiking nodes and Inputs from which they, or the target, receive spikes.
    """

    target: str
    names: tuple[str, ...]
    sources: tuple[str, ...]


class Linear:
    """The linear part of a graph, and the memory that its matrices may take."""

    def __init__(self, graph: nir.NIRGraph, timing: Timing, convention: Convention) -> None:
        self._graph, self._timing = graph, timing
        self._inside = {n for n, node in graph.nodes.items() if isinstance(node, LINEAR)}
        self._nodes = {
            name: build_node(name, _unbiased(graph.nodes[name]), convention, np.float64)
            for name in self._inside
        }
        self._sources = sources(graph)
        self._bytes = self._visited = 0

    def region(self, target: str) -> LinearBlock:
        """The region before a target."""
        inside, presynaptic, waiting = set[str](), set[str](), [target]
        while waiting:
            for name in self._sources[waiting.pop()]:
                if name not in self._inside:
                    presynaptic.add(name)
                elif name not in inside:
                    inside.add(name)
                    waiting.append(name)
        return LinearBlock(target, tuple(self._ordered(inside)), tuple(sorted(presynaptic)))

    def matrices(self, region: LinearBlock, source: str) -> dict[int, Floats]:
        """(M, N) from a source to the target, by the timesteps that it takes."""
        size = self._size(source)
        self._check_size(region.target, size)
        self._check_work(region, source)
        if direct := self._direct(region, source):
            return direct
        found: dict[int, Floats] = {}
        for first, impulses in self._impulses(region, source):
            for lag, rows in self._respond(region, {source: {0: impulses}}).items():
                if lag not in found:
                    found[lag] = self._matrix(region.target, size)
                found[lag][first : first + len(rows)] = rows.reshape(len(rows), -1)
        # a Delay of different steps may leave nothing in one of them
        return {lag: m for lag, m in sorted(found.items()) if m.any()} or dict([min(found.items())])

    def bias(self, region: LinearBlock) -> Floats:
        """(N,) that arrives at the target in every timestep."""
        parts = self._respond(region, {}, biased=True)
        for lag, rows in parts.items():
            if lag and rows.any():
                raise RuleError(
                    f"rule bias: node {region.target!r}: a bias reaches it through a delay of "
                    f"{lag} timesteps, so that it would begin late, which no chip does. Put the "
                    "bias behind the delay."
                )
        nothing = np.zeros((1, self._size(region.target)))
        return np.asarray(parts.get(0, nothing).reshape(-1))

    def _matrix(self, target: str, size: int) -> Floats:
        """Memory of a matrix."""
        self._check_size(target, size)
        self._bytes += 8 * size * self._size(target)
        return np.zeros((size, self._size(target)))

    def _check_size(self, target: str, size: int) -> None:
        if (found := self._bytes + 8 * size * self._size(target)) > _LARGEST:
            raise RuleError(
                f"rule matrix: node {target!r}: as one matrix for each pair of layers, which a "
                f"chip's axons need, the weights take {found} bytes by here; at most {_LARGEST}. "
                "Run the network in float, or make its convolutions smaller."
            )

    def _check_work(self, region: LinearBlock, source: str) -> None:
        """Refuse windows so large that sending all impulses through them takes minutes."""
        nodes = [n for n in region.names if not isinstance(self._graph.nodes[n], _DENSE)]
        each = sum(multiplications(n, self._graph.nodes[n], self._shape(n)) for n in nodes)
        if (found := each * self._size(source)) > _HARDEST:
            raise RuleError(
                f"rule matrix: node {region.target!r}: the matrix from {source!r} takes {found} "
                f"multiplications; at most {_HARDEST}. Run the network in float, or make its "
                "convolutions smaller."
            )

    def _check_visits(self, region: LinearBlock) -> None:
        """Refuse so many nodes between neurons that following all of their edges takes minutes."""
        self._visited += sum(len(self._sources[name]) for name in (*region.names, region.target))
        if self._visited > _MOST_VISITS:
            raise RuleError(
                f"rule matrix: node {region.target!r}: {len(region.names)} nodes without spikes "
                f"lead to it, and by here {self._visited} edges were followed; at most "
                f"{_MOST_VISITS}. Join nodes without spikes between them into one."
            )

    def _impulses(self, region: LinearBlock, source: str) -> Iterator[tuple[int, Floats]]:
        """Rows of the identity as (R, *shape), a few at a time, and the number of the first."""
        shape = self._shape(source)
        names = (source, *region.names, region.target)
        some = min(max(1, _ENOUGH // max(map(self._size, names))), _MOST)
        size = self._size(source)
        for first in range(0, size, some):
            rows = np.zeros((min(some, size - first), size))
            np.fill_diagonal(rows[:, first:], 1.0)
            yield first, rows.reshape(len(rows), *shape)

    def _respond(
        self, region: LinearBlock, start: Mapping[str, Parts], biased: bool = False
    ) -> Parts:
        """What arrives at the target when the sources put out `start`."""
        self._check_visits(region)
        put = dict(start)
        for name in region.names:
            put[name] = self._through(name, self._arriving(name, put))
            if biased and isinstance(self._graph.nodes[name], _BIASED):
                _add(put[name], 0, self._bias(name))
        return self._arriving(region.target, put)

    def _arriving(self, name: str, put: Mapping[str, Parts]) -> Parts:
        arriving: Parts = {}
        for source in self._sources[name]:
            late = (source, name) in self._timing.late
            for lag, rows in put.get(source, {}).items():
                _add(arriving, lag + late, rows)
        return arriving

    def _through(self, name: str, arriving: Parts) -> Parts:
        """What a node makes of what arrives, its bias left out."""
        if (steps := self._timing.delays.get(name)) is None:
            compute = self._nodes[name]
            return {lag: np.asarray(compute(rows[None])[0]) for lag, rows in arriving.items()}
        put: Parts = {}
        for lag, rows in arriving.items():
            for step in np.unique(steps).tolist():
                _add(put, lag + step, np.where(steps == step, rows, 0.0))
        return put

    def _bias(self, name: str) -> Floats:
        node = self._graph.nodes[name]
        shape = self._shape(name)
        bias = node.bias.astype(np.float64)
        if isinstance(node, CONVOLUTIONS):
            bias = bias.reshape(-1, *(1 for _ in shape[1:]))
        return np.broadcast_to(bias, shape)[None]

    def _direct(self, region: LinearBlock, source: str) -> dict[int, Floats]:
        """The weights themselves of a lone Affine or Linear; nothing where there is more."""
        name, *others = region.names or ("",)
        node = self._graph.nodes.get(name)
        alone = [self._sources.get(at) for at in (name, region.target)] == [[source], [name]]
        if others or not alone or not isinstance(node, _DENSE) or node.weight.ndim != 2:
            return {}
        edges = [(source, name), (name, region.target)]
        self._bytes += 8 * node.weight.size
        # + 0.0: as a sum has it, no zero is negative
        weight = np.ascontiguousarray(node.weight.T, np.float64) + 0.0
        return {sum(edge in self._timing.late for edge in edges): weight}

    def _shape(self, name: str) -> tuple[int, ...]:
        return tuple(int(n) for n in self._graph.nodes[name].output_type["output"])

    def _size(self, name: str) -> int:
        return math.prod(self._shape(name))

    def _ordered(self, inside: set[str]) -> list[str]:
        """The nodes, each after its sources; in a loop of them values would never settle."""
        names = in_waves(inside, [(s, name) for name in inside for s in self._sources[name]])
        if left := sorted(inside - set(names)):
            raise RuleError(
                f"rule recurrence: nodes {', '.join(left)}: a loop without a spiking node, whose "
                "values would never settle; a chip has none. Put a neuron into it, or run the "
                "graph in float."
            )
        return names


def _unbiased(node: nir.NIRNode) -> nir.NIRNode:
    if not isinstance(node, _BIASED):
        return node
    plain = copy(node)
    plain.bias = np.zeros_like(node.bias)
    return plain


def _add(parts: Parts, lag: int, rows: Floats) -> None:
    parts[lag] = parts[lag] + rows if lag in parts else rows
