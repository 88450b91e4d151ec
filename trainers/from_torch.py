"""Torch modules as networks of maps and neurons, which compute one timestep.

`network_from_torch` runs the module on an example and records which leaf modules and torch
functions made each tensor from which. So it takes `nn.Sequential`, a `forward` that computes one
timestep with states inside or passed in and out, one that loops over timesteps, and layers that
take all timesteps at once. The parameters of the network are those of the module. `torch_neurons`
says what neurons of other libraries mean.
"""

import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from operator import index
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_layers import leaves, node_of
from spikedeploy.trainers.torch_network import (
    Delay,
    Edge,
    Map,
    Neurons,
    TorchNetwork,
    Weights,
    flatten,
)
from spikedeploy.trainers.torch_neurons import KNOWN
from spikedeploy.trainers.torch_neurons.adapter import Meaning, TorchNeurons

_NORMS = (nn.BatchNorm1d, nn.BatchNorm2d)
_NOTHING = (nn.Dropout, nn.Dropout1d, nn.Dropout2d, nn.Identity)  # in deployment
# SpikingJelly's, which are not torch's
_NOTHING_NAMED = ("spikingjelly.activation_based.layer.dropout",)
_BATCH = 2
# first axes of the example for a forward that takes all timesteps: more where it counts them
# itself, in either order
_ALL_TIMESTEPS = ((3, _BATCH), (30, _BATCH), (_BATCH, 30), (300, _BATCH), (_BATCH, 300))


@dataclass(frozen=True)
class _Value:
    """The origin of a tensor: the sum of the outputs of nodes in some of their calls.

    terms: (node, call) of each, call counted from 0
    membrane_of: node of neurons whose membrane it is, which no map can read; empty for spikes
    """

    terms: tuple[tuple[str, int], ...] = ()
    membrane_of: str = ""


class _TimeAxisError(Exception):
    """The module indexes an axis of its input, or a layer takes one more: that of timesteps."""


def network_from_torch(module: nn.Module, takes: Shape) -> tuple[TorchNetwork, list[TorchNeurons]]:
    """Return the network of a module, and its neurons, which say their convention.

    takes: shape of the input without batch and time

    Raises ConfigError with the name of the module, where something has no place on a chip.
    """
    if not isinstance(module, nn.Module):
        raise ConfigError(
            f"a network is a torch.nn.Module, or a .nir file; found {_described(module)}"
        )
    with _unchanged(module), torch.no_grad():
        tracer, puts = _traced(module, takes)
    return tracer.network(takes, puts)


def _traced(module: nn.Module, takes: Shape) -> "tuple[_Tracer, _Value]":
    """Run the module on one timestep, and where that fails on several; return as `_run` does."""
    failed: Exception | None = None
    for axes in (None, *_ALL_TIMESTEPS):
        found = _attempt(module, takes, axes)
        if not isinstance(found, Exception):
            return found
        if isinstance(found, _TimeAxisError):
            failed = None
            continue
        if failed is None or isinstance(failed, IndexError):  # which another example may mend
            failed = found
        if axes is not None and not isinstance(found, IndexError):
            break
    if isinstance(failed, ConfigError):
        raise failed
    raise ConfigError(
        f"{_name_of(module)}: its forward failed on zeros of a batch of {_BATCH} and shape "
        f"{takes}: {type(failed).__name__}: {failed}. Give the shape of one timestep of one sample "
        "as input_shape."
    ) from failed


def _attempt(
    module: nn.Module, takes: Shape, axes: Shape | None
) -> "tuple[_Tracer, _Value] | Exception":
    try:
        return _run(module, takes, axes)
    except Exception as error:  # of a forward that was given another shape than it takes
        return error


