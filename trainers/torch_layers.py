"""Leaf modules of torch as nodes: weights, pools, Flatten, and neurons of other libraries."""

import nir
import numpy as np
from torch import nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_network import Fixed, Node, Weights, flatten
from spikedeploy.trainers.torch_neurons import is_neurons, neurons_of
from spikedeploy.trainers.torch_neurons.adapter import TorchNeurons


def leaves(root: nn.Module) -> list[tuple[str, nn.Module]]:
    """Return the modules that are taken as one node, by name; those inside them are not."""
    found: list[tuple[str, nn.Module]] = []
    inside: list[str] = []
    for name, module in root.named_modules():
        if any(name.startswith(f"{each}.") for each in inside):
            continue
        if not any(module.children()) or is_neurons(module) or _lifted(module) is not None:
            found.append((name, module))
            inside.append(name)
    return found


def node_of(name: str, module: nn.Module, takes: Shape) -> Node:
    """Return the node of a leaf module; ConfigError where it has no place on a chip."""
    if (lifted := _lifted(module)) is not None:
        node = node_of(name, lifted, takes)
        if isinstance(node, TorchNeurons):
            node.takes_time = True
        return node
    if (neurons := neurons_of(name, module, takes)) is not None:
        return neurons
    if isinstance(module, nn.Linear | nn.Conv1d | nn.Conv2d):
        axes = module.weight.ndim - 1
        if len(takes) != axes:
            raise ConfigError(
                f"{name}: {type(module).__name__} receives {takes} in a timestep of a sample; on a "
                f"chip it takes {axes} {'axis' if axes == 1 else 'axes'}. Flatten in front of it, "
                "or give another input_shape."
            )
        if getattr(module, "padding_mode", "zeros") != "zeros":
            raise ConfigError(
                f"{name}: padding_mode {module.padding_mode!r}; chips pad with zeros."
            )
        return Weights(module, takes)
    if isinstance(module, nn.Flatten):
        if module.end_dim not in (-1, len(takes)):
            raise ConfigError(f"{name}: Flatten flattens some axes; use nn.Flatten().")
        return flatten(takes)
    if isinstance(module, nn.AvgPool2d | nn.LPPool2d):
        return _pool(name, module, takes)
    instead = _INSTEAD.get(type(module).__name__, "take it out, or put neurons in its place")
    raise ConfigError(f"{name}: {type(module).__name__} has no place on a chip: {instead}.")


_INSTEAD = {
    "MaxPool2d": "use nn.AvgPool2d, whose mean is a sum of spikes with equal weights",
    "ReLU": "neurons take its place",
    "Softmax": "it belongs to the loss",
    "LayerNorm": "use nn.BatchNorm, which is folded into the weights",
}


def _lifted(module: nn.Module) -> nn.Module | None:
    """Return the layer that Norse's Lift calls in each timestep."""
    found = getattr(module, "lifted_module", None)
    return found if type(module).__name__ == "Lift" and isinstance(found, nn.Module) else None


def _pool(name: str, module: nn.AvgPool2d | nn.LPPool2d, takes: Shape) -> Fixed:
    """Return a mean, or the sum that sinabs makes of LPPool2d."""
    sums = isinstance(module, nn.LPPool2d)
    if module.ceil_mode or (sums and module.norm_type != 1):
        raise ConfigError(f"{name}: {type(module).__name__} with ceil_mode, or powers.")
    if not sums and (not module.count_include_pad or module.divisor_override):
        raise ConfigError(f"{name}: AvgPool2d with another divisor than its kernel.")
    settings = (module.kernel_size, module.stride, getattr(module, "padding", 0))
    # without a stride, LPPool2d takes its kernel
    kernel, stride, padding = (
        np.broadcast_to(module.kernel_size if n is None else n, 2).astype(int) for n in settings
    )
    return Fixed((nir.SumPool2d if sums else nir.AvgPool2d)(kernel, stride, padding), takes)
