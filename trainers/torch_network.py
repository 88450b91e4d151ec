"""Networks of NIR nodes whose numbers are torch parameters.

A `TorchNetwork` is a graph of maps without a memory (`Weights`, `Fixed`), which torch computes,
delays, and neurons, which a chip computes. `TorchNetwork.artifact` writes the present numbers as
NIR; `network_of` reads them from an artifact. `from_torch` makes a network of a torch module.

Neurons are the difference equation of `runtime.graph.discretisation`, with gains that stay as they
are:

    I[t] = a I[t-1] + gain x[t]        V[t] = b V[t-1] + I[t] + leak
"""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple, TypeAlias

import nir
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.discretisation import NEURONS
from spikedeploy.runtime.graph.shapes import Shape, shape_of, window_of
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.surrogate_neurons import Surrogate

Edge: TypeAlias = tuple[str, str]
Array: TypeAlias = NDArray[np.float64]
_LAYERS = {"Linear": nn.Linear, "Conv1d": nn.Conv1d, "Conv2d": nn.Conv2d}  # that have weights

# of a neuron that never forgets beside ones that do, in a node with a time constant for each:
# 1 - b is this, far below what any chip's decay factor resolves
_SLOWEST = 1e-12
_FIXED = ("Flatten", "AvgPool2d", "SumPool2d", "Scale")


def to_array(tensor: Tensor) -> Array:
    """Return a tensor in float64."""
    array: Array = tensor.detach().cpu().numpy().astype(np.float64)
    return array


def _tensor(values: NDArray[Any]) -> Tensor:
    return torch.from_numpy(np.array(values, np.float32))


class Node(nn.Module):
    """A node of a network, from (*takes) to (*puts) in a timestep of a sample."""

    takes: Shape
    puts: Shape

    def node(self, dt: float) -> nir.NIRNode:
        """Return the NIR node of the present numbers, for timesteps of dt seconds."""
        raise NotImplementedError

    def detached(self) -> "Node":
        """Return the node with numbers of its own, equal to the present ones."""
        return self

    def spec(self) -> dict[str, Any]:
        """Return what makes an equal detached node, with numbers to be loaded; for JSON."""
        raise NotImplementedError


class Weights(Node):
    """A matrix or convolution of a torch layer, with the normalisation behind it folded in.

    layer: nn.Linear, nn.Conv1d or nn.Conv2d
    norm: nn.BatchNorm behind it, at its running statistics, or None
    fitting: trainers.fitting.Fitting, which makes the weights fit the axons of a chip, or None
    """

    def __init__(self, layer: Any, takes: Shape) -> None:  # noqa: ANN401
        super().__init__()
        self.layer, self.takes = layer, takes
        self.norm: Any = None
        self.fitting: Any = None
        with torch.no_grad():
            self.puts = tuple(self(layer.weight.new_zeros(1, *takes)).shape[1:])

    def numbers(self) -> tuple[Tensor, Tensor | None]:
        """Return weight and bias as they are deployed, before rounding."""
        weight, bias = self._folded()
        return weight if self.fitting is None else self.fitting(weight), bias

    def project(self) -> None:
        """Bring weights that an update moved away from what fits back to it."""
        if self.fitting is not None and self.norm is None:
            self.fitting.project(self.layer.weight)

    def _folded(self) -> tuple[Tensor, Tensor | None]:
        weight, bias, norm = self.layer.weight, self.layer.bias, self.norm
        if norm is None:
            return weight, bias
        # y = gamma (W x + b - mean) / sqrt(var + eps) + beta   (Ioffe and Szegedy 2015)
        factor = torch.rsqrt(norm.running_var + norm.eps)
        factor = factor if norm.weight is None else factor * norm.weight
        offset = -norm.running_mean if bias is None else bias - norm.running_mean
        offset = offset * factor if norm.bias is None else offset * factor + norm.bias
        return weight * factor.reshape(-1, *[1] * (weight.ndim - 1)), offset

    def forward(self, x: Tensor) -> Tensor:
        """Return (R, *puts) of (R, *takes), R rows of batch and time."""
        weight, bias = self.numbers()
        if isinstance(self.layer, nn.Linear):
            return nn.functional.linear(x, weight, bias)
        found: Tensor = self.layer._conv_forward(x, weight, bias)
        return found

    def node(self, dt: float) -> nir.NIRNode:
        """Return Linear, Affine, Conv1d or Conv2d."""
        weight, bias = (None if each is None else to_array(each) for each in self.numbers())
        assert weight is not None
        layer = self.layer
        if isinstance(layer, nn.Linear):
            return nir.Linear(weight) if bias is None else nir.Affine(weight, bias)
        flat = isinstance(layer, nn.Conv1d)
        stride, padding, dilation = (
            each[0] if flat and isinstance(each, tuple) else each
            for each in (layer.stride, layer.padding, layer.dilation)
        )
        return (nir.Conv1d if flat else nir.Conv2d)(
            input_shape=self.takes[1] if flat else self.takes[1:],
            weight=weight,
            stride=stride,
            padding=padding,
            dilation=dilation,
            groups=layer.groups,
            bias=np.zeros(len(weight)) if bias is None else bias,
        )

    def detached(self) -> "Weights":
        """Return these weights in a layer of their own, without a normalisation."""
        weight, bias = self._folded()
        layer = _layer(**self._layer_spec(bias is not None))
        for own, number in ((layer.weight, weight), (layer.bias, bias)):
            if own is not None and number is not None:
                own.data = number.detach().clone()
                own.requires_grad_(number.requires_grad)
        return Weights(layer, self.takes)

    def _layer_spec(self, bias: bool) -> dict[str, Any]:
        kind = next(name for name, each in _LAYERS.items() if isinstance(self.layer, each))
        names = [name for name in self.layer.__constants__ if name != "output_padding"]
        return {"kind": kind, "bias": bias} | {name: getattr(self.layer, name) for name in names}

    def spec(self) -> dict[str, Any]:
        """Return the arguments of the torch layer, and which of its numbers are trained."""
        trained = [name for name, p in self.layer.named_parameters() if p.requires_grad]
        layer = self._layer_spec(self.layer.bias is not None)
        return {"kind": "Weights", "takes": self.takes, "layer": layer, "trained": trained}


