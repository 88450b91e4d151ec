"""Neurons of other libraries as difference equations: what each class means by its settings."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.runtime.convention import Reset, Spikes
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.network import Map, Neurons, Weights
from spikedeploy.trainers.policies.neurons import Surrogate, surrogate


@dataclass(frozen=True)
class Meaning:
    """What a library's neurons do that decides the convention of a file.

    reset: as in Convention
    spikes: likewise
    described: the neuron in its library's words
    """

    reset: Reset
    spikes: Spikes
    described: str


class TorchNeurons(Neurons):
    """Neurons whose numbers are those of a module of the user.

    module: of another library
    meaning: what it does
    """

    def __init__(self, module: nn.Module, takes: Shape, meaning: Meaning) -> None:
        super().__init__(takes)
        self.module, self.meaning = module, meaning
        self._reads_membrane = False

    def recurrent(self) -> Map | None:
        """Return the connections of the layer onto itself, or None."""
        return None

    def read_membrane(self) -> None:
        """Take the layer for a readout, whose membranes are the output and which never spikes."""
        if self.meaning.reset != "none":
            raise ConfigError(
                f"the output is the membranes of {self.meaning.described}, which spikes; chips put "
                "out spikes, or membranes of neurons that do not spike. Return the spikes, or set "
                "reset_mechanism='none' in the last layer."
            )
        self._reads_membrane = True


# V = (1 - r) (beta V + I): a late reset takes the input of that timestep with it; Leaky keeps it
_LOSE_THEIR_INPUT = ("RLeaky", "Lapicque")


class SnnTorchNeurons(TorchNeurons):
    """snnTorch 1.0.0: Leaky, RLeaky, Synaptic, RSynaptic, Lapicque.

    V[t] = beta V[t-1] + I[t]; spikes above the threshold (_neurons/leaky.py, synaptic.py).
    """

    def __init__(self, module: Any, takes: Shape) -> None:  # noqa: ANN401
        kind = type(module).__name__
        # RSynaptic throws away what reset_delay=False subtracts; Lapicque has no such choice
        late = getattr(module, "reset_delay", True) or kind == "RSynaptic"
        wanted = module.reset_mechanism
        resets: dict[tuple[str, bool], Reset] = {
            ("zero", False): "zero",
            ("zero", True): "zero-delayed",
            ("subtract", False): "subtract-ahead",
            ("subtract", True): "subtract-delayed",
        }
        reset = resets.get((wanted, late), "none")
        settings = f"reset_mechanism={wanted!r}, reset_delay={late}"
        super().__init__(module, takes, Meaning(reset, "above", f"snnTorch's {kind}({settings})"))
        for name, plain in (("inhibition", False), ("state_quant", False)):
            if getattr(module, name, plain):
                raise ConfigError(
                    f"snnTorch's {kind}: {name} has no place on a chip; leave it out."
                )
        if float(torch.as_tensor(getattr(module, "graded_spikes_factor", 1.0)).max()) != 1:
            raise ConfigError(
                f"snnTorch's {kind}: graded_spikes_factor is no 1; spikes of a chip are. Put the "
                "factor into the weights behind it."
            )
        self.derivative = _derivative_of(module.spike_grad)

    def numbers(self) -> tuple[Tensor | None, Tensor, Tensor | None, Tensor | None, Tensor]:
        """Return alpha, beta, threshold, no leak, and the gain."""
        module: Any = self.module
        beta = torch.as_tensor(module.beta)
        alpha = getattr(module, "alpha", None)
        if self.meaning.reset == "zero-delayed" and type(module).__name__ in _LOSE_THEIR_INPUT:
            alpha = torch.zeros(())  # a current that forgets at once: as of CubaLIF, V = 0 then
        gain = torch.ones((), dtype=beta.dtype)
        if hasattr(module, "R"):  # Lapicque: V = (1 - dt / RC) V + dt / C I
            gain = module.time_step / module.C
            beta = 1 - module.time_step / (module.R * module.C)
        threshold = None if self._reads_membrane else self._per_neuron(module.threshold)
        return (
            None if alpha is None else self._per_neuron(alpha).clamp(0, 1),
            self._per_neuron(beta).clamp(0, 1),
            threshold,
            None,
            self._per_neuron(gain),
        )

    def _per_neuron(self, numbers: Tensor) -> Tensor:
        """Return numbers that broadcast to the shape of the layer; of one element without axes."""
        return numbers.reshape(()) if numbers.numel() == 1 else numbers

    def recurrent(self) -> Map | None:
        """Return the recurrent layer of RLeaky and RSynaptic."""
        layer = getattr(self.module, "recurrent", None)
        if layer is None:
            return None
        if not isinstance(layer, nn.Linear | nn.Conv2d):
            raise ConfigError(
                f"{self.meaning.described}: its recurrence is one weight a neuron. Choose "
                "all_to_all=True with linear_features."
            )
        return Weights(layer, self.takes)


# snnTorch's that are among ours; both hold the width alone
_SURROGATES = {"atan.<locals>.inner": "atan", "fast_sigmoid.<locals>.inner": "fast-sigmoid"}


def _derivative_of(function: Callable[[Tensor], Tensor]) -> Surrogate:
    """Return the derivative of a surrogate of the user, by torch's own differentiation.

    That takes several times as long as the formula, which stands for the ones that are known.
    """
    known = _SURROGATES.get(getattr(function, "__qualname__", ""))
    if known and getattr(function, "__module__", "") == "snntorch.surrogate":
        (width,) = (cell.cell_contents for cell in getattr(function, "__closure__", ()))
        return surrogate(known, float(width))

    def derivative(excess: Tensor) -> Tensor:
        with torch.enable_grad():
            x = excess.detach().requires_grad_()
            (found,) = torch.autograd.grad(function(x).sum(), x)
        return found

    return derivative


_KINDS: dict[tuple[str, str], Callable[[Any, Shape], TorchNeurons]] = {
    ("snntorch", kind): SnnTorchNeurons
    for kind in ("Leaky", "RLeaky", "Synaptic", "RSynaptic", "Lapicque")
}


def neurons_of(module: nn.Module, takes: Shape) -> TorchNeurons | None:
    """Return the neurons of a module; None where it is none that is known."""
    for kind in type(module).__mro__:
        library = kind.__module__.partition(".")[0]
        if (make := _KINDS.get((library, kind.__name__))) is not None:
            return make(module, takes)
    return None
