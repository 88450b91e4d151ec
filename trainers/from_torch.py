"""Torch modules as networks of maps and neurons, which compute one timestep.

`network_from_torch` runs the module on an example and records which leaf modules and torch
functions made each tensor from which. So it takes `nn.Sequential`, a `forward` that computes one
timestep with states inside or passed in and out, one that loops over timesteps, and layers that
take all timesteps at once. The parameters of the network are those of the module. `torch_layers`
says which leaf modules have a place on a chip, `torch_neurons` what neurons of libraries mean.
"""

import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from operator import index
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.order import neighbours, reach
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_layers import leaves, node_of
from spikedeploy.trainers.torch_network import (
    Delay,
    Neurons,
    Node,
    TorchNetwork,
    Weights,
    flatten,
)
from spikedeploy.trainers.torch_neurons import KNOWN
from spikedeploy.trainers.torch_neurons.adapter import TorchNeurons

_INPUT, _OUTPUT = TorchNetwork.INPUT, TorchNetwork.OUTPUT
_NORMS = (nn.BatchNorm1d, nn.BatchNorm2d)
_NOTHING = (nn.Dropout, nn.Dropout1d, nn.Dropout2d, nn.Identity)  # in deployment
_BATCH = 2
# first axes of the example: none besides the batch for a forward of one timestep, else timesteps,
# more where the forward counts them itself, in either order
_AXES: tuple[Shape, ...] = (
    (), (3, _BATCH), (30, _BATCH), (_BATCH, 30), (300, _BATCH), (_BATCH, 300),
)  # fmt: skip

# functions of torch by what they do to a tensor
_SAME = {"detach", "clone", "contiguous", "float", "to", "dropout", "requires_grad_"}
# of batch and time, which come first
_ARRANGING = {"repeat", "expand", "transpose", "permute", "movedim", "swapaxes"}
_INDEXING = {"__getitem__", "unbind", "select", "__iter__"}
_ADDING = {"add", "__add__", "__radd__", "__iadd__", "add_"}
_STACKING = {"stack", "cat"}
_RESHAPING = {"flatten", "view", "reshape", "unflatten", "squeeze", "unsqueeze"}


def network_from_torch(module: nn.Module, takes: Shape) -> tuple[TorchNetwork, Convention]:
    """Return the network of a module, and how its neurons spike and reset.

    takes: shape of the input without batch and time

    Raises ConfigError with the name of the module, where something has no place on a chip.
    """
    if not isinstance(module, nn.Module):
        is_class = isinstance(module, type)
        found = f"the class {module.__name__}" if is_class else f"a {type(module).__name__}"
        raise ConfigError(
            f"a network is an instance of torch.nn.Module, or a .nir file; found {found}"
        )
    with _unchanged(module), torch.no_grad():
        tracer, output = _traced(module, takes)
    network = tracer.network(output)
    return network, _common_convention(network)


def artifact_from_torch(
    module: nn.Module, takes: Sequence[int] | None, dt: float = 1e-3
) -> Artifact:
    """Return a module as an artifact, as its own library computes it.

    takes: shape of a timestep of one sample
    dt: [s] of a timestep
    """
    network, convention = network_from_torch(module, given_shape(takes))
    reset = convention.reset if convention.reset != "none" else "zero"
    return network.artifact(replace(convention, dt=dt, reset=reset))


def given_shape(takes: Sequence[int] | int | None) -> Shape:
    """Return the shape of an input, a number for one axis; ConfigError where there is none."""
    try:
        return (index(takes),) if isinstance(takes, int) else tuple(index(n) for n in takes)  # type: ignore[union-attr]
    except TypeError:
        raise ConfigError(
            f"input_shape is {takes!r}, and a torch module does not say the shape of its input: "
            "give whole numbers, of a timestep of one sample, as in input_shape=(64,)"
        ) from None


