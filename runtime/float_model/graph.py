"""The float twin: a NIR graph computed in floating point under its convention.

The reference that quantised programs are compared with. It computes the nodes in order, each on the
sum of what its edges deliver.
"""

from collections.abc import Mapping
from typing import Any

import nir
import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.runtime.float_model.neurons import Array, FloatNeurons, SigmaDeltaNeurons
from spikedeploy.runtime.float_model.nodes import Delay, Node, build_node
from spikedeploy.runtime.graph.neurons import SPIKING
from spikedeploy.runtime.graph.order import Edge, sources, timing
from spikedeploy.runtime.graph.ports import by_port, check_unmasked, ports
from spikedeploy.runtime.graph.sigma_delta import SigmaDelta

# bytes that one run may compute
MAX_RUN_BYTES = 1 << 32

Trace = dict[str, NDArray[np.generic]]


class FloatGraph:
    """A network with its state, which `run` continues where the convention keeps it.

    Without loops each node is computed for all timesteps at once; with loops all nodes are computed
    for one timestep after the other.
    """

    def __init__(self, artifact: Artifact, dtype: DTypeLike = np.float64) -> None:
        self.graph = artifact.graph
        self.convention = artifact.convention
        self.dtype = np.dtype(dtype)
        self.inputs, self.outputs = ports(self.graph.inputs), ports(self.graph.outputs)
        self.sigma_delta = artifact.sigma_delta
        self.spiking = _spiking(self.graph, self.sigma_delta)
        self.timing = timing(self.graph, self.convention)
        self.sources = sources(self.graph)
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
        """Set currents, membranes and all delayed values to 0."""
        self.before = {}
        for node in self.nodes.values():
            if isinstance(node, (FloatNeurons, Delay)):
                node.reset()

    def run(self, raster: ArrayLike | Mapping[str, ArrayLike]) -> Trace:
        """Spikes (B, T, *N) uint8 of each spiking node, and "output" (B, T, *act).

        Where the convention allows several spikes of a neuron in a timestep, counts in int64; of
        sigma-delta neurons signed numbers in int64.
        Several Output nodes are in the trace by their names, instead of "output". Raises
        ObservationError where the raster does not fit the graph, or values overflow.

        raster: (B, T, *shape); of several Input nodes one for each, by name.
        """
        x = self._checked(raster)
        if self.convention.state == "reset":
            self.reset()
        batch, timesteps = next(iter(x.values())).shape[:2]
        self._check_batch(batch)
        self._check_size(batch, timesteps)
        parts = [_row(x, t) for t in range(timesteps)] if self.timing.loops else [x]
        with np.errstate(over="ignore", invalid="ignore"):
            steps = [self._advance(part) for part in parts]
        self._check_finite()
        values = {
            name: np.concatenate([step[name] for step in steps], axis=1)
            for name in (*self.spiking, *(port.name for port in self.outputs))
        }
        trace: Trace = {name: values[name].astype(self._kind(name)) for name in self.spiking}
        for port in self.outputs:
            trace["output" if len(self.outputs) == 1 else port.name] = values[port.name]
        return trace

    def _built(self) -> dict[str, Node]:
        """The nodes, without a state."""
        nodes = {
            name: build_node(name, self.graph.nodes[name], self.convention, self.dtype)
            for name in self.timing.names
        }
        for name, neurons in self.sigma_delta.items():
            node = self.graph.nodes[name]
            nodes[name] = SigmaDeltaNeurons(name, node, self.convention, self.dtype, neurons)
        for name, timesteps in self.timing.delays.items():
            # without the timestep that its late edges take
            nodes[name] = Delay(name, timesteps)
        return nodes

    def _kind(self, name: str) -> type[np.integer[Any]]:
        """What holds the spikes of a node."""
        many = self.convention.spikes == "many" or name in self.sigma_delta
        return np.int64 if many else np.uint8

    def _advance(self, x: Mapping[str, Array]) -> dict[str, Array]:
        """Output (B, T, *shape) of every node for the next T timesteps."""
        values: dict[str, Array] = dict(x)
        timesteps = next(iter(x.values())).shape[1]
        for name in self.timing.names:
            if arriving := [
                self._delivered((s, name), values, timesteps) for s in self.sources[name]
            ]:
                values[name] = self.nodes[name](sum(arriving[1:], arriving[0]))
        self.before = {name: value[:, -1:] for name, value in values.items()}
        return values

    def _delivered(self, edge: Edge, values: dict[str, Array], timesteps: int) -> Array:
        """What arrives over an edge: the output of its source, a timestep later over late edges."""
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
        for each in raster.values() if isinstance(raster, Mapping) else (raster,):
            check_unmasked(each)
        if isinstance(raster, Mapping):
            given = by_port(self.inputs, {n: np.asarray(r, self.dtype) for n, r in raster.items()})
        else:
            given = by_port(self.inputs, np.asarray(raster, self.dtype))
        if not all(np.isfinite(rows).all() for rows in given.values()):
            raise ObservationError(
                "the raster holds NaN or infinity; every value must be finite. Correct the raster."
            )
        return given

    def _check_finite(self) -> None:
        """Raise ObservationError where a membrane, or the last output of a node, overflowed."""
        for name, node in self.nodes.items():
            state = node.membrane if isinstance(node, FloatNeurons) else self.before[name]
            if state is not None and not np.isfinite(state).all():
                raise ObservationError(
                    f"node {name!r}: its values became too large for {self.dtype}. Give a smaller "
                    "raster, or correct the weights that lead to it."
                )

    def _check_size(self, batch: int, timesteps: int) -> None:
        nodes = self.graph.nodes.values()
        values = sum(int(np.prod(node.output_type["output"])) for node in nodes)
        if (found := values * batch * timesteps * self.dtype.itemsize) > MAX_RUN_BYTES:
            raise ObservationError(
                f"the outputs of all nodes over {timesteps} timesteps and a batch of {batch} take "
                f"{found} bytes; at most {MAX_RUN_BYTES}. Run fewer timesteps at once with "
                "state 'kept', or a smaller batch."
            )

    def _check_batch(self, batch: int) -> None:
        held = len(next(iter(self.before.values()))) if self.before else batch
        if held != batch:
            raise ObservationError(
                f"the graph holds the state of {held} networks, the raster is for {batch}. Call "
                "reset() between batches of different size."
            )


def _spiking(graph: nir.NIRGraph, graded: Mapping[str, SigmaDelta]) -> list[str]:
    kinds = (*SPIKING, nir.Threshold)
    names = sorted(n for n, node in graph.nodes.items() if isinstance(node, kinds) or n in graded)
    if "output" in names:
        raise ArtifactError(
            "node 'output' spikes, but that name is reserved for the readout. Rename it."
        )
    return names


def _row(x: Mapping[str, Array], t: int) -> dict[str, Array]:
    return {name: rows[:, t : t + 1] for name, rows in x.items()}
