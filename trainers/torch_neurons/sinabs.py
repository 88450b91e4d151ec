"""Neurons of sinabs."""

from typing import Any

import torch
from torch import Tensor

from spikedeploy.runtime.convention import Floor, Reset, SpikeCondition
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_network import Equation
from spikedeploy.trainers.torch_neurons.adapter import TorchNeurons, largest, wide

# of spike_fn with its max_num_spikes_per_bin, and reset_fn with its value
_SPIKES: dict[tuple[str, object], SpikeCondition] = {
    ("MultiSpike", None): "many",
    ("MaxSpike", None): "many",
    ("SingleSpike", None): "reached",
    ("MaxSpike", 1): "reached",
}
_RESETS: dict[tuple[str, object], Reset] = {
    ("MembraneSubtract", None): "subtract",
    ("MembraneReset", 0): "zero",
}


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
        if not self.has_spikes:
            super().__init__(module, takes, f"sinabs' {kind}", "none")
            if module.min_v_mem is not None:
                raise self.refused("min_v_mem has no place on a chip", "Leave it out.")
            return
        fires, resets = module.spike_fn, module.reset_fn
        name = getattr(fires, "__name__", type(fires).__name__)
        most = fires.max_num_spikes_per_bin if name == "MaxSpike" else None
        to = getattr(resets, "reset_value", getattr(resets, "subtract_value", None))
        spikes = _SPIKES.get((name, most))
        reset = _RESETS.get((type(resets).__name__, to))
        described = f"sinabs' {kind}(spike_fn={name}, reset_fn={type(resets).__name__})"
        floor = self._floor(module)
        super().__init__(
            module, takes, described, reset or "zero", spikes or "above", floor or "none"
        )
        if spikes is None or reset is None:
            raise self.refused(
                f"spike_fn {fires} with reset_fn {resets} has no place on a chip",
                "Take MultiSpike or SingleSpike, and MembraneSubtract() or MembraneReset().",
            )
        if floor is None:
            raise self.refused(
                f"min_v_mem goes to {largest(-wide(module.min_v_mem)):g} below 0",
                "The lowest membrane of a chip is 0 or minus the threshold, or there is none.",
            )
        self.derivative = self._slope

    @staticmethod
    def _floor(module: Any) -> Floor | None:  # noqa: ANN401
        floor = module.min_v_mem
        if floor is None:
            return "none"
        if not floor.any():
            return "zero"
        is_threshold = bool((wide(floor) == -wide(module.spike_threshold)).all())
        return "threshold" if is_threshold else None

    def _slope(self, excess: Tensor) -> Tensor:
        threshold = self.module.spike_threshold.detach().to(excess.dtype)
        flat = threshold.expand(self.takes).reshape(-1)
        with torch.no_grad():
            found: Tensor = self.module.surrogate_grad_fn(excess + flat, flat)
        return found

    def numbers(self) -> Equation:
        """Return the present numbers."""
        module = self.module
        membrane, current = module.alpha_mem_calculated, module.alpha_syn_calculated
        gain = torch.ones((), dtype=torch.float64)
        if module.norm_input:
            gain = wide(1 - membrane)
        if current is not None:
            gain = gain * wide(current)
        return Equation(
            None if current is None else wide(current).clamp(0, 1),
            wide(membrane).clamp(0, 1),
            wide(module.spike_threshold) if self.has_spikes else None,
            None,
            gain,
        )