def artifact_from_torch(
    module: nn.Module, takes: Sequence[int] | None, dt: float = 1e-3
) -> Artifact:
    """Return a module as an artifact, as its own library computes it.

    takes: shape of a timestep of one sample
    dt: [s] of a timestep
    """
    network, neurons = network_from_torch(module, given_shape(takes))
    meaning = common_meaning(neurons)
    reset = meaning.reset if meaning.reset != "none" else "zero"
    stated = Convention(
        dt, reset, spikes=meaning.spikes, floor=meaning.floor, source=meaning.described
    )
    return network.artifact(stated)


def given_shape(takes: Sequence[int] | int | None) -> Shape:
    """Return the shape of an input, a number for one axis; ConfigError where there is none."""
    if takes is None:
        raise ConfigError(
            "a torch module does not say the shape of its input: give input_shape, of a timestep "
            "of one sample, as in input_shape=(64,)"
        )
    try:
        return (index(takes),) if isinstance(takes, int) else tuple(index(n) for n in takes)
    except TypeError:
        raise ConfigError(
            f"input_shape is {takes!r}; it is a tuple of whole numbers, as in input_shape=(64,)"
        ) from None


def common_meaning(neurons: Sequence[TorchNeurons]) -> Meaning:
    """Return what all spiking neurons mean; ConfigError where layers reset in several ways."""
    found = {(m.reset, m.spikes, m.floor): m for m in (each.meaning for each in neurons)}
    spiking = {how: meaning for how, meaning in found.items() if how[0] != "none"}
    if len(spiking) > 1:
        raise ConfigError(
            "the neurons spike or reset in several ways, and a network on a chip in one: "
            f"{'; '.join(m.described for m in spiking.values())}. Choose one for all layers."
        )
    if not spiking:  # by any convention
        return next(iter(found.values()))
    (meaning,) = spiking.values()
    return meaning


@contextmanager
def _unchanged(module: nn.Module) -> Iterator[None]:
    """Evaluate the module, and put back its buffers, states and mode afterwards."""
    training = {each: each.training for each in module.modules()}
    kept = {each: dict(each._buffers) for each in module.modules()}
    states = {each: dict(vars(each)) for each in module.modules()}
    for held in states.values():  # what is changed in place: recordings, states of SpikingJelly
        held.update({name: list(each) for name, each in held.items() if type(each) is list})
        if "_memories" in held:
            held["_memories"] = dict(held["_memories"])
    drawn = torch.get_rng_state()
    module.eval()
    try:
        yield
    finally:
        for each in module.modules():
            vars(each).update(states[each])
            each._buffers.update(kept[each])
            each.training = training[each]
        torch.set_rng_state(drawn)


def _run(module: nn.Module, takes: Shape, axes: Shape | None) -> "tuple[_Tracer, _Value]":
    """Run the module on zeros; return what was recorded, and its output.

    axes: timesteps and batch of the example, in either order, where the module takes all; None for
        one timestep, in which the module runs twice, so that states inside it show what they were
        made of
    """
    tracer = _Tracer(module, takes, axes is not None)
    handles = tracer.watch()
    try:
        with tracer:
            if axes is not None:
                return tracer, tracer.output(module(tracer.example((*axes, *takes))))
            rows = _BATCH * _rows(module)
            found = module(tracer.example((rows, *takes)), *tracer.others(module, None))
            if tracer.is_single():
                others = tracer.others(module, found)
                found = module(tracer.example((rows, *takes)), *others)
            return tracer, tracer.output(found)
    finally:
        for handle in handles:
            handle.remove()


def _rows(module: nn.Module) -> int:
    """Return by what number of rows a batch must be divisible, for layers that split it in time."""
    sizes = [
        (getattr(each, "batch_size", 1), getattr(each, "num_timesteps", 1))
        for each in module.modules()
        if type(each).__name__.endswith("Squeeze")
    ]
    return math.lcm(1, *(abs(batch * timesteps) for batch, timesteps in sizes))


