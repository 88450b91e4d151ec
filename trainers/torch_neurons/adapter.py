"""Base of the adapters of a library's neurons: a difference equation, read from the module."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
from torch import Tensor, nn

from spikedeploy.runtime.convention import Floor, Reset, Spikes
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.neurons import Surrogate
from spikedeploy.trainers.torch_network import Map, Neurons

# of Neurons.numbers: current decay, membrane decay, threshold, leak, gain
Numbers: TypeAlias = tuple[Tensor | None, Tensor, Tensor | None, Tensor | None, Tensor]


@dataclass(frozen=True)
class Meaning:
    """The behaviour of a library's neurons that decides the convention of a file.

    reset: as in Convention; "none" of a layer that does not spike
    spikes, floor: likewise
    described: the neuron in its library's words
    """

    reset: Reset
    spikes: Spikes
    described: str
    floor: Floor = "none"


class TorchNeurons(Neurons):
    """Neurons whose numbers are those of a module of the user.

    module: module of another library
    meaning: what it does
    has_spikes: False where the module puts out its membranes
    takes_time: True where its input has all timesteps, beside the batch
    """

    module: Any  # of torch, by duck typing
    has_spikes: bool = True
    takes_time: bool = False

    def __init__(self, module: nn.Module, takes: Shape, meaning: Meaning) -> None:
        super().__init__(takes)
        self.module, self.meaning = module, meaning
        self._reads_membrane = False

    def inputs(self) -> Map | None:
        """Return the weights of the module in front of its neurons, or None."""
        return None

    def recurrent(self) -> Map | None:
        """Return the connections of the layer onto itself, or None."""
        return None

    def read_membrane(self) -> None:
        """Take the layer for a readout, whose membranes are the output and which never spikes."""
        if self.meaning.reset != "none":
            raise ConfigError(
                f"the output is the membranes of {self.meaning.described}, which spikes; chips put "
                "out spikes, or membranes of neurons that do not spike. Return the spikes, or end "
                "in neurons that do not spike: snnTorch's with reset_mechanism='none', Norse's "
                "LICell, sinabs' ExpLeak."
            )
        self._reads_membrane = True

    def refused(self, setting: str, instead: str) -> ConfigError:
        """Return the error of a setting that no chip has."""
        return ConfigError(f"{self.meaning.described}: {setting}. {instead}")


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
