"""The float twin: a NIR graph computed in floating point, as its convention says.

This is the reference that quantised programs are compared with. It knows nothing of policies: it
walks the edges, sums what arrives at a node, and calls the node.
"""

import nir
import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from runtime.artifact import Artifact
from runtime.discrete import SPIKING
from runtime.errors import ArtifactError, ObservationError
from runtime.float_delay import Delay, delay_timesteps
from runtime.float_nodes import Array, Neurons, build
from runtime.order import Edge, has_loop, order, sources
from runtime.windows import CONVOLUTIONS

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
        self.input = _only(self.graph.inputs, "Input")
        self.output = _only(self.graph.outputs, "Output")
        self.spiking = _spiking(self.graph)
        waiting = self._waiting()
        into = {edge for edge in self.graph.edges if edge[1] in waiting}
        if self.convention.delay:
            into |= _into_weights(self.graph)
        in_steps = order(self.graph, into)
        self.loops = has_loop(self.graph)
        self.late = in_steps.late
        # a late edge may come from a later node of the same timestep, but not of all timesteps
        self.names = in_steps.names if self.loops else order(self.graph).names
        self.sources = {name: sources(self.graph, name) for name in self.names}
        self.nodes = {
            name: build(name, self.graph.nodes[name], self.convention, self.dtype)
            for name in self.names
        }
        for name in waiting:
            # its late edges are the first of its timesteps
            self.nodes[name] = Delay(name, waiting[name] - 1)
        # what each node put out in the timestep before, (B, 1, *shape)
        self.before: dict[str, Array] = {}

    def reset(self) -> None:
        """Begin again: currents and membranes are 0, and nothing is on its way."""
        self.before = {}
        for node in self.nodes.values():
            if isinstance(node, (Neurons, Delay)):
                node.reset()

    def run(self, raster: ArrayLike) -> Trace:
        """Spikes (B, T, *N) uint8 of each spiking node, and "output" (B, T, act).

        Where the convention lets a neuron send many in a timestep they are counted in int64.
        """
        x = self._checked(raster)
        if self.convention.state == "reset":
            self.reset()
        self._check_batch(len(x))
        parts = np.split(x, x.shape[1], axis=1) if self.loops else [x]
        with np.errstate(over="ignore", invalid="ignore"):
            steps = [self._advance(part) for part in parts]
        self._check_finite()
        values = {
            name: np.concatenate([step[name] for step in steps], axis=1)
            for name in (*self.spiking, self.output)
        }
        kind = np.int64 if self.convention.spikes == "many" else np.uint8
        trace: Trace = {name: values[name].astype(kind) for name in self.spiking}
        trace["output"] = values[self.output]
        return trace

    def _waiting(self) -> dict[str, NDArray[np.int64]]:
        """Timesteps of the Delay nodes that hold every value back for at least one timestep.

        Such a node opens a loop by itself, so that its delay counts once: I[t] = w z[t - delay].
        """
        delays = {
            name: delay_timesteps(name, node, self.convention)
            for name, node in self.graph.nodes.items()
            if isinstance(node, nir.Delay)
        }
        return {name: timesteps for name, timesteps in delays.items() if timesteps.min() >= 1}

    def _advance(self, x: Array) -> dict[str, Array]:
        """Output (B, T, *shape) of every node for the next T timesteps."""
        values: dict[str, Array] = {}
        for name in self.names:
            arriving = [self._along((source, name), values, x) for source in self.sources[name]]
            values[name] = self.nodes[name](sum(arriving[1:], arriving[0]) if arriving else x)
        self.before = {name: value[:, -1:] for name, value in values.items()}
        return values

    def _along(self, edge: Edge, values: dict[str, Array], x: Array) -> Array:
        """What arrives over an edge: what its source puts out now, or what it did before."""
        source = edge[0]
        if edge not in self.late:
            return values[source]
        shape = self.graph.nodes[source].output_type["output"]
        nothing = np.zeros((len(x), 1, *shape), self.dtype)
        before = self.before.get(source, nothing)
        if x.shape[1] == 1:
            return before
        return np.concatenate([before, values[source][:, :-1]], axis=1)

    def _checked(self, raster: ArrayLike) -> Array:
        x = np.asarray(raster, dtype=self.dtype)
        shape = tuple(int(n) for n in self.graph.nodes[self.input].input_type["input"])
        if x.ndim < 2 or x.shape[2:] != shape or not x.size:
            wanted = ", ".join(["B", "T", *map(str, shape)])
            raise ObservationError(
                f"the raster has shape {x.shape}; node {self.input!r} takes ({wanted}), with at "
                "least one timestep. Add the missing axis or give the raster of this network."
            )
        if not np.isfinite(x).all():
            raise ObservationError("the raster holds NaN or infinity; every value must be finite.")
        return x

    def _check_finite(self) -> None:
        """Refuse to go on from sums that were too large for the type of numbers."""
        for name, node in self.nodes.items():
            state = node.membrane if isinstance(node, Neurons) else self.before[name]
            if state is not None and not np.isfinite(state).all():
                raise ObservationError(
                    f"node {name!r}: its values became too large for {self.dtype}. Give a smaller "
                    "raster, or correct the weights that lead to it."
                )

    def _check_batch(self, batch: int) -> None:
        held = len(self.before[self.output]) if self.before else batch
        if held != batch:
            raise ObservationError(
                f"the graph holds the state of {held} networks, the raster is for {batch}. Call "
                "reset() between batches of different size."
            )


def _only(found: dict[str, nir.NIRNode], kind: str) -> str:
    if len(found) != 1:
        raise ArtifactError(
            f"the graph has {len(found)} {kind} nodes ({', '.join(sorted(found))}); exactly one is "
            "supported. Join them in the tool that wrote the file."
        )
    return next(iter(found))


def _spiking(graph: nir.NIRGraph) -> list[str]:
    kinds = (*SPIKING, nir.Threshold)
    names = sorted(name for name, node in graph.nodes.items() if isinstance(node, kinds))
    if "output" in names:
        raise ArtifactError("node 'output' spikes, but that name is the readout's. Rename it.")
    return names


def _into_weights(graph: nir.NIRGraph) -> set[Edge]:
    kinds = (nir.Affine, nir.Linear, *CONVOLUTIONS)
    return {edge for edge in graph.edges if isinstance(graph.nodes[edge[1]], kinds)}
