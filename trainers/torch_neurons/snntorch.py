"""Neurons of snnTorch."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.runtime.convention import Reset
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.surrogate_neurons import Surrogate, surrogate
from spikedeploy.trainers.torch_network import Equation, Weights
from spikedeploy.trainers.torch_neurons.adapter import TorchNeurons, derivative_of

# V = (1 - r) (beta V + I): a late reset takes the input of that timestep with it; Leaky keeps it
_LOSE_THEIR_INPUT = ("RLeaky", "Lapicque")
# by reset_mechanism and reset_delay
_RESETS: dict[tuple[str, bool], Reset] = {
    ("zero", False): "zero",
    ("zero", True): "zero-delayed",
    ("subtract", False): "subtract-ahead",
    ("subtract", True): "subtract-delayed",
}
# those that are among ours; both hold the width alone
_SURROGATES = {"atan.<locals>.inner": "atan", "fast_sigmoid.<locals>.inner": "fast-sigmoid"}


class SnnTorchNeurons(TorchNeurons):
    """snnTorch 1.0.0: Leaky, RLeaky, Synaptic, RSynaptic, Lapicque.

    V[t] = beta V[t-1] + I[t]; spikes above the threshold (_neurons/leaky.py, synaptic.py).
    """

    def __init__(self, module: Any, takes: Shape) -> None:  # noqa: ANN401
        kind, wanted = type(module).__name__, module.reset_mechanism
        # RSynaptic throws away what reset_delay=False subtracts; Lapicque has no such choice
        late = getattr(module, "reset_delay", True) or kind == "RSynaptic"
        described = f"snnTorch's {kind}(reset_mechanism={wanted!r}, reset_delay={late})"
        super().__init__(module, takes, described, _RESETS.get((wanted, late), "none"))
        for name in ("inhibition", "state_quant"):
            if getattr(module, name, False):
                raise self.refused(f"{name} has no place on a chip", "Leave it out.")
        if float(torch.as_tensor(getattr(module, "graded_spikes_factor", 1.0)).max()) != 1:
            raise self.refused(
                "graded_spikes_factor is no 1; spikes of a chip are",
                "Put the factor into the weights behind it.",
            )
        self.derivative = _slope(module.spike_grad)

    def numbers(self) -> Equation:
        """Return the present numbers."""
        module = self.module
        beta = torch.as_tensor(module.beta)
        alpha = getattr(module, "alpha", None)
        if self.convention.reset == "zero-delayed" and type(module).__name__ in _LOSE_THEIR_INPUT:
            alpha = torch.zeros(())  # a current that forgets at once: as of CubaLIF, V = 0 then
        gain = torch.ones((), dtype=beta.dtype)
        if hasattr(module, "R"):  # Lapicque: V = (1 - dt / RC) V + dt / C I
            gain = module.time_step / module.C
            beta = 1 - module.time_step / (module.R * module.C)
        return Equation(
            None if alpha is None else _per_neuron(alpha).clamp(0, 1),
            _per_neuron(beta).clamp(0, 1),
            None if self._reads_membrane else _per_neuron(module.threshold),
            None,
            _per_neuron(gain),
        )

    def recurrent(self) -> Weights | None:
        """Return the recurrent layer of RLeaky and RSynaptic."""
        layer = getattr(self.module, "recurrent", None)
        if layer is None:
            return None
        if not isinstance(layer, nn.Linear | nn.Conv2d):
            raise self.refused(
                "its recurrence is one weight a neuron",
                "Choose all_to_all=True with linear_features.",
            )
        return Weights(layer, self.takes)


def _per_neuron(numbers: Tensor) -> Tensor:
    """Return numbers that broadcast to the shape of the layer; of one element without axes."""
    return numbers.reshape(()) if numbers.numel() == 1 else numbers


def _slope(function: Callable[[Tensor], Tensor]) -> Surrogate:
    """Return the derivative of a surrogate; by its formula, which is faster, where it is known."""
    known = _SURROGATES.get(getattr(function, "__qualname__", ""))
    if known and getattr(function, "__module__", "") == "snntorch.surrogate":
        (width,) = (cell.cell_contents for cell in getattr(function, "__closure__", ()))
        return surrogate(known, float(width))
    return derivative_of(function)
