"""Networks of NIR nodes whose numbers are torch parameters.

A `TorchNetwork` is a graph of two kinds of nodes: maps without a memory, which torch computes
(`Map`), and neurons (`Neurons`), which a chip computes. `artifact` writes the present numbers as
NIR; `network_of` makes a network of an artifact. What a torch module becomes is in `from_torch`.

Neurons are the difference equation of `runtime.graph.neurons`, with gains that stay as they are:

    I[t] = a I[t-1] + gain x[t]        V[t] = b V[t-1] + I[t] + leak
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import nir
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import NEURONS, DiscreteNeuron
from spikedeploy.runtime.graph.shapes import Shape, shape_of, window_of
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies.neurons import Surrogate
from spikedeploy.trainers.policies.policy import to_array

Edge: TypeAlias = tuple[str, str]
Array: TypeAlias = NDArray[np.float64]

# of a neuron that never forgets beside ones that do, in a node with a time constant for each:
# 1 - b is this, far below what any chip's decay factor resolves
_SLOWEST = 1e-12


class Map(nn.Module):
    """A node without a memory: (R, *takes) to (R, *puts), R rows of batch and time.

    takes, puts: shapes without the axis of rows
    """

    takes: Shape
    puts: Shape

    def node(self) -> nir.NIRNode:
        """Return the NIR node of the present numbers."""
        raise NotImplementedError


class Weights(Map):
    """A matrix or convolution of a torch layer, with the normalisation behind it folded in.

    layer: nn.Linear, nn.Conv1d or nn.Conv2d
    norm: nn.BatchNorm behind it, at its running statistics, or None
    """

    def __init__(
        self,
        layer: nn.Linear | nn.Conv1d | nn.Conv2d,
        takes: Shape,
        norm: nn.BatchNorm1d | nn.BatchNorm2d | None = None,
    ) -> None:
        super().__init__()
        self.layer, self.norm, self.takes = layer, norm, takes
        with torch.no_grad():
            self.puts = tuple(self(layer.weight.new_zeros(1, *takes)).shape[1:])

    def numbers(self) -> tuple[Tensor, Tensor | None]:
        """Return weight and bias as they are deployed, before rounding."""
        weight, bias, norm = self.layer.weight, self.layer.bias, self.norm
        if norm is None:
            return weight, bias
        # y = gamma (W x + b - mean) / sqrt(var + eps) + beta   (Ioffe and Szegedy 2015)
        assert norm.running_mean is not None
        assert norm.running_var is not None
        factor = torch.rsqrt(norm.running_var + norm.eps)
        factor = factor if norm.weight is None else factor * norm.weight
        offset = -norm.running_mean if bias is None else bias - norm.running_mean
        offset = offset * factor if norm.bias is None else offset * factor + norm.bias
        return weight * factor.reshape(-1, *[1] * (weight.ndim - 1)), offset

    def forward(self, x: Tensor) -> Tensor:
        """Return (R, *puts)."""
        weight, bias = self.numbers()
        layer = self.layer
        if isinstance(layer, nn.Linear):
            return nn.functional.linear(x, weight, bias)
        found: Tensor = layer._conv_forward(x, weight, bias)
        return found

    def node(self) -> nir.NIRNode:
        """Return Linear, Affine, Conv1d or Conv2d."""
        weight, bias = (None if each is None else to_array(each) for each in self.numbers())
        assert weight is not None
        layer = self.layer
        if isinstance(layer, nn.Linear):
            return nir.Linear(weight) if bias is None else nir.Affine(weight, bias)
        kind = nir.Conv1d if isinstance(layer, nn.Conv1d) else nir.Conv2d
        extents = self.takes[1:] if kind is nir.Conv2d else self.takes[1]
        return kind(
            input_shape=extents,
            weight=weight,
            stride=layer.stride if kind is nir.Conv2d else layer.stride[0],
            padding=layer.padding
            if isinstance(layer.padding, str)
            else (layer.padding if kind is nir.Conv2d else layer.padding[0]),
            dilation=layer.dilation if kind is nir.Conv2d else layer.dilation[0],
            groups=layer.groups,
            bias=np.zeros(len(weight)) if bias is None else bias,
        )


class Fixed(Map):
    """A node without parameters of torch: a pool, Flatten, Scale.

    made: the NIR node
    function: what it computes of (R, *takes)
    """

    def __init__(
        self, made: nir.NIRNode, function: Callable[[Tensor], Tensor], takes: Shape
    ) -> None:
        super().__init__()
        self.made, self.function, self.takes = made, function, takes
        with torch.no_grad():
            self.puts = tuple(function(torch.zeros(1, *takes)).shape[1:])

    def forward(self, x: Tensor) -> Tensor:
        """Return (R, *puts)."""
        return self.function(x)

    def node(self) -> nir.NIRNode:
        """Return the node."""
        return self.made


class Delay(nn.Module):
    """Spikes that arrive some timesteps later.

    steps: (*takes) [timesteps]
    """

    def __init__(self, steps: NDArray[np.int64]) -> None:
        super().__init__()
        self.steps, self.takes = steps, steps.shape
        self.puts = self.takes

    def forward(self, rows: Tensor) -> Tensor:
        """Return (T, B, *takes) of all timesteps, late."""
        return torch.stack([self.at(rows[: t + 1].unbind()) for t in range(len(rows))])

    def at(self, rows: Sequence[Tensor]) -> Tensor:
        """Return what arrives (B, *takes) in the last timestep of the rows so far."""
        found = torch.zeros_like(rows[-1])
        for step in np.unique(self.steps).tolist():
            if step < len(rows):
                found = torch.where(torch.from_numpy(self.steps == step), rows[-1 - step], found)
        return found


@dataclass(frozen=True, eq=False)
class Equation:
    """The difference equation of a layer in torch, each (N,) along one axis.

    current_decay: a, or None where the input itself is the current
    membrane_decay: b
    threshold: or None where neurons do not spike and their membranes are the output
    leak: added to the membrane in every timestep, or None
    gain: factor of the input; it is not trained
    """

    current_decay: Tensor | None
    membrane_decay: Tensor
    threshold: Tensor | None
    leak: Tensor | None
    gain: Tensor


class Neurons(nn.Module):
    """Neurons of a shape, whose numbers are parameters of theirs or of a module of the user.

    takes, puts: (*shape) of the layer
    derivative: of a spike, a function of the membrane minus the threshold; None if it has none
    """

    derivative: Surrogate | None = None

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.takes = self.puts = shape

    def numbers(self) -> tuple[Tensor | None, Tensor, Tensor | None, Tensor | None, Tensor]:
        """Return the fields of Equation, tensors that broadcast to the shape of the layer."""
        raise NotImplementedError

    def equation(self, dtype: torch.dtype) -> Equation:
        """Return the present numbers, with their gradients."""
        found = (
            None if n is None else n.to(dtype).expand(self.takes).reshape(-1)
            for n in self.numbers()
        )
        return Equation(*found)  # type: ignore[arg-type]

    def node(self, dt: float) -> nir.NIRNode:
        """Return IF, LIF, CubaLIF, I, LI or CubaLI of the present numbers."""
        current, decay, threshold, leak, gain = (
            None if n is None else np.array(np.broadcast_to(to_array(n), self.takes))
            for n in self.numbers()
        )
        assert decay is not None
        assert gain is not None
        rest: dict[str, Array] = {}
        if threshold is not None:
            rest = {"v_threshold": threshold, "v_reset": np.zeros(self.takes)}
        if current is None and leak is None and (decay == 1).all():
            return (nir.IF if rest else nir.I)(r=gain / dt, **rest)
        lost = np.maximum(1 - decay, _SLOWEST)
        # tau = dt / (1 - b) ; r = gain / (1 - b) ; v_leak = leak / (1 - b)
        rest |= {"r": gain / lost, "v_leak": np.zeros(self.takes) if leak is None else leak / lost}
        if current is None:
            return (nir.LI if threshold is None else nir.LIF)(tau=dt / lost, **rest)
        # w_in = tau_syn / dt
        synaptic = 1 / np.maximum(1 - current, _SLOWEST)
        kind = nir.CubaLI if threshold is None else nir.CubaLIF
        return kind(tau_mem=dt / lost, tau_syn=dt * synaptic, w_in=synaptic, **rest)


class FreeNeurons(Neurons):
    """Neurons whose decay factors, thresholds and leaks are parameters of their own."""

    gain: Tensor

    def __init__(self, made: DiscreteNeuron) -> None:
        super().__init__(made.gain.shape)
        self.current_decay = _parameter(made.current_decay)
        self.membrane_decay = nn.Parameter(_tensor(made.membrane_decay))
        self.threshold = _parameter(made.threshold)
        self.leak = _parameter(made.leak if made.leak.any() else None)
        self.register_buffer("gain", _tensor(made.gain))

    def numbers(self) -> tuple[Tensor | None, Tensor, Tensor | None, Tensor | None, Tensor]:
        """Return the parameters, decay factors from 0 to 1."""
        current = self.current_decay
        bounded = None if current is None else current.clamp(0, 1)
        return bounded, self.membrane_decay.clamp(0, 1), self.threshold, self.leak, self.gain


class TorchNetwork(nn.Module):
    """A graph of maps and neurons between one input and one output.

    nodes: by name; names of the file have dots in them, and keys of modules none, so they are
        numbered inside
    edges: between names, and from INPUT and to OUTPUT
    """

    INPUT, OUTPUT = "input", "output"

    def __init__(
        self,
        nodes: Mapping[str, Map | Neurons | Delay],
        edges: Sequence[Edge],
        takes: Shape,
        puts: Shape,
    ) -> None:
        super().__init__()
        self.names = tuple(nodes)
        self.listed = nn.ModuleList(nodes.values())
        self.edges, self.takes, self.puts = tuple(edges), takes, puts

    @property
    def nodes(self) -> dict[str, Map | Neurons | Delay]:
        """Return the nodes by name."""
        return dict(zip(self.names, self.listed, strict=True))  # type: ignore[arg-type]

    def artifact(
        self,
        convention: Convention,
        codec: Codec | None = None,
        provenance: Provenance | None = None,
    ) -> Artifact:
        """Return the present numbers as an artifact, in float64."""
        nodes: dict[str, nir.NIRNode] = {
            self.INPUT: nir.Input({"input": np.array(self.takes)}),
            self.OUTPUT: nir.Output({"output": np.array(self.puts)}),
        }
        for name, node in self.nodes.items():
            if isinstance(node, Neurons):
                nodes[name] = node.node(convention.dt)
            elif isinstance(node, Delay):
                nodes[name] = nir.Delay(node.steps * convention.dt)
            else:
                nodes[name] = node.node()
        graph = nir.NIRGraph(nodes, list(self.edges), type_check=False)
        return Artifact(graph, codec, convention, provenance)


def network_of(artifact: Artifact) -> TorchNetwork:
    """Return the network of an artifact, whose numbers become parameters in float32.

    Raises ArtifactError for several inputs or outputs, and for nodes that torch cannot train.
    """
    graph = artifact.graph
    if len(graph.inputs) != 1 or len(graph.outputs) != 1:
        raise ArtifactError(
            f"the network has {len(graph.inputs)} inputs and {len(graph.outputs)} outputs; it is "
            "trained with one of each. Join them, or train it where it was made."
        )
    (source,), (end,) = graph.inputs, graph.outputs
    renamed = {source: TorchNetwork.INPUT, end: TorchNetwork.OUTPUT}
    nodes = {
        name: _module_of(name, node, artifact)
        for name, node in graph.nodes.items()
        if name not in renamed
    }
    edges = [(renamed.get(a, a), renamed.get(b, b)) for a, b in graph.edges]
    return TorchNetwork(nodes, edges, shape_of(graph.inputs[source]), shape_of(graph.outputs[end]))


def _module_of(name: str, node: nir.NIRNode, artifact: Artifact) -> Map | Neurons | Delay:
    takes = tuple(int(n) for n in node.input_type["input"])
    if name in artifact.sigma_delta:
        raise ArtifactError(
            f"node {name!r}: sigma-delta neurons are trained by `distill`, not from a file."
        )
    if isinstance(node, NEURONS):
        made = artifact.neurons[name]
        if made.v_reset.any():
            raise ArtifactError(
                f"node {name!r}: v_reset goes to {made.v_reset.max():g}; on a chip a spike resets "
                "the membrane to 0. Shift it."
            )
        return FreeNeurons(made)
    if isinstance(node, nir.Linear | nir.Affine) and node.weight.ndim == 2:
        outputs, inputs = node.weight.shape
        linear = nn.Linear(inputs, outputs, bias=isinstance(node, nir.Affine))
        return Weights(_filled(linear, node), takes)
    if isinstance(node, nir.Conv1d | nir.Conv2d):
        return Weights(_filled(_convolution(name, node), node), takes)
    if isinstance(node, nir.SumPool2d | nir.AvgPool2d):
        return Fixed(node, pool_of(name, node), takes)
    if isinstance(node, nir.Flatten):
        puts = shape_of(node)
        return Fixed(node, lambda x: x.reshape(len(x), *puts), takes)
    if isinstance(node, nir.Scale):
        scale = _tensor(node.scale)
        return Fixed(node, lambda x: x * scale, takes)
    if isinstance(node, nir.Delay):
        steps = np.rint(node.delay.astype(np.float64) / artifact.convention.dt)
        return Delay(steps.astype(np.int64))
    raise ArtifactError(
        f"node {name!r}: {type(node).__name__} cannot be trained here; possible are Linear, "
        "Affine, Conv1d, Conv2d, SumPool2d, AvgPool2d, Flatten, Scale, Delay and neurons."
    )


def _convolution(name: str, node: nir.NIRNode) -> nn.Conv1d | nn.Conv2d:
    window = window_of(name, node)
    outputs, inputs = node.weight.shape[0], node.weight.shape[1] * int(node.groups)
    symmetric = all(before == after for before, after in window.padding)
    settings: dict[str, Any] = {
        "stride": window.stride,
        "padding": tuple(before for before, _ in window.padding) if symmetric else "same",
        "dilation": window.dilation,
        "groups": int(node.groups),
    }
    kind: type[nn.Conv1d] | type[nn.Conv2d]
    kind = nn.Conv1d if isinstance(node, nir.Conv1d) else nn.Conv2d
    return kind(inputs, outputs, window.kernel, **settings)  # type: ignore[arg-type]


def _filled(layer: Any, node: nir.NIRNode) -> Any:  # noqa: ANN401
    with torch.no_grad():
        layer.weight.copy_(_tensor(node.weight))
        if layer.bias is not None:
            layer.bias.copy_(_tensor(node.bias))
    return layer


def pool_of(name: str, node: nir.NIRNode) -> Callable[[Tensor], Tensor]:
    """Return what a pool computes of (R, *takes)."""
    window = window_of(name, node)
    padding = tuple(before for before, _ in window.padding)
    # NIR's sum pool is the mean times the elements of the kernel, padding included
    factor = 1.0 if isinstance(node, nir.AvgPool2d) else float(np.prod(window.kernel))

    def pool(x: Tensor) -> Tensor:
        mean = nn.functional.avg_pool2d(x, window.kernel, window.stride, padding)
        return mean * factor

    return pool


def _tensor(values: NDArray[Any]) -> Tensor:
    return torch.from_numpy(np.array(values, np.float32))


def _parameter(values: NDArray[Any] | None) -> nn.Parameter | None:
    return None if values is None else nn.Parameter(_tensor(values))
