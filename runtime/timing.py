"""The timing of a graph: in which order its nodes run, and where values are held back."""

from collections.abc import Mapping
from dataclasses import dataclass

import nir
import numpy as np
from numpy.typing import NDArray

from runtime.convention import Convention
from runtime.float_delay import delay_timesteps
from runtime.order import Edge, has_loop, order
from runtime.windows import CONVOLUTIONS


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
