"""Networks of NIR nodes whose numbers are torch parameters.

A `TorchNetwork` is a graph of two kinds of nodes: maps without a memory, which torch computes
(`Map`), and neurons (`Neurons`), which a chip computes. `artifact` writes the present numbers as
NIR; `network_of` makes a network of an artifact. What a torch module becomes is in `from_torch`.
`detached` makes a network whose numbers are its own, and `spec` what checkpoints say of its graph.

Neurons are the difference equation of `runtime.graph.neurons`, with gains that stay as they are:

    I[t] = a I[t-1] + gain x[t]        V[t] = b V[t-1] + I[t] + leak
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import nir
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import NEURONS, DiscreteNeuron
from spikedeploy.runtime.graph.shapes import Shape, shape_of, window_of
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import require_known
from spikedeploy.trainers.fitting import Fitting, signs_by_majority, typed_values
from spikedeploy.trainers.neurons import Surrogate

Edge: TypeAlias = tuple[str, str]
Array: TypeAlias = NDArray[np.float64]

# of a neuron that never forgets beside ones that do, in a node with a time constant for each:
# 1 - b is this, far below what any chip's decay factor resolves
_SLOWEST = 1e-12
_SAME = 1e-6  # of the sum of weights, by which they may differ after they were fitted


def to_array(tensor: Tensor) -> NDArray[np.float64]:
    """Return a tensor in float64."""
    array: NDArray[np.float64] = tensor.detach().cpu().numpy().astype(np.float64)
    return array


class Map(nn.Module):
    """A node without a memory: (R, *takes) to (R, *puts), R rows of batch and time.

    takes, puts: shapes without the axis of rows
    """

    takes: Shape
    puts: Shape

    def node(self) -> nir.NIRNode:
        """Return the NIR node of the present numbers."""
        raise NotImplementedError

    def detached(self) -> "Map":
        """Return the node with numbers of its own, equal to the present ones."""
        return self

    def spec(self) -> dict[str, Any]:
        """Return what makes an equal node with numbers to be loaded, for JSON."""
        raise NotImplementedError


class Weights(Map):
    """A matrix or convolution of a torch layer, with the normalisation behind it folded in.

    layer: nn.Linear, nn.Conv1d or nn.Conv2d
    norm: nn.BatchNorm behind it, at its running statistics, or None
    fitting: what makes the weights fit the axons of a chip, or None
    """

    def __init__(
        self,
        layer: nn.Linear | nn.Conv1d | nn.Conv2d,
        takes: Shape,
        norm: nn.BatchNorm1d | nn.BatchNorm2d | None = None,
        fitting: Fitting | None = None,
    ) -> None:
        super().__init__()
        self.layer, self.norm, self.takes = layer, norm, takes
        self.fitting = fitting
        with torch.no_grad():
            self.puts = tuple(self(layer.weight.new_zeros(1, *takes)).shape[1:])

    def numbers(self) -> tuple[Tensor, Tensor | None]:
        """Return weight and bias as they are deployed, before rounding."""
        weight, bias = self._folded()
        return weight if self.fitting is None else self.fitting(weight), bias

    def settle(self) -> None:
        """Bring weights that an update moved away from what fits back to it."""
        if self.fitting is not None and self.norm is None:
            self.fitting.settle(self.layer.weight)

    def _folded(self) -> tuple[Tensor, Tensor | None]:
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

    def detached(self) -> "Weights":
        """Return the same weights in a layer of their own, without a normalisation."""
        weight, bias = self._folded()
        layer = _layer(type(self.layer).__name__, **_settings(self.layer, bias is not None))
        for own, number in ((layer.weight, weight), (layer.bias, bias)):
            if own is not None and number is not None:
                own.data = number.detach().clone()
                own.requires_grad_(number.requires_grad)
        return Weights(layer, self.takes, fitting=self.fitting)

    def spec(self) -> dict[str, Any]:
        """Return kind, settings, shape and what is trained."""
        layer = self.layer
        return {
            "kind": type(layer).__name__,
            "takes": list(self.takes),
            "settings": _settings(layer, layer.bias is not None),
            "trained": [name for name, p in layer.named_parameters() if p.requires_grad],
            "fitting": None if self.fitting is None else self.fitting.spec(),
        }

    @classmethod
    def from_spec(
        cls,
        kind: str,
        takes: Sequence[int],
        settings: Mapping[str, Any],
        trained: Collection[str],
        fitting: Mapping[str, Any] | None,
    ) -> "Weights":
        """Return weights of this shape, with numbers to be loaded."""
        layer = _layer(kind, **settings)
        for name, parameter in layer.named_parameters():
            parameter.requires_grad_(name in trained)
        fits = None if fitting is None else Fitting.from_spec(**fitting)
        return cls(layer, tuple(takes), fitting=fits)


_LAYERS: dict[str, Any] = {"Linear": nn.Linear, "Conv1d": nn.Conv1d, "Conv2d": nn.Conv2d}


def _layer(kind: str, **settings: Any) -> Any:  # noqa: ANN401
    return _LAYERS[kind](**settings)


def _settings(layer: nn.Module, bias: bool) -> dict[str, Any]:
    """Return the arguments that make an equal layer, for JSON."""
    names = ["in_features", "out_features"]
    if not isinstance(layer, nn.Linear):
        names = [
            "in_channels", "out_channels", "kernel_size", "stride", "padding", "dilation", "groups",
        ]  # fmt: skip
    found = {name: getattr(layer, name) for name in names}
    return {
        **{name: list(n) if isinstance(n, tuple) else n for name, n in found.items()},
        "bias": bias,
    }


class Fixed(Map):
    """A node without parameters of torch: a pool, Flatten, Scale.

    made: the NIR node
    """

    def __init__(self, made: nir.NIRNode, takes: Shape) -> None:
        super().__init__()
        self.made, self.takes = made, takes
        self._function = _function_of(made)
        with torch.no_grad():
            self.puts = tuple(self(torch.zeros(1, *takes)).shape[1:])

    def forward(self, x: Tensor) -> Tensor:
        """Return (R, *puts)."""
        return self._function(x)

    def node(self) -> nir.NIRNode:
        """Return the node."""
        return self.made

    def spec(self) -> dict[str, Any]:
        """Return kind, shape and fields of the node."""
        held = {each.name for each in fields(self.made)} - {"input_type", "output_type", "metadata"}
        found = {name: np.asarray(getattr(self.made, name)).tolist() for name in sorted(held)}
        return {"kind": type(self.made).__name__, "takes": list(self.takes), "fields": found}

    @classmethod
    def from_spec(cls, kind: str, takes: Sequence[int], fields: Mapping[str, Any]) -> "Fixed":
        """Return the node of these fields."""
        if kind == "Flatten":
            made = nir.Flatten({"input": np.array(takes)}, **fields)
        else:
            arrays = {name: np.asarray(value) for name, value in fields.items()}
            made = getattr(nir, require_known(kind, _FIXED, "kind of node"))(**arrays)
        return cls(made, tuple(takes))


_FIXED = ("Flatten", "AvgPool2d", "SumPool2d", "Scale")


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


class Delay(nn.Module):
    """Spikes that arrive some timesteps later.

    steps: (*takes) [timesteps]
    """

    def __init__(self, steps: NDArray[np.int64]) -> None:
        super().__init__()
        self.steps, self.takes = steps, steps.shape
        self.puts = self.takes

    def detached(self) -> "Delay":
        """Return the delay, which has no numbers that are trained."""
        return self

    def spec(self) -> dict[str, Any]:
        """Return kind, shape and timesteps."""
        return {"kind": "Delay", "takes": list(self.takes), "steps": self.steps.tolist()}

    @classmethod
    def from_spec(cls, takes: Sequence[int], steps: Any) -> "Delay":  # noqa: ANN401
        """Return the delay of these timesteps."""
        return cls(np.array(steps, np.int64).reshape(tuple(takes)))

    def forward(self, rows: Tensor) -> Tensor:
        """Return (T, B, *takes) of all timesteps, late."""
        return torch.stack([self.arriving(rows[: t + 1].unbind()) for t in range(len(rows))])

    def arriving(self, rows: Sequence[Tensor]) -> Tensor:
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
    derivative: derivative of a spike, a function of the membrane minus the threshold; None if it
        has none
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

    def detached(self) -> "FreeNeurons":
        """Return neurons with numbers of their own, of which those are trained that are here."""
        found = zip(_NUMBERS, self.numbers(), strict=True)
        given = {name: number for name, number in found if number is not None}
        trained = [name for name, number in given.items() if number.requires_grad]
        numbers = {name: number.detach().clone() for name, number in given.items()}
        return FreeNeurons(self.takes, numbers, trained)


_NUMBERS = ("current_decay", "membrane_decay", "threshold", "leak", "gain")  # as in Equation


class FreeNeurons(Neurons):
    """Neurons whose numbers are tensors of their own.

    numbers: by the names of Equation's fields, broadcasting to the shape of the layer
    trained: names of those that are parameters; the gain is none
    """

    current_decay: Tensor | None
    membrane_decay: Tensor
    threshold: Tensor | None
    leak: Tensor | None
    gain: Tensor

    def __init__(
        self, shape: Shape, numbers: Mapping[str, Tensor], trained: Collection[str]
    ) -> None:
        super().__init__(shape)
        for name in _NUMBERS:
            value = numbers.get(name)
            own = None if value is None else value.clone()  # layers of a checkpoint share none
            if own is not None and name in trained and name != "gain":
                self.register_parameter(name, nn.Parameter(own))
            else:
                self.register_buffer(name, own)

    @classmethod
    def from_file(cls, made: DiscreteNeuron) -> "FreeNeurons":
        """Return neurons of a file, all of whose numbers are trained."""
        leak = made.leak if made.leak.any() else None
        found = {name: getattr(made, name) for name in _NUMBERS} | {"leak": leak}
        numbers = {name: _tensor(value) for name, value in found.items() if value is not None}
        return cls(made.gain.shape, numbers, _NUMBERS)

    def numbers(self) -> tuple[Tensor | None, Tensor, Tensor | None, Tensor | None, Tensor]:
        """Return the tensors, decay factors from 0 to 1."""
        current = self.current_decay
        bounded = None if current is None else current.clamp(0, 1)
        return bounded, self.membrane_decay.clamp(0, 1), self.threshold, self.leak, self.gain

    def spec(self) -> dict[str, Any]:
        """Return the shapes of all numbers, and which are trained."""
        held = {name: getattr(self, name) for name in _NUMBERS}
        shapes = {name: list(value.shape) for name, value in held.items() if value is not None}
        trained = [name for name, _ in self.named_parameters()]
        return {"kind": "neurons", "takes": list(self.takes), "shapes": shapes, "trained": trained}

    @classmethod
    def from_spec(
        cls, takes: Sequence[int], shapes: Mapping[str, Sequence[int]], trained: Collection[str]
    ) -> "FreeNeurons":
        """Return neurons of these shapes, with numbers to be loaded."""
        ones = {name: torch.ones(tuple(shape)) for name, shape in shapes.items()}
        return cls(tuple(takes), ones, trained)


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

    @property
    def spiking(self) -> int:
        """Number of layers that spike."""
        layers = (node for node in self.nodes.values() if isinstance(node, Neurons))
        return sum(node.numbers()[2] is not None for node in layers)

    def detached(self) -> "TorchNetwork":
        """Return the network with numbers of its own, which no module of the user shares."""
        nodes = {name: node.detached() for name, node in self.nodes.items()}
        return TorchNetwork(nodes, self.edges, self.takes, self.puts)

    def spec(self) -> dict[str, Any]:
        """Return the graph and its shapes without numbers, for JSON; of a detached network."""
        return {
            "nodes": {name: node.spec() for name, node in self.nodes.items()},  # type: ignore[operator]
            "edges": [list(edge) for edge in self.edges],
            "takes": list(self.takes),
            "puts": list(self.puts),
        }

    @classmethod
    def from_spec(
        cls,
        nodes: Mapping[str, Mapping[str, Any]],
        edges: Sequence[Sequence[str]],
        takes: Sequence[int],
        puts: Sequence[int],
    ) -> "TorchNetwork":
        """Return the network of a spec, with numbers to be loaded."""
        made = {name: _from_spec(spec) for name, spec in nodes.items()}
        pairs = [(source, target) for source, target in edges]
        network = cls(made, pairs, tuple(takes), tuple(puts))
        for first, *others in network.sharing_targets():
            for each in others:
                if each.fitting is not None and first.fitting is not None:
                    each.fitting.values = first.fitting.values  # one crossbar
        return network

    def fit(self, target: Chip) -> str:
        """Make weights fit the axons of a chip; return what that changes, empty where nothing.

        Sources get the sign of most of their weights; axons are of types by turns. Where layers of
        several shapes read a source, or a convolution would need types, nothing is done, and the
        design rule of the chip says so.
        """
        limits, arithmetic, fitted = target.limits, target.arithmetic, list[Weights]()
        for heard in self.sharing_sources() if limits and limits.axon_signs else ():
            weights = [each.layer.weight.detach() for each in heard]
            shapes = {(w.ndim, w.shape[1]) for w in weights}
            # of groups, a weight does not say its source
            if len(shapes) == 1 and all(getattr(w.layer, "groups", 1) == 1 for w in heard):
                signs = signs_by_majority(weights)
                for each in heard:
                    each.fitting = Fitting(signs=signs.clone())
                fitted += heard
        types = 0 if arithmetic.own_weights else int(getattr(arithmetic, "axon_types", 0))
        for together in self.sharing_targets() if types else ():
            if all(each.layer.weight.ndim == 2 for each in together):
                weights = [each.layer.weight.detach() for each in together]
                values = nn.Parameter(typed_values(weights, types))
                for each in together:
                    each.fitting = Fitting(values=values)
                fitted += together
        return _changed_by(fitted, target.name, types)

    def sharing_sources(self) -> list[list[Weights]]:
        """Return the weights in groups that read the same neurons, or the input."""
        groups: list[tuple[set[str], list[Weights]]] = []
        for name, node in self.nodes.items():
            if isinstance(node, Weights):
                heard, together = self._origins(name), [node]
                for group in [each for each in groups if each[0] & heard]:
                    groups.remove(group)
                    heard, together = heard | group[0], [*group[1], *together]
                groups.append((heard, together))
        return [together for _, together in groups]

    def sharing_targets(self) -> list[list[Weights]]:
        """Return the weights in groups that lead to the same neurons."""
        nodes, groups = self.nodes, dict[str, list[Weights]]()
        for source, target in self.edges:
            node = nodes.get(source)
            if isinstance(node, Weights) and isinstance(nodes.get(target), Neurons):
                groups.setdefault(target, []).append(node)
        return list(groups.values())

    def _origins(self, name: str) -> set[str]:
        """Return the neurons, or the input, whose spikes reach a node without other weights."""
        found: set[str] = set()
        for source in (source for source, target in self.edges if target == name):
            node = self.nodes.get(source)
            is_between = isinstance(node, Fixed | Delay)
            found |= self._origins(source) if is_between else {source}
        return found

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
        for name, node in self.nodes.items():
            if isinstance(node, Neurons):
                nodes[name] = node.node(dt)
            elif isinstance(node, Delay):
                nodes[name] = nir.Delay(node.steps * dt)
            else:
                nodes[name] = node.node()
        return nir.NIRGraph(nodes, list(self.edges), type_check=False)


@torch.no_grad()
def _changed_by(fitted: Sequence[Weights], chip_name: str, types: int) -> str:
    """Return a sentence on what the axons of a chip make of weights; empty if they stay."""
    moved, whole = 0.0, 0.0
    for each in fitted:
        weight, deployed = each.layer.weight, each.numbers()[0]
        moved += float((deployed - weight).abs().sum()) if each.norm is None else 0.0
        whole += float(weight.abs().sum())
    if moved <= _SAME * whole:
        return ""
    axons = f"{types} weights for each neuron" if types else "one sign for each source"
    return (
        f"{chip_name} has {axons}: {100 * moved / whole:.0f} % of the weights, by magnitude, "
        "change for it, and the network computes something else until it is trained"
    )


def _from_spec(spec: Mapping[str, Any]) -> Map | Neurons | Delay:
    settings = dict(spec)
    kind = settings.pop("kind")
    if kind == "neurons":
        return FreeNeurons.from_spec(**settings)
    if kind == "Delay":
        return Delay.from_spec(**settings)
    return (Weights if kind in _LAYERS else Fixed).from_spec(kind, **settings)


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
        return FreeNeurons.from_file(made)
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


def _tensor(values: NDArray[Any]) -> Tensor:
    return torch.from_numpy(np.array(values, np.float32))
