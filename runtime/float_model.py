"""The float twin: a NIR graph computed in floating point under its convention.

The reference that every compiled program is compared with. It computes all of NIR, including
networks that fit no chip: the nodes in order, each on the sum of its inputs. A node is called with
x (B, T, *shape), T timesteps at once, which may be one. Neurons and delays go on from the state of
the call before; the other kinds have none.

Neurons: with r[t] = 1 where the membrane that the timestep before left is above the threshold,

    P[t] = b V[t-1] + I[t] + leak                      before a reset
    zero, subtract      spike where P > threshold, then V = v_reset, or V = P - height
    zero-delayed        V = b v_reset + I + leak where r, else P; of CubaLIF V = v_reset where r
    subtract-delayed    V = P - r height
    subtract-ahead      C = P - r height, spike where C > threshold, then V = C - (spike - r) height
    none                V = P

where height = threshold - v_reset, and where delayed neurons spike by V itself. The last four are
snnTorch's (snntorch 1.0.0, _neurons/leaky.py and synaptic.py): its default is subtract-delayed;
subtract-ahead is its subtraction with reset_delay=False, where a membrane that is still above the
threshold after its reset spikes again only above twice the threshold.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial
from operator import mul
from typing import Any, TypeAlias

import nir
import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.copies import Copyable
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.runtime.graph.discretisation import (
    GRADED_MOST,
    NEURONS,
    SPIKING,
    SigmaDelta,
    discretise,
)
from spikedeploy.runtime.graph.order import Edge, delay_timesteps, sources
from spikedeploy.runtime.graph.ports import by_port, check_unmasked, ports
from spikedeploy.runtime.graph.shapes import (
    CONVOLUTIONS,
    DENSE,
    POOLS,
    ConvWindow,
    window_of,
)

Array: TypeAlias = NDArray[np.floating[Any]]
# output (B, T, *shape) for the input x (B, T, *shape)
Node: TypeAlias = Callable[[Array], Array]

# values that the windows of a convolution or pool may hold at once: bounds the memory of a call
CHUNK_VALUES = 1 << 22


def build_node(name: str, node: nir.NIRNode, convention: Convention, dtype: DTypeLike) -> Node:
    """The function that computes a node; ArtifactError for kinds that are not supported."""
    if isinstance(node, DENSE):
        bias = node.bias.astype(dtype) if isinstance(node, nir.Affine) else None
        if node.weight.ndim > 2:
            # in one order, whatever the file has, so that a copy computes the same bits
            return partial(_stacked, np.ascontiguousarray(node.weight, dtype=dtype), bias)
        # (M, N) in C order, which BLAS multiplies in half the time
        return partial(_dense, np.ascontiguousarray(node.weight.T, dtype=dtype), bias)
    if isinstance(node, CONVOLUTIONS):
        return convolution(name, node, dtype)
    if isinstance(node, POOLS):
        # a mean divides by the whole kernel, zeros of the padding included, which is the default of
        # torch.nn.AvgPool2d; NIR leaves it open
        window = window_of(name, node)
        size = math.prod(window.kernel) if isinstance(node, nir.AvgPool2d) else 1
        return partial(_in_chunks, window, partial(_pool, size))
    if isinstance(node, nir.Delay):
        return FloatDelay(delay_timesteps(name, node, convention))
    if isinstance(node, NEURONS):
        return FloatNeurons(name, node, convention, dtype)
    if isinstance(node, (nir.Input, nir.Output)):
        return _identity
    if isinstance(node, nir.Scale):
        return partial(mul, node.scale.astype(dtype))
    if isinstance(node, nir.Threshold):
        return partial(_exceed, node.threshold.astype(dtype))
    if isinstance(node, nir.Flatten):
        return partial(_reshape, tuple(int(n) for n in node.output_type["output"]))
    raise ArtifactError(
        f"node {name!r}: {type(node).__name__} is no primitive of NIR that is supported. Use one."
    )


def _identity(x: Array) -> Array:
    return x


def _exceed(threshold: Array, x: Array) -> Array:
    return (x > threshold).astype(threshold.dtype)


def _reshape(shape: tuple[int, ...], x: Array) -> Array:
    return x.reshape(*x.shape[:2], *shape)


class FloatDelay:
    """y(t) = x(t - delay), and 0 before the first input has arrived.

    timesteps: (*N) delay of each element.
    """

    def __init__(self, timesteps: NDArray[np.int64]) -> None:
        self.timesteps = timesteps
        # (B, up to the longest delay, *N), the inputs of the timesteps before, as far as known
        self.past: Array | None = None

    def reset(self) -> None:
        """Forget all inputs."""
        self.past = None

    def __call__(self, x: Array) -> Array:
        """Output (B, T, *N) of the next T timesteps."""
        rows = x if self.past is None else np.concatenate([self.past, x], axis=1)
        first = rows.shape[1] - x.shape[1]
        output = np.zeros_like(x)
        for steps in np.unique(self.timesteps):
            delayed = self.timesteps == steps
            arriving = rows[:, max(0, first - steps) : max(0, rows.shape[1] - steps)]
            output[:, x.shape[1] - arriving.shape[1] :, delayed] = arriving[..., delayed]
        self.past = rows[:, max(0, rows.shape[1] - self.timesteps.max()) :]
        return output


def _dense(weight: Array, bias: Array | None, x: Array) -> Array:
    """Y = W x + b with weights (M, N), all timesteps in one product."""
    rows = x.reshape(-1, x.shape[2])
    # leaving out inputs that are 0 in every timestep halves the time at batch 1
    (active,) = rows.any(axis=0).nonzero()
    sparse = 2 * len(active) < len(weight)
    y: Array = rows.take(active, axis=1) @ weight.take(active, axis=0) if sparse else rows @ weight
    y = y.reshape(*x.shape[:2], -1)
    return y if bias is None else y + bias


def _stacked(weight: Array, bias: Array | None, x: Array) -> Array:
    """Y = W x + b with weights (..., N, M), a matrix for each row of the input (..., M)."""
    y: Array = np.matmul(weight, x[..., None])[..., 0]
    return y if bias is None else y + bias


def convolution(name: str, node: nir.NIRNode, dtype: DTypeLike) -> Node:
    """Conv1d or Conv2d: output (B, T, N, *P) of x (B, T, C, *X).

    y[n, p] = sum over c, k of W[n, c, k] x[c, p stride + k dilation - padding] + b[n], where c
    are the C / groups channels of the group of n (torch.nn.functional.conv2d).
    """
    window, groups = window_of(name, node), int(node.groups)
    # (G, C/G K, N/G)
    weight = node.weight.reshape(groups, len(node.weight) // groups, -1).swapaxes(1, 2)
    weight = np.ascontiguousarray(weight, dtype=dtype)
    bias = node.bias.astype(dtype).reshape(-1, *(1 for _ in window.kernel))
    return partial(_in_chunks, window, partial(_convolve, weight, bias))


def _pool(size: int, windows: Array) -> Array:
    """Sums of windows (R, C, *P, *K), divided by `size`, as (R, C, *P)."""
    return np.asarray(windows.sum(axis=(-2, -1)) / size)


def _convolve(weight: Array, bias: Array, windows: Array) -> Array:
    """Windows (R, C, *P, *K) times weights (G, C/G K, N/G), plus the bias, as (R, N, *P)."""
    groups, axes = len(weight), bias.ndim - 1
    rows, channels, *positions = windows.shape[: 2 + axes]
    # (R, G, C/G, *P, *K), still a view
    split = windows.reshape(rows, groups, channels // groups, *windows.shape[2:])
    before, after = range(3, 3 + axes), range(3 + axes, 3 + 2 * axes)
    columns = split.transpose(0, 1, *before, 2, *after)
    columns = columns.reshape(rows, groups, math.prod(positions), -1)
    product = (columns @ weight).swapaxes(2, 3).reshape(rows, -1, *positions)
    return np.asarray(product + bias)


def _in_chunks(window: ConvWindow, compute: Node, x: Array) -> Array:
    """The computation over chunks of rows whose windows hold at most CHUNK_VALUES values."""
    # (R, C, *X)
    rows = x.reshape(-1, *x.shape[2:])
    values = x.shape[2] * math.prod(window.positions(x.shape[3:])) * math.prod(window.kernel)
    size = max(1, CHUNK_VALUES // values)
    parts = [compute(window.view(rows[i : i + size])) for i in range(0, len(rows), size)]
    y = np.concatenate(parts)
    return np.asarray(y.reshape(*x.shape[:2], *y.shape[1:]), dtype=x.dtype)


# resets that act in the timestep after a spike, or already ahead of the next one
_LATE = ("zero-delayed", "subtract-delayed", "subtract-ahead")


class FloatNeurons:
    """A layer of neurons; puts out its spikes, or its membranes where it has no threshold."""

    def __init__(
        self, name: str, node: nir.NIRNode, convention: Convention, dtype: DTypeLike
    ) -> None:
        layer = discretise(name, node, convention)
        self.reset_mode = convention.reset
        self.late = layer.threshold is not None and convention.reset in _LATE
        self.spikes = convention.spikes
        self.a = None if layer.current_decay is None else layer.current_decay.astype(dtype)
        self.b = layer.membrane_decay.astype(dtype)
        self.gain = layer.gain.astype(dtype)
        self.leak = layer.leak.astype(dtype)
        self.threshold = None if layer.threshold is None else layer.threshold.astype(dtype)
        self.v_reset = layer.v_reset.astype(dtype)
        self.floor = _floor(layer.threshold, convention)
        self.current: Array | None = None
        self.membrane: Array | None = None

    def reset(self) -> None:
        """Set currents and membranes to 0."""
        self.current = self.membrane = None

    def __call__(self, x: Array) -> Array:
        """Spikes or membranes (B, T, *N) of the next T timesteps."""
        output = np.empty_like(x)
        current = membrane = np.zeros_like(x[:, 0])
        if self.current is not None and self.membrane is not None:
            current, membrane = self.current, self.membrane
        drive = x * self.gain
        for t in range(x.shape[1]):
            # I = a I + gain x
            current = drive[:, t] if self.a is None else self.a * current + drive[:, t]
            # V = b V + I + leak
            before = membrane
            membrane = self.b * membrane + current + self.leak
            if self.late:
                output[:, t], membrane = self._fire_late(before, membrane, current)
            else:
                output[:, t], membrane = self._fire(membrane)
        self.current, self.membrane = current, membrane
        return output

    def _fire(self, membrane: Array) -> tuple[NDArray[Any], Array]:
        """Output (B, *N) of this timestep, and the membrane after the reset."""
        if self.threshold is None:
            return membrane, membrane
        spikes = self._spikes(membrane, self.threshold)
        if self.reset_mode == "subtract":
            membrane = membrane - spikes * (self.threshold - self.v_reset)
        elif self.reset_mode == "zero":
            membrane = np.where(spikes, self.v_reset, membrane)
        return spikes, self._floored(membrane)

    def _fire_late(
        self, before: Array, membrane: Array, current: Array
    ) -> tuple[NDArray[Any], Array]:
        """Spikes (B, *N) of this timestep, and the membrane, reset by the spikes of the last one.

        before: (B, *N) membrane that the timestep before left.
        membrane: (B, *N) as it would be without a reset.
        """
        threshold = np.asarray(self.threshold)
        due = self._spikes(before, threshold)
        height = threshold - self.v_reset
        if self.reset_mode == "zero-delayed":
            # a LIF keeps its input of the timestep, a CubaLIF does not
            kept = self.b * self.v_reset + current + self.leak
            membrane = np.where(due, kept if self.a is None else self.v_reset, membrane)
        else:
            membrane = membrane - due * height
        spikes = self._spikes(membrane, threshold)
        if self.reset_mode == "subtract-ahead":
            membrane = membrane - (spikes.astype(int) - due) * height
        return spikes, self._floored(membrane)

    def _floored(self, membrane: Array) -> Array:
        return membrane if self.floor is None else np.maximum(membrane, self.floor)

    def _spikes(self, membrane: Array, threshold: Array) -> NDArray[Any]:
        if self.spikes == "above":
            return np.asarray(membrane > threshold)
        reached = membrane >= threshold
        if self.spikes == "reached":
            return np.asarray(reached)
        # n = floor((V - v_reset) / (threshold - v_reset))
        count = np.floor((membrane - self.v_reset) / (threshold - self.v_reset))
        return np.asarray(count * reached)


class SigmaDeltaNeurons(FloatNeurons):
    """A layer of sigma-delta neurons (runtime.graph.discretisation); puts out graded spikes.

    sent: (B, *N) graded spikes so far, added up.
    """

    def __init__(
        self,
        name: str,
        node: nir.NIRNode,
        convention: Convention,
        dtype: DTypeLike,
        neurons: SigmaDelta,
    ) -> None:
        super().__init__(name, node, convention, dtype)
        self.step = neurons.threshold.astype(dtype)
        self.bias = neurons.bias.astype(dtype)
        self.sent: Array | None = None

    def reset(self) -> None:
        """Set sigma to 0, as if nothing had been sent."""
        super().reset()
        self.sent = None

    def _fire(self, membrane: Array) -> tuple[NDArray[Any], Array]:
        """Graded spikes (B, *N) of this timestep, and sigma, which stays."""
        sent = np.zeros_like(membrane) if self.sent is None else self.sent
        # e = max(sigma + b, 0) / threshold - q
        apart = np.maximum(membrane + self.bias, 0) / self.step - sent
        far = np.abs(apart)
        graded = np.where(far >= 1, np.sign(apart) * np.floor(far + 0.5), 0)
        graded = np.clip(graded, -GRADED_MOST, GRADED_MOST)
        self.sent = sent + graded
        return graded, membrane


def _floor(threshold: NDArray[np.float64] | None, convention: Convention) -> Array | None:
    if threshold is None or convention.floor == "none":
        return None
    return np.zeros_like(threshold) if convention.floor == "zero" else -threshold


# bytes that one run may compute
MAX_RUN_BYTES = 1 << 32

Trace = dict[str, NDArray[np.generic]]


class FloatGraph(Copyable):
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
        kinds, graded = (*SPIKING, nir.Threshold), self.sigma_delta
        nodes = sorted(self.graph.nodes.items())
        self.spiking = [n for n, node in nodes if isinstance(node, kinds) or n in graded]
        if "output" in self.spiking:
            raise ArtifactError(
                "node 'output' spikes, but that name is reserved for the readout. Rename it."
            )
        self.timing = artifact.timing
        self.sources = sources(self.graph)
        self.nodes = self._build()
        # what each node put out in the timestep before, (B, 1, *shape)
        self.before: dict[str, Array] = {}

    def reset(self) -> None:
        """Set currents, membranes and all delayed values to 0."""
        self.before = {}
        for node in self.nodes.values():
            if isinstance(node, (FloatNeurons, FloatDelay)):
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
        parts = [x]
        if self.timing.loops:
            rows = range(timesteps)
            parts = [{name: each[:, t : t + 1] for name, each in x.items()} for t in rows]
        with np.errstate(over="ignore", invalid="ignore"):
            steps = [self._advance(part) for part in parts]
        self._check_finite()
        values = {
            name: np.concatenate([step[name] for step in steps], axis=1)
            for name in (*self.spiking, *(port.name for port in self.outputs))
        }
        many = self.spiking if self.convention.spikes == "many" else self.sigma_delta
        trace: Trace = {
            name: values[name].astype(np.int64 if name in many else np.uint8)
            for name in self.spiking
        }
        for port in self.outputs:
            trace["output" if len(self.outputs) == 1 else port.name] = values[port.name]
        return trace

    def _build(self) -> dict[str, Node]:
        nodes = {
            name: build_node(name, self.graph.nodes[name], self.convention, self.dtype)
            for name in self.timing.names
        }
        for name, neurons in self.sigma_delta.items():
            node = self.graph.nodes[name]
            nodes[name] = SigmaDeltaNeurons(name, node, self.convention, self.dtype, neurons)
        for name, timesteps in self.timing.delays.items():
            # without the timestep that its late edges take
            nodes[name] = FloatDelay(timesteps)
        return nodes

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
        """The output of an edge's source, a timestep later over late edges."""
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