def _common_convention(network: TorchNetwork) -> Convention:
    """Return the convention of all spiking neurons; ConfigError where layers have several."""
    found = {n.convention: n for n in network.nodes.values() if isinstance(n, TorchNeurons)}
    spiking = [each for each in found if each.reset != "none"]
    if len(spiking) > 1:
        raise ConfigError(
            "the neurons spike or reset in several ways, and a network on a chip in one: "
            f"{'; '.join(each.source for each in spiking)}. Choose one for all layers."
        )
    return (spiking or list(found))[0]


# -- running the module


class _TimeAxisError(Exception):
    """The module indexes an axis of its input, or a layer takes one more: that of timesteps."""


def _traced(module: nn.Module, takes: Shape) -> "tuple[_Tracer, _Value]":
    """Run the module on one timestep, and where that fails on several; return as `_run` does."""
    failed: Exception | None = None
    for axes in _AXES:
        found = _attempt(module, takes, axes)
        if not isinstance(found, Exception):
            return found
        if isinstance(found, _TimeAxisError):
            continue
        if failed is None or isinstance(failed, IndexError):  # which another example may mend
            failed = found
        if axes and not isinstance(found, IndexError):
            break
    if isinstance(failed, ConfigError):
        raise failed
    raise ConfigError(
        f"{type(module).__name__}: its forward failed on zeros of a batch of {_BATCH} and shape "
        f"{takes}: {type(failed).__name__}: {failed}. Give the shape of one timestep of one sample "
        "as input_shape."
    ) from failed


def _attempt(module: nn.Module, takes: Shape, axes: Shape) -> "tuple[_Tracer, _Value] | Exception":
    try:
        return _run(module, takes, axes)
    except Exception as error:  # of a forward that was given another shape than it takes
        return error


@contextmanager
def _unchanged(module: nn.Module) -> Iterator[None]:
    """Evaluate the module, and put back its buffers, states and mode afterwards."""
    modules = list(module.modules())
    training = [each.training for each in modules]
    kept = [dict(each._buffers) for each in modules]
    states = [dict(vars(each)) for each in modules]
    for held in states:  # what is changed in place: recordings, states of SpikingJelly
        held.update({name: list(each) for name, each in held.items() if type(each) is list})
        if "_memories" in held:
            held["_memories"] = dict(held["_memories"])
    drawn = torch.get_rng_state()
    module.eval()
    try:
        yield
    finally:
        for each, mode, buffers, state in zip(modules, training, kept, states, strict=True):
            vars(each).update(state)
            each._buffers.update(buffers)
            each.training = mode
        torch.set_rng_state(drawn)


def _run(module: nn.Module, takes: Shape, axes: Shape) -> "tuple[_Tracer, _Value]":
    """Run the module on zeros; return what was recorded, and its output.

    axes: timesteps and batch of the example, in either order, where the module takes all; else the
        module runs twice, so that states inside it show what they were made of
    """
    tracer = _Tracer(module, takes, bool(axes))
    kinds = [p.dtype for p in module.parameters() if p.is_floating_point()]
    example = torch.zeros(
        *axes or (_BATCH * _rows(module),), *takes, dtype=kinds[0] if kinds else None
    )
    handles = tracer.watch()
    try:
        with tracer:
            found = module(tracer.input(example), *([] if axes else _states(module, None)))
            if not axes and tracer.ran_once:
                found = module(tracer.input(example.clone()), *_states(module, found))
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


def _states(module: nn.Module, outputs: object) -> list[Any]:
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