class _Tracer(TorchFunctionMode):
    """Records which nodes each tensor comes from, while a module runs."""

    def __init__(self, root: nn.Module, takes: Shape, loops: bool) -> None:
        super().__init__()
        self._root, self._given, self._loops = root, takes, loops
        # by identity; the tensors are kept, so that none takes the place of another
        self._values: dict[int, tuple[Tensor, _Value]] = {}
        self.nodes: dict[str, Map | Neurons] = {}
        self.arrived: dict[str, list[_Value]] = {}
        self._inputs: list[Tensor] = []
        self._inside = 0
        self._unknown: dict[int, tuple[Tensor, str]] = {}

    # what a run gives

    def example(self, shape: Shape) -> Tensor:
        """Return an input of zeros, which is known as such."""
        kinds = [p.dtype for p in self._root.parameters() if p.is_floating_point()]
        x = torch.zeros(shape, dtype=kinds[0] if kinds else None)
        self._inputs.append(x)
        self._know(x, _Value(((TorchNetwork.INPUT, len(self._inputs) - 1),)))
        return x

    def others(self, module: nn.Module, outputs: object) -> list[Any]:
        """Return the arguments besides the input: the states that the call before returned.

        None for each in the first call, and where the module returns another number of values.
        """
        if isinstance(module, nn.Sequential):
            return []
        kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
        parameters = list(inspect.signature(module.forward).parameters.values())[1:]
        wanted = [p for p in parameters if p.kind in kinds]
        states = list(outputs)[1:] if isinstance(outputs, tuple) else []
        if states and len(states) == len(wanted):
            return states
        return [None for p in wanted if p.default is inspect.Parameter.empty]

    def is_single(self) -> bool:
        """Return True if all neurons were called once."""
        return all(len(calls) == 1 for n, calls in self.arrived.items() if self._is_neurons(n))

    def output(self, found: object) -> _Value:
        """Return where the first output comes from; of a list or stack, the last timestep's."""
        for each in _tensors(found):
            value = self._value(each)
            if value is not None and (value.terms or value.membrane_of):
                return value
        raise ConfigError(
            f"{_name_of(self._root)}: its output does not come from its layers alone, or is not a "
            "tensor. Return the spikes of the last layer, or a list or stack of them; sum and "
            "softmax belong to the loss."
        )

    # while it runs

    def watch(self) -> list[Any]:
        """Hook the leaf modules; return the handles."""
        handles = []
        taken = {TorchNetwork.INPUT, TorchNetwork.OUTPUT}  # of the graph's ends
        for name, module in leaves(self._root):
            name = name or type(module).__name__.lower()
            while name in taken:
                name += "_"
            taken.add(name)
            handles += [
                module.register_forward_pre_hook(self._enter),
                module.register_forward_hook(self._leave(name, module)),
            ]
        return handles

    def _enter(self, module: nn.Module, arguments: tuple[Any, ...]) -> Any:  # noqa: ANN401
        self._inside += 1
        first = arguments[0] if arguments else None
        # neurons of snnTorch return states beside their spikes, which nn.Sequential passes on
        return (first[0], *arguments[1:]) if isinstance(first, tuple) else None

    def _leave(self, name: str, module: nn.Module) -> Callable[[Any, Any, Any], None]:
        def leave(_: nn.Module, arguments: tuple[Any, ...], result: object) -> None:
            if self._inside == 1:
                arriving = self._arriving(name, module, arguments[0])
                found = _tensors(result)
                values = [arriving]
                if not self._is_nothing(module, arguments[0], found[0]):
                    takes = self._takes(name, arguments[0], arriving)
                    node = self._call(name, module, takes, arriving)
                    self._check_axes(name, arguments[0], takes)
                    membrane = _Value(membrane_of=node)
                    self._know_all(result, [membrane] * len(found))
                    # the output last, which states may hold again
                    has_spikes = getattr(self.nodes[node], "has_spikes", True)
                    spikes = _Value(((node, len(self.arrived[node]) - 1),))
                    values = [spikes if has_spikes else membrane]
                self._know_all(result, values)
            self._inside -= 1

        return leave

    def __torch_function__(
        self,
        function: Callable[..., Any],
        types: Any,  # noqa: ANN401
        arguments: Sequence[Any] = (),
        options: Mapping[str, Any] | None = None,
    ) -> Any:  # noqa: ANN401
        """Call the function; note where its result comes from."""
        result = function(*arguments, **(options or {}))
        if not self._inside:
            name = getattr(function, "__name__", str(function))
            if name == "__setitem__":  # it changes a tensor and returns none
                self._written(arguments[0], arguments[2])
            elif _tensors(result):
                self._note(name, arguments, options or {}, result)
        return result

    def _written(self, target: Tensor, source: object) -> None:
        """Note that a tensor was written to: it may collect timesteps, as `stack` does."""
        value = self._value(source) if isinstance(source, Tensor) else None
        before = self._value(target)
        if value is None and before is None:
            return
        collects = isinstance(source, Tensor) and target.shape[1:] == source.shape
        if (
            value is not None
            and collects
            and id(target) not in self._unknown
            and (before is None or _nodes(before) == _nodes(value))
        ):
            self._know(target, value)
        else:
            self._forget(target, "__setitem__")

    def _note(
        self, function: str, arguments: Sequence[Any], options: Mapping[str, Any], result: object
    ) -> None:
        for each in _tensors(arguments):
            if id(each) in self._unknown:
                return self._forget(result, self._unknown[id(each)][1])
        known = [self._value(each) for each in _tensors(arguments)]
        terms = [each for each in known if each is not None]
        if not terms:
            return None
        first = arguments[0]
        arranges = function in _ARRANGING and self._is_arranged(first, result)
        if (function in _SAME or arranges) and len(terms) == 1:
            self._know_all(result, terms)
        elif function in _INDEXING and any(first is x for x in self._inputs):
            if not self._loops:
                raise _TimeAxisError
            self._at_timesteps(function, arguments, result)
        elif function in _ADDING and len(terms) == len(known) and _adds(arguments, options, terms):
            self._know_all(result, [_Value(tuple(t for each in terms for t in each.terms))])
        elif (
            function in _STACKING
            and len({_nodes(each) for each in known}) == 1
            and self._stacks(_tensors(arguments)[0], result, terms[0])
        ):
            self._know_all(result, [terms[-1]])  # timesteps of one node
        elif function in _RESHAPING and isinstance(first, Tensor) and isinstance(result, Tensor):
            self._know_all(result, [self._reshaped(function, first, result, terms[0])])
        else:
            self._forget(result, function)
        return None

    def _forget(self, result: object, function: str) -> None:
        """Note which function made tensors that no node can make."""
        for each in _tensors(result):
            self._values.pop(id(each), None)
            self._unknown[id(each)] = each, function

    def _at_timesteps(self, function: str, arguments: Sequence[Any], result: object) -> None:
        if function == "__getitem__":
            place = arguments[1]
            if isinstance(place, tuple):  # x[t, :, :], or x[:, t] of an input that has batch first
                numbers = [n for n in place[:2] if isinstance(n, int)]
                rest = [n for n in place if not isinstance(n, int) and n not in (slice(None), ...)]
                place = numbers[0] if len(numbers) == 1 and not rest else place
        else:
            place = arguments[2] if len(arguments) > 2 else 0
        each = [result] if isinstance(result, Tensor) else _tensors(result)
        start = place if isinstance(place, int) and isinstance(result, Tensor) else 0
        if not isinstance(place, int):
            raise ConfigError(
                f"{_name_of(self._root)}: its forward indexes its input by {place!r}; a network on "
                "a chip takes one timestep after another. Index timesteps by whole numbers, or "
                "write a forward of one timestep."
            )
        for t, tensor in enumerate(each, start):
            self._know(tensor, _Value(((TorchNetwork.INPUT, t),)))

    def _reshaped(self, function: str, before: Tensor, after: Tensor, value: _Value) -> _Value:
        takes = self._shape(value, before)
        if self._is_arranged(before, after):
            return value
        flattens = after.shape[-1:] == (math.prod(takes),)
        if not flattens or before.shape[len(before.shape) - len(takes) :] != takes:
            raise ConfigError(
                f"{_name_of(self._root)}: {function} makes {tuple(after.shape)} of "
                f"{tuple(before.shape)}; between layers a network on a chip can only flatten all "
                "axes but the batch. Use nn.Flatten()."
            )
        flat = flatten(takes)
        name = "+".join(name for name, _ in value.terms) + ".flatten"
        return self._pass(name, flat, value)

    def _pass(self, name: str, node: Map | Neurons, arriving: _Value) -> _Value:
        self.nodes.setdefault(name, node)
        self.arrived.setdefault(name, []).append(arriving)
        return _Value(((name, len(self.arrived[name]) - 1),))

    def _call(self, name: str, module: nn.Module, takes: Shape, arriving: _Value) -> str:
        if isinstance(module, _NORMS):
            return self._folded(name, module, arriving)
        if name not in self.nodes:
            self.nodes[name] = node_of(name, module, takes)
        node = self.nodes[name]
        inputs = node.inputs() if isinstance(node, TorchNeurons) else None
        if inputs is not None:
            arriving = self._pass(f"{name}.input", inputs, arriving)
        self.arrived.setdefault(name, []).append(arriving)
        return name

    def _shape(self, value: _Value | None, tensor: Tensor) -> Shape:
        """Return the shape of a value without batch and time."""
        for source in _nodes(value):
            if source == TorchNetwork.INPUT:
                return self._given
            if source:
                return self.nodes[source].puts
        return tuple(tensor.shape[1:])

    def _stacks(self, before: Tensor, after: object, value: _Value) -> bool:
        """Return True if tensors of a node are put one behind the other in batch or time."""
        shape = self._shape(value, before)
        return isinstance(after, Tensor) and (
            after.ndim > before.ndim or after.shape[after.ndim - len(shape) :] == shape
        )

    def _is_arranged(self, before: object, after: object) -> bool:
        """Return True if only batch and time have other axes after a function than before."""
        if not isinstance(before, Tensor) or not isinstance(after, Tensor):
            return False
        n = len(self._shape(self._value(before), before))
        old, new = (
            list(zip(each.shape, each.stride(), strict=True))[max(each.ndim - n, 0) :]
            for each in (before, after)
        )
        # neither reshaped nor moved
        return [each for each in old if each[0] > 1] == [each for each in new if each[0] > 1]

    def _is_nothing(self, module: nn.Module, before: Tensor, after: Tensor) -> bool:
        """Return True for a layer that a network on a chip does without."""
        if isinstance(module, _NOTHING) or type(module).__module__ in _NOTHING_NAMED:
            return True
        arranges = isinstance(module, nn.Flatten | nn.Unflatten)
        arranges |= type(module).__name__ == "UnflattenTime"  # of sinabs
        return arranges and self._is_arranged(before, after)

    def _takes(self, name: str, tensor: Tensor, arriving: _Value) -> Shape:
        """Return the shape of a leaf's input without batch and time."""
        takes = self._shape(arriving, tensor)
        if tensor.shape[len(tensor.shape) - len(takes) :] != takes:
            raise ConfigError(
                f"{name}: its input has shape {tuple(tensor.shape)}, and what arrives has {takes} "
                "in a timestep of a sample. Flatten all axes but batch and time, or none."
            )
        return takes

    def _check_axes(self, name: str, tensor: Tensor, takes: Shape) -> None:
        """Refuse neurons for which an axis of timesteps is one of the batch, or the reverse."""
        node = self.nodes.get(name)
        if not isinstance(node, TorchNeurons):
            return
        axes = tensor.ndim - len(takes)
        if axes < 2 and node.takes_time:
            if not self._loops:
                raise _TimeAxisError
            raise ConfigError(
                f"{name}: {node.meaning.described} takes all timesteps at once, and receives one. "
                "Take its form of one timestep, or call the layer once with all."
            )
        if axes > 1 and not node.takes_time:
            raise ConfigError(
                f"{name}: {node.meaning.described} takes one timestep, and receives an axis more "
                "than the batch. Call it once in each timestep, or take the form that takes all: "
                "SpikingJelly's step_mode='m', Norse's LIF."
            )

    def _folded(self, name: str, norm: nn.Module, arriving: _Value) -> str:
        """Fold a normalisation into the weights before it; return their name."""
        (source, _), *others = arriving.terms or (("", 0),)
        before = self.nodes.get(source)
        if others or not isinstance(before, Weights) or before.norm not in (None, norm):
            raise ConfigError(
                f"{name}: {type(norm).__name__} is folded into the weights before it. Put it "
                "directly behind one Linear or convolution."
            )
        before.norm = norm  # type: ignore[assignment]
        return source

    def _arriving(self, name: str, module: nn.Module, tensor: object) -> _Value:
        """Return where the input of a leaf comes from."""
        if not isinstance(tensor, Tensor):
            raise ConfigError(f"{name}: its input is {type(tensor).__name__} and no tensor.")
        value = self._value(tensor)
        if value is not None and value.membrane_of:
            raise ConfigError(
                f"{name}: it receives the membranes of {value.membrane_of}; between layers of a "
                "chip go spikes alone. Pass on the spikes, the first value that neurons return."
            )
        if value is not None:
            return value
        if not tensor.any() and id(tensor) not in self._unknown:
            return _Value()  # spikes before the first timestep
        function = self._unknown.get(id(tensor), (tensor, "a constant"))[1]
        raise ConfigError(
            f"{name}: it receives what {function} makes, which has no place between layers of a "
            "chip. Possible are sums, flattening, Linear, Conv1d, Conv2d, AvgPool2d, BatchNorm and "
            "neurons."
        )

    def _is_neurons(self, name: str) -> bool:
        return isinstance(self.nodes[name], Neurons)

    def _value(self, tensor: Tensor) -> _Value | None:
        found = self._values.get(id(tensor))
        return None if found is None else found[1]

    def _know(self, tensor: Tensor, value: _Value) -> None:
        self._values[id(tensor)] = tensor, value

    def _know_all(self, result: object, values: Sequence[_Value]) -> None:
        for tensor, value in zip(_tensors(result), values, strict=False):
            self._know(tensor, value)

    # what it comes to

    def _sources(self, target: str) -> set[tuple[str, int]]:
        """Return the sources of a node, and by how many timesteps each is late, 0 or 1.

        Raises ConfigError where the node is not called once a timestep, or from elsewhere in some.
        """
        timesteps = max(len(c) for name, c in self.arrived.items() if self._is_neurons(name))
        calls = self.arrived[target]
        # of a static input once, in front of the loop
        if len(calls) not in (1 if not self._is_neurons(target) else timesteps, timesteps):
            raise ConfigError(
                f"{target}: it is called {len(calls)} times in {timesteps} timesteps; on a chip a "
                "layer works once in each. Make a layer of its own for each place."
            )
        found = [
            {(s, 0 if self._is_static(s) else at - call) for s, call in value.terms}
            for at, value in enumerate(calls)
        ]
        wanted = found[-1]
        prompt = {(source, lag) for source, lag in wanted if not lag}
        if any(each != wanted for each in found[1:]) or found[0] != (
            prompt if len(found) > 1 else wanted
        ):
            raise ConfigError(
                f"{target}: its inputs are not the same in every timestep. Write a forward of one "
                "timestep, or one loop."
            )
        if any(lag not in (0, 1) for _, lag in wanted):
            raise ConfigError(f"{target}: it receives what is several timesteps old.")
        return wanted

    def _is_static(self, source: str) -> bool:
        """Return True for the input, and for what was called once in front of a loop."""
        return source == TorchNetwork.INPUT or len(self.arrived[source]) == 1

    def network(self, takes: Shape, output: _Value) -> tuple[TorchNetwork, list[TorchNeurons]]:
        """Return the network whose last recorded timestep this is."""
        if not any(isinstance(node, Neurons) for node in self.nodes.values()):
            raise ConfigError(
                f"{_name_of(self._root)}: it has no neurons that are known. Known are {KNOWN}."
            )
        nodes: dict[str, Map | Neurons | Delay] = dict(self.nodes)
        edges: set[Edge] = set()
        late: set[Edge] = set()
        for target in self.arrived:
            for source, lag in self._sources(target):
                edges.add((source, target))
                if lag:
                    late.add((source, target))
        if output.membrane_of:
            last = nodes[output.membrane_of]
            assert isinstance(last, TorchNeurons)
            last.read_membrane()
            ends = [output.membrane_of]
        else:
            ends = [source for source, _ in output.terms]
        edges |= {(end, TorchNetwork.OUTPUT) for end in ends}
        for name, node in list(nodes.items()):
            if isinstance(node, TorchNeurons) and (recurrent := node.recurrent()) is not None:
                nodes[f"{name}.recurrent"] = recurrent
                edges |= {(name, f"{name}.recurrent"), (f"{name}.recurrent", name)}
        for source, target in sorted(late):
            if not _leads(target, source, edges):  # in a loop NIR delivers a timestep late anyway
                steps = np.ones(nodes[source].puts, np.int64)
                nodes[f"{source}.delay"] = Delay(steps)
                edges.remove((source, target))
                edges |= {(source, f"{source}.delay"), (f"{source}.delay", target)}
        if TorchNetwork.INPUT in ends:
            raise ConfigError(
                "its input is added to its output; what leaves a chip comes from its layers. Put "
                "neurons, or a layer, between them."
            )
        puts = nodes[ends[0]].puts
        neurons = [node for node in nodes.values() if isinstance(node, TorchNeurons)]
        return TorchNetwork(nodes, sorted(edges), takes, puts), neurons


