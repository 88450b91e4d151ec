"""Neurons of sinabs."""

from typing import Any

import torch
from torch import Tensor

from spikedeploy.runtime.convention import Floor, Reset, Spikes
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_neurons.adapter import Meaning, Numbers, TorchNeurons, largest, wide


class SinabsNeurons(TorchNeurons):
    """sinabs 3.1.3: IAF, LIF and ExpLeak, also squeezed.

    I[t] = a (I[t-1] + x[t]), or x[t]; V[t] = b V[t-1] + I[t], where I counts 1 - b times with
    norm_input; spikes at the threshold, one or as many as fit (layers/functional/lif.py,
    activation/spike_generation.py). The floor is applied after a reset.
    """

    def __init__(self, module: Any, takes: Shape) -> None:  # noqa: ANN401
        kind = type(module).__name__
        self.has_spikes = module.spike_fn is not None
        self.takes_time = not kind.endswith("Squeeze")
        meaning = Meaning("none", "many", f"sinabs' {kind}")
        super().__init__(module, takes, meaning)
        if self.has_spikes:
            self.meaning = Meaning(self._reset(), self._spikes(), self._described(), self._floor())
            self.derivative = self._slope
        elif module.min_v_mem is not None:
            raise self.refused("min_v_mem has no place on a chip", "Leave it out.")
        self.numbers()

    def _described(self) -> str:
        spikes = getattr(self.module.spike_fn, "__name__", repr(self.module.spike_fn))
        reset = type(self.module.reset_fn).__name__
        return f"{self.meaning.described}(spike_fn={spikes}, reset_fn={reset})"

    def _reset(self) -> Reset:
        method = self.module.reset_fn
        kind = type(method).__name__
        if kind == "MembraneSubtract" and method.subtract_value is None:
            return "subtract"
        if kind == "MembraneReset" and method.reset_value == 0:
            return "zero"
        instead = "Take MembraneSubtract() or MembraneReset()."
        raise self.refused(f"reset_fn {method} has no place on a chip", instead)

    def _spikes(self) -> Spikes:
        method = self.module.spike_fn
        most = getattr(method, "max_num_spikes_per_bin", 0)
        name = getattr(method, "__name__", type(method).__name__)
        if name == "MultiSpike" or (name == "MaxSpike" and most is None):
            return "many"
        if name == "SingleSpike" or (name == "MaxSpike" and most == 1):
            return "reached"
        instead = "Take MultiSpike or SingleSpike."
        raise self.refused(f"spike_fn {method} has no place on a chip", instead)

    def _floor(self) -> Floor:
        floor = self.module.min_v_mem
        if floor is None:
            return "none"
        if not floor.any():
            return "zero"
        if bool((wide(floor) == -wide(self.module.spike_threshold)).all()):
            return "threshold"
        raise self.refused(
            f"min_v_mem goes to {largest(-wide(floor)):g} below 0",
            "The lowest membrane of a chip is 0 or minus the threshold, or there is none.",
        )

    def _slope(self, excess: Tensor) -> Tensor:
        threshold = self.module.spike_threshold.detach().to(excess.dtype)
        flat = threshold.expand(self.takes).reshape(-1)
        with torch.no_grad():
            found: Tensor = self.module.surrogate_grad_fn(excess + flat, flat)
        return found

    def numbers(self) -> Numbers:
        """Return the fields of Equation."""
        module = self.module
        membrane, current = module.alpha_mem_calculated, module.alpha_syn_calculated
        gain = torch.ones((), dtype=torch.float64)
        if module.norm_input:
            gain = wide(1 - membrane)
        if current is not None:
            gain = gain * wide(current)
        return (
            None if current is None else wide(current).clamp(0, 1),
            wide(membrane).clamp(0, 1),
            wide(module.spike_threshold) if self.has_spikes else None,
            None,
            gain,
        )