def _layer(kind: str, **settings: Any) -> Any:  # noqa: ANN401
    return _LAYERS[kind](**settings)


class Fixed(Node):
    """A node without parameters: a pool, Flatten, Scale.

    made: the NIR node
    """

    def __init__(self, made: nir.NIRNode, takes: Shape) -> None:
        super().__init__()
        self.made, self.takes = made, takes
        self._function = _function_of(made)
        with torch.no_grad():
            self.puts = tuple(self(torch.zeros(1, *takes)).shape[1:])

    def forward(self, x: Tensor) -> Tensor:
        """Return (R, *puts) of (R, *takes), R rows of batch and time."""
        return self._function(x)

    def node(self, dt: float) -> nir.NIRNode:
        """Return the node."""
        return self.made

    def spec(self) -> dict[str, Any]:
        """Return the kind and the fields of the node."""
        names = {each.name for each in fields(self.made)} - {
            "input_type", "output_type", "metadata",
        }  # fmt: skip
        held = {name: np.asarray(getattr(self.made, name)).tolist() for name in sorted(names)}
        return {"kind": type(self.made).__name__, "takes": self.takes, "fields": held}


def flatten(takes: Shape) -> Fixed:
    """Return the node that makes one axis of all but the rows."""
    return Fixed(nir.Flatten({"input": np.array(takes)}, 0, -1), takes)


def _function_of(node: nir.NIRNode) -> Callable[[Tensor], Tensor]:
    """Return what a node computes of (R, *takes)."""
    if isinstance(node, nir.Flatten):
        puts = shape_of(node)
        return lambda x: x.reshape(len(x), *puts)
    if isinstance(node, nir.Scale):
        scale = _tensor(node.scale)
        return lambda x: x * scale
    window = window_of(type(node).__name__, node)
    padding = tuple(before for before, _ in window.padding)
    # NIR's sum pool is the mean times the elements of the kernel, padding included
    factor = 1.0 if isinstance(node, nir.AvgPool2d) else float(np.prod(window.kernel))
    return lambda x: nn.functional.avg_pool2d(x, window.kernel, window.stride, padding) * factor


class Delay(Node):
    """Spikes that arrive some timesteps later.

    steps: (*takes) [timesteps]
    """

    def __init__(self, steps: NDArray[np.int64]) -> None:
        super().__init__()
        self.steps = steps
        self.takes = self.puts = steps.shape

    def node(self, dt: float) -> nir.NIRNode:
        """Return the Delay."""
        return nir.Delay(self.steps * dt)

    def spec(self) -> dict[str, Any]:
        """Return the timesteps."""
        return {"kind": "Delay", "steps": self.steps.tolist()}


