"""Neurons of SpikingJelly."""

from typing import Any

import torch

from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_network import Equation
from spikedeploy.trainers.torch_neurons.adapter import TorchNeurons, derivative_of, wide


class SpikingJellyNeurons(TorchNeurons):
    """SpikingJelly 2.0.0: IFNode, LIFNode and ParametricLIFNode, step_mode "s" or "m".

    V[t] = V[t-1] - (V[t-1] - v_reset) / tau + x[t], where x counts 1 / tau times with decay_input;
    spikes at the threshold (neuron/lif.py). V starts at v_reset, and is counted from there;
    v_reset=None subtracts the threshold, and V starts at 0.
    """

    def __init__(self, module: Any, takes: Shape) -> None:  # noqa: ANN401
        self.takes_time = module.step_mode == "m"
        described = f"SpikingJelly's {type(module).__name__}(v_reset={module.v_reset})"
        reset = "subtract" if module.v_reset is None else "zero"
        super().__init__(module, takes, described, reset, "reached")  # type: ignore[arg-type]
        if not getattr(module.surrogate_function, "spiking", True):
            raise self.refused(
                "its surrogate function is in the mode that puts out no spikes",
                "Call set_spiking_mode(True).",
            )
        self.derivative = derivative_of(module.surrogate_function)

    def numbers(self) -> Equation:
        """Return the present numbers."""
        module = self.module
        lost = torch.zeros((), dtype=torch.float64)
        if hasattr(module, "w"):
            lost = wide(module.w.sigmoid())
        elif hasattr(module, "tau"):
            lost = wide(1 / module.tau)
        gain = lost if getattr(module, "decay_input", False) else torch.ones_like(lost)
        threshold = wide(module.v_threshold) - wide(module.v_reset or 0.0)
        return Equation(None, 1 - lost, threshold, None, gain)
