"""Neurons of Norse."""

import importlib
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.runtime.convention import Reset
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_network import Map, Weights
from spikedeploy.trainers.torch_neurons.adapter import (
    Meaning,
    Numbers,
    TorchNeurons,
    derivative_of,
    largest,
    wide,
)


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
        resets: dict[str, Reset] = {"reset_value": "zero", "reset_subtract": "subtract"}
        reset = resets.get(method, "zero") if self.has_spikes else "none"
        own = takes if not hasattr(module, "input_weights") else (len(module.input_weights),)
        super().__init__(module, own, Meaning(reset, "above", f"Norse's {kind}"))
        self._takes_in = takes
        if method not in resets:
            raise self.refused(f"reset_method {method} is unknown", f"Take {' or '.join(resets)}.")
        for name, value in p._asdict().items():  # so that what is learnt is seen to change
            if isinstance(value, nn.Parameter):
                self.register_parameter(f"p_{name}", value)
            elif isinstance(value, Tensor):
                self.register_buffer(f"p_{name}", value, persistent=False)
        if self.has_spikes and getattr(p, "method", "adjoint") not in ("adjoint", "heaviside"):
            threshold = importlib.import_module("norse.torch.functional.threshold").threshold
            self.derivative = derivative_of(lambda x: threshold(x, module.p.method, module.p.alpha))
        self.numbers()

    def numbers(self) -> Numbers:
        """Return the fields of Equation."""
        p = self.module.p
        rest = wide(p.v_leak if hasattr(p, "v_leak") else p.v_reset)
        if not self.has_spikes or self.meaning.reset == "subtract":
            if rest.any():
                raise self.refused(
                    f"v_leak goes to {largest(rest):g}, where its membranes start",
                    "On a chip they start at 0: leave v_leak at 0.",
                )
        elif (rest != wide(p.v_reset)).any():
            raise self.refused(
                f"membranes start at v_leak, up to {largest(rest):g}, and are reset to v_reset, "
                f"up to {largest(wide(p.v_reset)):g}",
                "On a chip both are 0: give both one value, from which the threshold is counted.",
            )
        membrane, current = self._rate("tau_mem_inv"), self._rate("tau_syn_inv")
        unit = torch.ones((), dtype=torch.float64)
        return (
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

    def inputs(self) -> Map | None:
        """Return the input weights of LIFRecurrent and LILinear."""
        weight = getattr(self.module, "input_weights", None)
        return None if weight is None else Weights(linear(weight), self._takes_in)

    def recurrent(self) -> Map | None:
        """Return the recurrent weights of LIFRecurrent."""
        weight = getattr(self.module, "recurrent_weights", None)
        return None if weight is None else Weights(linear(weight), self.takes)


def linear(weight: Tensor) -> nn.Linear:
    """Return a layer without a bias that shares its weight."""
    layer = nn.Linear(weight.shape[1], weight.shape[0], bias=False, device="meta")
    layer.weight = weight if isinstance(weight, nn.Parameter) else nn.Parameter(weight, False)
    return layer