class _Value(NamedTuple):
    """The origin of a tensor: the sum of the outputs of nodes in some of their calls.

    terms: (node, call) of each, call counted from 0; of the input the timestep, or _WHOLE
    membrane_of: node of neurons whose membrane it is, which no map can read; empty for spikes
    made_by: function that made it, and that no node computes; else empty
    """

    terms: tuple[tuple[str, int], ...] = ()
    membrane_of: str = ""
    made_by: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The nodes that it comes from."""
        return (*filter(None, [self.membrane_of]), *(name for name, _ in self.terms))


_WHOLE = -1  # in place of a timestep of the input: all of it
_GIVEN = _Value(((_INPUT, _WHOLE),))


class _Tracer(TorchFunctionMode):
    """Records which nodes each tensor comes from, while a module runs.

    nodes: by name, in order of their first call
    arrived: what arrived at each node in each of its calls
    """

    def __init__(self, root: nn.Module, takes: Shape, loops: bool) -> None:
        super().__init__()
        self._root, self._takes, self._loops = root, takes, loops
        # by identity; the tensors are kept, so that none takes the place of another
        self._values: dict[int, tuple[Tensor, _Value]] = {}
        self.nodes: dict[str, Node] = {}
        self.arrived: dict[str, list[_Value]] = {}
        self._inside = 0

    def input(self, example: Tensor) -> Tensor:
        """Return an example of the input, which is known as such."""
        self._know(example, _GIVEN)
        return example

    @property
    def ran_once(self) -> bool:
        """Whether all neurons were called once."""
        return all(len(self.arrived[name]) == 1 for name in self._neurons())

    def output(self, found: object) -> _Value:
        """Return where the first output comes from; of a list or stack, the last timestep's."""
        for each in _tensors(found):
            value = self._value(each)
            if value is not None and not value.made_by:
                return value
        raise ConfigError(
            f"{type(self._root).__name__}: its output does not come from its layers alone, or is "
            "not a tensor. Return the spikes of the last layer, or a list or stack of them; sum "
            "and softmax belong to the loss."
        )

    def _neurons(self) -> list[str]:
        return [name for name, node in self.nodes.items() if isinstance(node, Neurons)]

    def _value(self, tensor: Tensor) -> _Value | None:
        found = self._values.get(id(tensor))
        return None if found is None else found[1]

    def _know(self, result: object, value: _Value) -> None:
        for tensor in _tensors(result):
            self._values[id(tensor)] = tensor, value

    def _shape(self, value: _Value | None, tensor: Tensor) -> Shape:
        """Return the shape of a value without batch and time."""
        if value is None or not value.names:
            return tuple(tensor.shape[1:])
        first = value.names[0]
        return self._takes if first == _INPUT else self.nodes[first].puts

    # leaf modules

    def watch(self) -> list[Any]:
        """Hook the leaf modules; return the handles."""
        handles = []
        taken = {_INPUT, _OUTPUT}  # of the graph's ends
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
                given = arguments[0]
                arriving, first = self._arriving(name, given), _tensors(result)[0]
                if not self._is_nothing(module, given, first):
                    node = self._call(name, module, given, arriving)
                    self._know(result, _Value(membrane_of=node))  # the states of neurons
                    if getattr(self.nodes[node], "has_spikes", True):
                        arriving = _Value(((node, len(self.arrived[node]) - 1),))
                    else:
                        arriving = _Value(membrane_of=node)
                self._know(first, arriving)  # the output last, which states may hold again
            self._inside -= 1

        return leave

    def _arriving(self, name: str, tensor: object) -> _Value:
        """Return where the input of a leaf comes from."""
        if not isinstance(tensor, Tensor):
            raise ConfigError(f"{name}: its input is {type(tensor).__name__} and no tensor.")
        value = self._value(tensor)
        if value is None and not tensor.any():
            return _Value()  # spikes before the first timestep
        if value is not None and value.membrane_of:
            raise ConfigError(
                f"{name}: it receives the membranes of {value.membrane_of}; between layers of a "
                "chip go spikes alone. Pass on the spikes, the first value that neurons return."
            )
        if value is None or value.made_by:
            raise ConfigError(
                f"{name}: it receives what {value.made_by if value else 'a constant'} makes, which "
                "has no place between layers of a chip. Possible are sums, flattening, Linear, "
                "Conv1d, Conv2d, AvgPool2d, BatchNorm and neurons."
            )
        return value

    def _is_nothing(self, module: nn.Module, before: Tensor, after: Tensor) -> bool:
        """Return True for a layer that a network on a chip does without."""
        kind = type(module)  # those of SpikingJelly and sinabs are not torch's
        if isinstance(module, _NOTHING) or kind.__module__.endswith(
            "activation_based.layer.dropout"
        ):
            return True
        arranges = isinstance(module, nn.Flatten | nn.Unflatten) or kind.__name__ == "UnflattenTime"
        return arranges and self._is_arranged(before, after)

    def _call(self, name: str, module: nn.Module, tensor: Tensor, arriving: _Value) -> str:
        """Record a call of a leaf; return the name of its node."""
        takes = self._shape(arriving, tensor)
        if tensor.shape[tensor.ndim - len(takes) :] != takes:
            raise ConfigError(
                f"{name}: its input has shape {tuple(tensor.shape)}, and what arrives has {takes} "
                "in a timestep of a sample. Flatten all axes but batch and time, or none."
            )
        if isinstance(module, _NORMS):
            return self._fold(name, module, arriving)
        if name not in self.nodes:
            self.nodes[name] = node_of(name, module, takes)
        node = self.nodes[name]
        if isinstance(node, TorchNeurons):
            if (inputs := node.inputs()) is not None:
                arriving = self._pass(f"{name}.input", inputs, arriving)
            self._check_time(name, node, tensor.ndim - len(takes))
        self._pass(name, node, arriving)
        return name

    def _pass(self, name: str, node: Node, arriving: _Value) -> _Value:
        self.nodes.setdefault(name, node)
        self.arrived.setdefault(name, []).append(arriving)
        return _Value(((name, len(self.arrived[name]) - 1),))

    def _fold(self, name: str, norm: nn.Module, arriving: _Value) -> str:
        """Fold a normalisation into the weights before it; return their name."""
        (source, _), *others = arriving.terms or (("", 0),)
        before = self.nodes.get(source)
        if others or not isinstance(before, Weights) or before.norm not in (None, norm):
            raise ConfigError(
                f"{name}: {type(norm).__name__} is folded into the weights before it. Put it "
                "directly behind one Linear or convolution."
            )
        before.norm = norm
        return source

    def _check_time(self, name: str, node: TorchNeurons, axes: int) -> None:
        """Refuse neurons for which an axis of timesteps is one of the batch, or the reverse."""
        if axes < 2 and node.takes_time:
            if not self._loops:
                raise _TimeAxisError
            raise ConfigError(
                f"{name}: {node.convention.source} takes all timesteps at once, and receives one. "
                "Take its form of one timestep, or call the layer once with all."
            )
        if axes > 1 and not node.takes_time:
            raise ConfigError(
                f"{name}: {node.convention.source} takes one timestep, and receives an axis more "
                "than the batch. Call it once in each timestep, or take the form that takes all: "
                "SpikingJelly's step_mode='m', Norse's LIF."
            )

    # functions between them

    def __torch_function__(
        self,
        function: Callable[..., Any],
        types: Any,  # noqa: ANN401
        arguments: Sequence[Any] = (),
        options: Mapping[str, Any] | None = None,
    ) -> Any:  # noqa: ANN401
        """Call the function; note where its result comes from."""
        result = function(*arguments, **(options or {}))
        name = getattr(function, "__name__", str(function))
        if not self._inside and name == "__setitem__":  # it changes a tensor and returns none
            self._note_written(arguments[0], arguments[2])
        elif not self._inside and _tensors(result):
            known = [self._value(each) for each in _tensors(arguments)]
            if values := [each for each in known if each is not None]:
                complete = len(values) == len(known)
                value = self._value_of(name, arguments, options, result, values, complete)
                of_input = name == "unbind" and value == _GIVEN
                for t, each in enumerate(_tensors(result)):
                    self._know(each, _Value(((_INPUT, t),)) if of_input else value)
        return result

    def _note_written(self, target: Tensor, source: object) -> None:
        """Note that a tensor was written to: it may collect timesteps, as `stack` does."""
        value = self._value(source) if isinstance(source, Tensor) else None
        before = self._value(target)
        if value is None and before is None:
            return
        collects = isinstance(source, Tensor) and target.shape[1:] == source.shape
        same = value is not None and (before is None or before.names == value.names)
        made_by = any(each is not None and each.made_by for each in (value, before))
        is_stack = collects and same and not made_by
        self._know(target, value if is_stack and value else _Value(made_by="__setitem__"))

    def _value_of(
        self,
        function: str,
        arguments: Sequence[Any],
        options: Mapping[str, Any] | None,
        result: Any,  # noqa: ANN401
        values: Sequence[_Value],
        complete: bool,
    ) -> _Value:
        """Return where the result of a function comes from.

        values: of the tensors among its arguments that are known
        complete: whether all are
        """
        first, value = arguments[0], values[0]
        for each in values:
            if each.made_by:
                return each
        unchanged = function in _SAME or (
            function in _ARRANGING and self._is_arranged(first, result)
        )
        if unchanged and len(values) == 1:
            return value
        if function in _INDEXING and value == _GIVEN and self._has_timesteps(first):
            return self._timestep(function, arguments, options or {})
        if function in _ADDING and complete and _adds(arguments, options, values):
            return _Value(tuple(term for each in values for term in each.terms))
        if function in _STACKING and complete and len({each.names for each in values}) == 1:
            shape, before = self._shape(value, _tensors(first)[0]), _tensors(first)[0]
            if result.ndim > before.ndim or result.shape[result.ndim - len(shape) :] == shape:
                return self._stacked(function, values)
        if function in _RESHAPING and isinstance(first, Tensor) and isinstance(result, Tensor):
            return self._reshaped(function, first, result, value)
        return _Value(made_by=function)

    def _has_timesteps(self, given: Tensor) -> bool:
        if not self._loops:
            raise _TimeAxisError
        return given.ndim == len(self._takes) + 2

    def _timestep(
        self, function: str, arguments: Sequence[Any], options: Mapping[str, Any]
    ) -> _Value:
        """Return a timestep of the input, as in x[t] or x[:, t]; all of `unbind`.

        Raises ConfigError for other indices than whole numbers.
        """
        given, *rest = arguments
        if function in ("select", "unbind"):
            named = {"dim": 0, "index": 0}
            named |= dict(zip(("dim", "index"), rest, strict=False)) | dict(options)
            axis = named["dim"] % given.ndim
            places: tuple[Any, ...] = (*[slice(None)] * axis, named["index"])
        else:
            places = rest[0] if isinstance(rest[0], tuple) else (rest[0],)
        whole = [isinstance(each, int) for each in places]
        others = [each for each in places if not isinstance(each, int)]
        if sum(whole) != 1 or any(whole[2:]) or any(
            each is not ... and not (isinstance(each, slice) and each == slice(None))
            for each in others
        ):  # fmt: skip
            raise ConfigError(
                f"{type(self._root).__name__}: its forward indexes its input by {places!r}; a "
                "network on a chip takes one timestep after another. Index timesteps by whole "
                "numbers, or write a forward of one timestep."
            )
        if function == "unbind":
            return _GIVEN
        axis = whole.index(True)
        return _Value(((_INPUT, places[axis] % given.shape[axis]),))

    def _stacked(self, function: str, values: Sequence[_Value]) -> _Value:
        """Return what a stack of timesteps of one node comes from."""
        if _INPUT not in values[-1].names:
            return values[-1]
        in_order = [each.terms for each in values] == [((_INPUT, t),) for t in range(len(values))]
        return _GIVEN if in_order else _Value(made_by=function)

    def _reshaped(self, function: str, before: Tensor, after: Tensor, value: _Value) -> _Value:
        takes = self._shape(value, before)
        if self._is_arranged(before, after):
            return value
        flattens = after.shape[-1:] == (math.prod(takes),)
        if not flattens or before.shape[before.ndim - len(takes) :] != takes:
            raise ConfigError(
                f"{type(self._root).__name__}: {function} makes {tuple(after.shape)} of "
                f"{tuple(before.shape)}; between layers a network on a chip can only flatten all "
                "axes but the batch. Use nn.Flatten()."
            )
        name = "+".join(name for name, _ in value.terms) + ".flatten"
        return self._pass(name, flatten(takes), value)

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

    # the network that it comes to

    def network(self, output: _Value) -> TorchNetwork:
        """Return the network whose last recorded timestep this is."""
        if not self._neurons():
            raise ConfigError(
                f"{type(self._root).__name__}: it has no neurons that are known. Known are {KNOWN}."
            )
        if _INPUT in output.names:
            raise ConfigError(
                "its input is added to its output; what leaves a chip comes from its layers. Put "
                "neurons, or a layer, between them."
            )
        if output.membrane_of:
            self.nodes[output.membrane_of].read_membrane()  # type: ignore[operator]
        nodes = dict(self.nodes)
        found = {(s, target): lag for target in self.arrived for s, lag in self._sources(target)}
        edges = {*found, *((end, _OUTPUT) for end in output.names)}
        for name, node in self.nodes.items():
            if isinstance(node, TorchNeurons) and (recurrent := node.recurrent()) is not None:
                nodes[f"{name}.recurrent"] = recurrent
                edges |= {(name, f"{name}.recurrent"), (f"{name}.recurrent", name)}
        for source, target in sorted(edge for edge, lag in found.items() if lag):
            # in a loop NIR delivers a timestep late anyway
            if source not in reach([target], neighbours(edges)):
                puts = self._takes if source == _INPUT else nodes[source].puts
                nodes[f"{source}.delay"] = Delay(np.ones(puts, np.int64))
                edges.remove((source, target))
                edges |= {(source, f"{source}.delay"), (f"{source}.delay", target)}
        return TorchNetwork(nodes, sorted(edges), self._takes, nodes[output.names[0]].puts)

    def _sources(self, target: str) -> set[tuple[str, int]]:
        """Return the sources of a node, and by how many timesteps each is late, 0 or 1.

        Raises ConfigError where the node is not called once a timestep, or from elsewhere in some.
        """
        timesteps = max(len(self.arrived[name]) for name in self._neurons())
        calls = self.arrived[target]
        # of a static input once, in front of the loop
        if len(calls) != timesteps and (len(calls) != 1 or target in self._neurons()):
            raise ConfigError(
                f"{target}: it is called {len(calls)} times in {timesteps} timesteps; on a chip a "
                "layer works once in each. Make a layer of its own for each place."
            )
        found = [
            {(s, 0 if self._is_static(s, call) else at - call) for s, call in value.terms}
            for at, value in enumerate(calls)
        ]
        wanted = found[-1]
        at_first = {(source, lag) for source, lag in wanted if not lag or len(found) == 1}
        if any(each != wanted for each in found[1:]) or found[0] != at_first:
            raise ConfigError(
                f"{target}: its inputs are not the same in every timestep. Write a forward of one "
                "timestep, or one loop."
            )
        if any(lag not in (0, 1) for _, lag in wanted):
            raise ConfigError(f"{target}: it receives what is several timesteps old.")
        if len({source for source, _ in wanted}) < len(wanted):
            raise ConfigError(f"{target}: it receives what is of two timesteps at once.")
        return wanted

    def _is_static(self, source: str, call: int) -> bool:
        """Return True for the whole input, and for what was called once in front of a loop."""
        return call == _WHOLE if source == _INPUT else len(self.arrived[source]) == 1


def _adds(
    arguments: Sequence[Any], options: Mapping[str, Any] | None, values: Sequence[_Value]
) -> bool:
    """Return True if a sum adds tensors of several nodes, or 0 as Python's `sum` does."""
    constants = [each for each in arguments if not isinstance(each, Tensor)]
    nodes = [term for each in values for term in each.terms]
    # an edge of NIR counts once
    return not options and all(each == 0 for each in constants) and len({*nodes}) == len(nodes)


def _tensors(found: object) -> list[Tensor]:
    """Return the tensors in nested tuples, lists and dicts, in order."""
    if isinstance(found, Tensor):
        return [found]
    if isinstance(found, Mapping):
        found = tuple(found.values())
    if isinstance(found, tuple | list):
        return [tensor for each in found for tensor in _tensors(each)]
    return []
