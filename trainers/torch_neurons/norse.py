"""Neurons of Norse."""

import importlib
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.runtime.convention import Reset
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_network import Equation, Weights
from spikedeploy.trainers.torch_neurons.adapter import TorchNeurons, derivative_of, largest, wide

_RESETS: dict[str, Reset] = {"reset_value": "zero", "reset_subtract": "subtract"}


class NorseNeurons(TorchNeurons):
    """Norse 1.1.0: LIF, LIFBox, IAF, LI and LIBox, as cells and over time, some with weights.

    With f = dt / tau, I[t] = (1 - f_syn) I[t-1] + x[t] and V[t] = V[t-1] + f_mem (v_leak - V[t-1]
    + I[t]); spikes above v_th (functional/lif.py, lif_box.py, iaf.py, leaky_integrator.py). V
    starts at v_leak, and is counted from there.
    """

    def __init__(self, module: Any, takes: Shape) -> None:  # noqa: ANN401
        kind, p = type(module).__name__, module.p
        self.has_spikes = hasattr(p, "v_th")
        self.takes_time = kind in ("LIF", "LI", "LIFRecurrent", "IAF")
        method = getattr(getattr(p, "reset_method", None), "__name__", "reset_value")
        reset = _RESETS.get(method, "zero") if self.has_spikes else "none"
        own = takes if not hasattr(module, "input_weights") else (len(module.input_weights),)
        super().__init__(module, own, f"Norse's {kind}", reset)
        self._takes_in = takes
        if method not in _RESETS:
            raise self.refused(f"reset_method {method} is unknown", f"Take {' or '.join(_RESETS)}.")
        for name, value in p._asdict().items():  # so that what is learnt is seen to change
            if isinstance(value, nn.Parameter):
                self.register_parameter(f"p_{name}", value)
            elif isinstance(value, Tensor):
                self.register_buffer(f"p_{name}", value, persistent=False)
        if self.has_spikes and getattr(p, "method", "adjoint") not in ("adjoint", "heaviside"):
            threshold = importlib.import_module("norse.torch.functional.threshold").threshold
            self.derivative = derivative_of(lambda x: threshold(x, module.p.method, module.p.alpha))
        self.numbers()

    def numbers(self) -> Equation:
        """Return the present numbers."""
        p = self.module.p
        rest = wide(p.v_leak if hasattr(p, "v_leak") else p.v_reset)
        resets_to_rest = self.has_spikes and self.convention.reset == "zero"
        wanted = wide(p.v_reset) if resets_to_rest else torch.zeros_like(rest)
        if (rest != wanted).any():
            raise self.refused(
                f"its membranes start at v_leak, up to {largest(rest):g}, and return to "
                f"{'v_reset' if resets_to_rest else 'another value'}, up to {largest(wanted):g}",
                "On a chip both are 0: give v_leak and v_reset one value, which is 0 where a spike "
                "subtracts or none is sent.",
            )
        membrane, current = self._rate("tau_mem_inv"), self._rate("tau_syn_inv")
        unit = torch.ones((), dtype=torch.float64)
        return Equation(
            None if current is None else (1 - current).clamp(0, 1),
            unit if membrane is None else (1 - membrane).clamp(0, 1),
            wide(p.v_th) - rest if self.has_spikes else None,
            None,
            unit if membrane is None else membrane,
        )

    def _rate(self, name: str) -> Tensor | None:
        """Return dt / tau in the precision that Norse has it in; None where there is no tau."""
        value = getattr(self.module.p, name, None)
        if value is None:
            return None
        rate = wide(self.module.dt * value)
        if not bool(((rate >= 0) & (rate <= 1)).all()):
            raise self.refused(
                f"dt {name} is up to {largest(rate):g}, and forward Euler overshoots above 1",
                "Make dt shorter, or the time constant longer.",
            )
        return rate

    def inputs(self) -> Weights | None:
        """Return the input weights of LIFRecurrent and LILinear."""
        return self._weights("input_weights", self._takes_in)

    def recurrent(self) -> Weights | None:
        """Return the recurrent weights of LIFRecurrent."""
        return self._weights("recurrent_weights", self.takes)

    def _weights(self, name: str, takes: Shape) -> Weights | None:
        """Return a layer without a bias that shares its weight with the module."""
        weight = getattr(self.module, name, None)
        if weight is None:
            return None
        layer = nn.Linear(weight.shape[1], weight.shape[0], bias=False, device="meta")
        layer.weight = weight if isinstance(weight, nn.Parameter) else nn.Parameter(weight, False)
        return Weights(layer, takes)
