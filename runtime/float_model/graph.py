"""The float twin: a NIR graph computed in floating point, as its convention says.

This is the reference that quantised programs are compared with. It knows nothing of policies: it
walks the edges, sums what arrives at a node, and calls the node.
"""

from collections.abc import Mapping
from typing import Any

import nir
import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.runtime.float_model.nodes import Array, Delay, FloatNeurons, Node, build
from spikedeploy.runtime.graph.neurons import SPIKING
from spikedeploy.runtime.graph.order import Edge, sources, timing
from spikedeploy.runtime.graph.ports import named, ports

# bytes of everything that one run computes
LARGEST = 1 << 32

Trace = dict[str, NDArray[np.generic]]


class FloatGraph:
    """A running network: `run` goes on from the state before where the convention keeps it.

    Without loops every node is computed for all timesteps at once; with loops all nodes are
    computed for one timestep after the other.
    """

    def __init__(self, artifact: Artifact, dtype: DTypeLike = np.float64) -> None:
        self.graph = artifact.graph
        self.convention = artifact.convention
        self.dtype = np.dtype(dtype)
        self.inputs, self.outputs = ports(self.graph.inputs), ports(self.graph.outputs)
        self.spiking = _spiking(self.graph)
        self.timing = timing(self.graph, self.convention)
        self.sources = {name: sources(self.graph, name) for name in self.timing.names}
        self.nodes = self._built()
        # what each node put out in the timestep before, (B, 1, *shape)
        self.before: dict[str, Array] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Nodes without a state are functions, which pickle does not take; copies build them."""
        kinds = (FloatNeurons, Delay)
        states = {name: node for name, node in self.nodes.items() if isinstance(node, kinds)}
        return {**self.__dict__, "nodes": states}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.nodes = {**self._built(), **state["nodes"]}

    def reset(self) -> None:
        """Begin again: currents and membranes are 0, and nothing is on its way."""
        self.before = {}
        for node in self.nodes.values():
            if isinstance(node, (FloatNeurons, Delay)):
                node.reset()

    def run(self, raster: ArrayLike | Mapping[str, ArrayLike]) -> Trace:
        """Spikes (B, T, *N) uint8 of each spiking node, and "output" (B, T, *act).

        Where the convention lets a neuron send many in a timestep they are counted in int64.

        raster: (B, T, *shape); of several Input nodes one for each, by name. Several Output nodes
            are in the trace by their names, and then there is no "output".
        """
        x = self._checked(raster)
        if self.convention.state == "reset":
            self.reset()
        batch, timesteps = next(iter(x.values())).shape[:2]
        self._check_batch(batch)
        self._check_room(batch, timesteps)
        parts = [_row(x, t) for t in range(timesteps)] if self.timing.loops else [x]
        with np.errstate(over="ignore", invalid="ignore"):
            steps = [self._advance(part) for part in parts]
        self._check_finite()
        values = {
            name: np.concatenate([step[name] for step in steps], axis=1)
            for name in (*self.spiking, *(port.name for port in self.outputs))
        }
        kind = np.int64 if self.convention.spikes == "many" else np.uint8
        trace: Trace = {name: values[name].astype(kind) for name in self.spiking}
        for port in self.outputs:
            trace["output" if len(self.outputs) == 1 else port.name] = values[port.name]
        return trace

    def _built(self) -> dict[str, Node]:
        """The nodes, without a state."""
        nodes = {
            name: build(name, self.graph.nodes[name], self.convention, self.dtype)
            for name in self.timing.names
        }
        for name, timesteps in self.timing.delays.items():
            # without the timestep that its late edges take
            nodes[name] = Delay(name, timesteps)
        return nodes

    def _advance(self, x: Mapping[str, Array]) -> dict[str, Array]:
        """Output (B, T, *shape) of every node for the next T timesteps."""
        values: dict[str, Array] = dict(x)
        timesteps = next(iter(x.values())).shape[1]
        for name in self.timing.names:
            if arriving := [self._along((s, name), values, timesteps) for s in self.sources[name]]:
                values[name] = self.nodes[name](sum(arriving[1:], arriving[0]))
        self.before = {name: value[:, -1:] for name, value in values.items()}
        return values

    def _along(self, edge: Edge, values: dict[str, Array], timesteps: int) -> Array:
        """What arrives over an edge: what its source puts out now, or what it did before."""
        source = edge[0]
        if edge not in self.timing.late:
            return values[source]
        if (before := self.before.get(source)) is None:
            batch = len(values[self.inputs[0].name])
            shape = self.graph.nodes[source].output_type["output"]
            before = np.zeros((batch, 1, *shape), self.dtype)
        if timesteps == 1:
            return before
        return np.concatenate([before, values[source][:, :-1]], axis=1)

    def _checked(self, raster: ArrayLike | Mapping[str, ArrayLike]) -> dict[str, Array]:
        if isinstance(raster, Mapping):
            given = named(self.inputs, {n: np.asarray(r, self.dtype) for n, r in raster.items()})
        else:
            given = named(self.inputs, np.asarray(raster, self.dtype))
        if not all(np.isfinite(rows).all() for rows in given.values()):
            raise ObservationError("the raster holds NaN or infinity; every value must be finite.")
        return given

    def _check_finite(self) -> None:
        """Refuse to go on from sums that were too large for the type of numbers."""
        for name, node in self.nodes.items():
            state = node.membrane if isinstance(node, FloatNeurons) else self.before[name]
            if state is not None and not np.isfinite(state).all():
                raise ObservationError(
                    f"node {name!r}: its values became too large for {self.dtype}. Give a smaller "
                    "raster, or correct the weights that lead to it."
                )

    def _check_room(self, batch: int, timesteps: int) -> None:
        nodes = self.graph.nodes.values()
        numbers = sum(int(np.prod(node.output_type["output"])) for node in nodes)
        if (found := numbers * batch * timesteps * self.dtype.itemsize) > LARGEST:
            raise ObservationError(
                f"all nodes over {timesteps} timesteps and a batch of {batch} take {found} bytes; "
                f"at most {LARGEST}. Run fewer timesteps at once with state 'kept', or a smaller "
                "batch."
            )

    def _check_batch(self, batch: int) -> None:
        held = len(next(iter(self.before.values()))) if self.before else batch
        if held != batch:
            raise ObservationError(
                f"the graph holds the state of {held} networks, the raster is for {batch}. Call "
                "reset() between batches of different size."
            )


def _spiking(graph: nir.NIRGraph) -> list[str]:
    kinds = (*SPIKING, nir.Threshold)
    names = sorted(name for name, node in graph.nodes.items() if isinstance(node, kinds))
    if "output" in names:
        raise ArtifactError("node 'output' spikes, but that name is the readout's. Rename it.")
    return names


def _row(x: Mapping[str, Array], t: int) -> dict[str, Array]:
    return {name: rows[:, t : t + 1] for name, rows in x.items()}