_SAME = {"detach", "clone", "contiguous", "float", "to", "dropout", "requires_grad_"}
# of batch and time, which come first
_ARRANGING = {"repeat", "expand", "transpose", "permute", "movedim", "swapaxes"}
_INDEXING = {"__getitem__", "unbind", "select", "__iter__"}
_ADDING = {"add", "__add__", "__radd__", "__iadd__", "add_"}
_STACKING = {"stack", "cat"}
_RESHAPING = {"flatten", "view", "reshape", "unflatten", "squeeze", "unsqueeze"}


def _adds(arguments: Sequence[Any], options: Mapping[str, Any], values: Sequence[_Value]) -> bool:
    """Return True if a sum adds tensors of several nodes, or 0 as Python's `sum` does."""
    constants = [each for each in arguments if not isinstance(each, Tensor)]
    nodes = [term for each in values for term in each.terms]
    # an edge of NIR counts once
    return not options and all(each == 0 for each in constants) and len({*nodes}) == len(nodes)


def _nodes(value: _Value | None) -> tuple[str, ...]:
    """Return the names of the nodes that a tensor comes from."""
    return () if value is None else (value.membrane_of, *(name for name, _ in value.terms))


def _leads(start: str, end: str, edges: set[Edge]) -> bool:
    """Return True if edges lead from one node to another."""
    seen, waiting = {start}, [start]
    while waiting:
        here = waiting.pop()
        if here == end:
            return True
        new = {target for source, target in edges if source == here} - seen
        seen |= new
        waiting += new
    return False


def _tensors(found: object) -> list[Tensor]:
    """Return the tensors in nested tuples, lists and dicts, in order."""
    if isinstance(found, Tensor):
        return [found]
    if isinstance(found, Mapping):
        found = tuple(found.values())
    if isinstance(found, tuple | list):
        return [tensor for each in found for tensor in _tensors(each)]
    return []


def _described(thing: object) -> str:
    """Return what is no module, and what to do with a class."""
    if isinstance(thing, type):
        return f"the class {thing.__name__}: give an instance, as in {thing.__name__}()"
    return f"a {type(thing).__name__}"


def _name_of(module: nn.Module) -> str:
    return type(module).__name__