class Equation(NamedTuple):
    """The numbers of the difference equation of neurons.

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


class Neurons(Node):
    """Neurons of a shape, whose numbers are parameters of theirs or of a module of the user.

    derivative: derivative of a spike, a function of the membrane minus the threshold; None if it
        has none
    """

    derivative: Surrogate | None = None

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.takes = self.puts = shape

    def numbers(self) -> Equation:
        """Return the present numbers, tensors that broadcast to the shape of the layer."""
        raise NotImplementedError

    def equation(self, dtype: torch.dtype) -> Equation:
        """Return the present numbers, with their gradients, each (N,)."""
        return Equation(*(
            None if n is None else n.to(dtype).expand(self.takes).reshape(-1)
            for n in self.numbers()
        ))  # type: ignore[arg-type]  # fmt: skip

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

    def detached(self) -> "FreeNeurons":
        """Return neurons with numbers of their own, of which those are trained that are here."""
        held = {name: n for name, n in self.numbers()._asdict().items() if n is not None}
        trained = [name for name, number in held.items() if number.requires_grad]
        return FreeNeurons(self.takes, {name: n.detach() for name, n in held.items()}, trained)


class FreeNeurons(Neurons):
    """Neurons whose numbers are tensors of their own.

    numbers: by the names of Equation's fields, broadcasting to the shape of the layer
    trained: names of those that are parameters; the gain is none
    """

    def __init__(
        self, shape: Shape, numbers: Mapping[str, Tensor], trained: Collection[str]
    ) -> None:
        super().__init__(shape)
        for name in Equation._fields:
            value = numbers.get(name)
            own = None if value is None else value.clone()  # layers of a checkpoint share none
            if own is not None and name in trained and name != "gain":
                self.register_parameter(name, nn.Parameter(own))
            else:
                self.register_buffer(name, own)

    def numbers(self) -> Equation:
        """Return the tensors, decay factors from 0 to 1."""
        found = Equation(*(getattr(self, name) for name in Equation._fields))
        current = found.current_decay
        return found._replace(
            current_decay=None if current is None else current.clamp(0, 1),
            membrane_decay=found.membrane_decay.clamp(0, 1),
        )

    def spec(self) -> dict[str, Any]:
        """Return the shapes of all numbers, and which are trained."""
        shapes = {
            name: list(n.shape) for name, n in self.numbers()._asdict().items() if n is not None
        }
        trained = [name for name, _ in self.named_parameters()]
        return {"kind": "Neurons", "takes": self.takes, "shapes": shapes, "trained": trained}


class TorchNetwork(nn.Module):
    """A graph between one input and one output.

    nodes: by name; names of the file have dots in them, and keys of modules none, so they are
        numbered inside
    edges: between names, and from INPUT and to OUTPUT
    """

    INPUT, OUTPUT = "input", "output"

    def __init__(
        self, nodes: Mapping[str, Node], edges: Sequence[Edge], takes: Shape, puts: Shape
    ) -> None:
        super().__init__()
        self.names = tuple(nodes)
        self.listed = nn.ModuleList(nodes.values())
        self.edges, self.takes, self.puts = tuple(edges), takes, puts

    @property
    def nodes(self) -> dict[str, Node]:
        """Return the nodes by name."""
        return dict(zip(self.names, self.listed, strict=True))  # type: ignore[arg-type]

    def sources(self, target: str) -> list[str]:
        """Return the names of the nodes that lead to a node."""
        return sorted(source for source, each in self.edges if each == target)

    def detached(self) -> "TorchNetwork":
        """Return the network with numbers of its own, which no module of the user shares."""
        nodes = {name: node.detached() for name, node in self.nodes.items()}
        return TorchNetwork(nodes, self.edges, self.takes, self.puts)

    def spec(self) -> dict[str, Any]:
        """Return the graph and its shapes without numbers, for JSON; of a detached network."""
        nodes = {name: node.spec() for name, node in self.nodes.items()}
        made = {"nodes": nodes, "edges": self.edges, "takes": self.takes, "puts": self.puts}
        plain: dict[str, Any] = json.loads(json.dumps(made))  # lists, as a checkpoint has them
        return plain

    @classmethod
    def from_spec(
        cls,
        nodes: Mapping[str, Mapping[str, Any]],
        edges: Sequence[Sequence[str]],
        takes: Sequence[int],
        puts: Sequence[int],
    ) -> "TorchNetwork":
        """Return the network of a spec, with numbers to be loaded."""
        made = {name: _from_spec(**spec) for name, spec in nodes.items()}
        return cls(made, [(a, b) for a, b in edges], tuple(takes), tuple(puts))

    def artifact(
        self,
        convention: Convention,
        codec: Codec | None = None,
        provenance: Provenance | None = None,
    ) -> Artifact:
        """Return the present numbers as an artifact, in float64."""
        return Artifact(self.graph(convention.dt), codec, convention, provenance)

    def graph(self, dt: float) -> nir.NIRGraph:
        """Return the present numbers as a graph, in float64, for timesteps of dt seconds."""
        nodes: dict[str, nir.NIRNode] = {
            self.INPUT: nir.Input({"input": np.array(self.takes)}),
            self.OUTPUT: nir.Output({"output": np.array(self.puts)}),
        }
        nodes |= {name: node.node(dt) for name, node in self.nodes.items()}
        return nir.NIRGraph(nodes, list(self.edges), type_check=False)


def _from_spec(
    kind: str,
    takes: Sequence[int] = (),
    trained: Collection[str] = (),
    layer: Mapping[str, Any] | None = None,
    shapes: Mapping[str, Sequence[int]] | None = None,
    fields: Mapping[str, Any] | None = None,
    steps: Any = None,  # noqa: ANN401
) -> Node:
    shape = tuple(takes)
    if layer is not None:
        made = _layer(**layer)
        for name, parameter in made.named_parameters():
            parameter.requires_grad_(name in trained)
        return Weights(made, shape)
    if shapes is not None:
        ones = {name: torch.ones(tuple(each)) for name, each in shapes.items()}
        return FreeNeurons(shape, ones, trained)
    if fields is None:
        return Delay(np.array(steps, np.int64))
    arrays = {name: np.asarray(value) for name, value in fields.items()}
    if kind == "Flatten":
        return Fixed(nir.Flatten({"input": np.array(takes)}, **fields), shape)
    return Fixed(getattr(nir, kind)(**arrays), shape)


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
        name: _read(name, node, artifact)
        for name, node in graph.nodes.items()
        if name not in renamed
    }
    edges = [(renamed.get(a, a), renamed.get(b, b)) for a, b in graph.edges]
    return TorchNetwork(nodes, edges, shape_of(graph.inputs[source]), shape_of(graph.outputs[end]))


def _read(name: str, node: nir.NIRNode, artifact: Artifact) -> Node:
    """Return a node of a file, all of whose numbers are trained."""
    takes = tuple(int(n) for n in node.input_type["input"])
    if isinstance(node, NEURONS) and name not in artifact.sigma_delta:
        made = artifact.neurons[name]
        if made.v_reset.any():
            raise ArtifactError(
                f"node {name!r}: v_reset goes to {made.v_reset.max():g}; on a chip a spike resets "
                "the membrane to 0. Shift it."
            )
        held = {each: getattr(made, each) for each in Equation._fields}
        held["leak"] = made.leak if made.leak.any() else None
        numbers = {each: _tensor(value) for each, value in held.items() if value is not None}
        return FreeNeurons(made.gain.shape, numbers, Equation._fields)
    if isinstance(node, nir.Linear | nir.Affine) and node.weight.ndim == 2:
        outputs, inputs = node.weight.shape
        linear = nn.Linear(inputs, outputs, bias=isinstance(node, nir.Affine))
        return Weights(_filled(linear, node), takes)
    if isinstance(node, nir.Conv1d | nir.Conv2d):
        return Weights(_filled(_convolution(name, node), node), takes)
    if type(node).__name__ in _FIXED:
        return Fixed(node, takes)
    if isinstance(node, nir.Delay):
        steps = np.rint(node.delay.astype(np.float64) / artifact.convention.dt)
        return Delay(steps.astype(np.int64))
    kind = "a sigma-delta neuron" if name in artifact.sigma_delta else type(node).__name__
    raise ArtifactError(
        f"node {name!r}: {kind} cannot be trained here; possible are Linear, "
        "Affine, Conv1d, Conv2d, SumPool2d, AvgPool2d, Flatten, Scale, Delay and neurons."
    )


def _convolution(name: str, node: nir.NIRNode) -> nn.Module:
    window = window_of(name, node)
    outputs, inputs = node.weight.shape[0], node.weight.shape[1] * int(node.groups)
    symmetric = all(before == after for before, after in window.padding)
    return _layer(  # type: ignore[no-any-return]
        type(node).__name__,
        in_channels=inputs,
        out_channels=outputs,
        kernel_size=window.kernel,
        stride=window.stride,
        padding=tuple(before for before, _ in window.padding) if symmetric else "same",
        dilation=window.dilation,
        groups=int(node.groups),
    )


def _filled(layer: Any, node: nir.NIRNode) -> Any:  # noqa: ANN401
    with torch.no_grad():
        layer.weight.copy_(_tensor(node.weight))
        if layer.bias is not None:
            layer.bias.copy_(_tensor(node.bias))
    return layer
