"""Base of the adapters of a library's neurons: a difference equation, read from the module."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.runtime.convention import Convention, Floor, Reset, SpikeCondition
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.surrogate_neurons import Surrogate
from spikedeploy.trainers.torch_network import Neurons, Weights


class TorchNeurons(Neurons):
    """Neurons whose numbers are those of a module of the user.

    module: module of another library
    convention: how its neurons spike and reset, "none" of those that do not spike; its source is
        the neuron in its library's words
    has_spikes: False where the module puts out its membranes
    takes_time: True where its input has all timesteps, beside the batch
    """

    module: Any  # of torch, by duck typing
    has_spikes: bool = True
    takes_time: bool = False

    def __init__(
        self,
        module: nn.Module,
        takes: Shape,
        described: str,
        reset: Reset,
        spikes: SpikeCondition = "above",
        floor: Floor = "none",
    ) -> None:
        super().__init__(takes)
        self.module = module
        self.convention = Convention(
            1e-3,
            reset,
            source=described,
            spikes=spikes if reset != "none" else "above",
            floor=floor,
        )
        self._reads_membrane = False

    def inputs(self) -> Weights | None:
        """Return the weights of the module in front of its neurons, or None."""
        return None

    def recurrent(self) -> Weights | None:
        """Return the connections of the layer onto itself, or None."""
        return None

    def read_membrane(self) -> None:
        """Take the layer for a readout, whose membranes are the output and which never spikes."""
        if self.convention.reset != "none":
            raise self.refused(
                "the output is its membranes, and it spikes",
                "Return the spikes, or end in neurons that do not spike: snnTorch's with "
                "reset_mechanism='none', Norse's LICell, sinabs' ExpLeak.",
            )
        self._reads_membrane = True

    def refused(self, setting: str, instead: str) -> ConfigError:
        """Return the error of a setting that no chip has."""
        return ConfigError(f"{self.convention.source}: {setting}. {instead}")


def wide(numbers: Tensor | float) -> Tensor:
    """Return numbers in float64, with their gradient."""
    return torch.as_tensor(numbers, dtype=torch.float64)


def largest(numbers: Tensor) -> float:
    """Return the number that is furthest from 0."""
    flat = numbers.detach().flatten()
    return float(flat[flat.abs().argmax()])


def derivative_of(function: Callable[[Tensor], Tensor]) -> Surrogate:
    """Return the derivative of a surrogate of the user, by torch's own differentiation."""

    def derivative(excess: Tensor) -> Tensor:
        with torch.enable_grad():
            x = excess.detach().requires_grad_()
            (found,) = torch.autograd.grad(function(x).sum(), x)
        return found

    return derivative
