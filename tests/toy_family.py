"""A family of chips that the package does not know: leaky integrators with membranes of 6 bits.

V = V - (V >> 2)            rounded down
V = V + w s                 one source after another, saturating at 6 bits each time
fires where V > threshold: V = 0
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from spikedeploy.runtime.chips.arithmetic import ArithmeticDefaults, Description
from spikedeploy.runtime.chips.layer import StepResult
from spikedeploy.runtime.chips.registers import Register, round_values


@dataclass(frozen=True)
class LeakySixBits(ArithmeticDefaults):
    """Weights of few bits that saturate a narrow membrane, one source after another."""

    weight_bits: int
    membrane: Register
    spikes_max: ClassVar[int] = 1

    @property
    def state_bits(self):
        return (self.membrane.bits,)

    def quantise(self, network, quantisation, timesteps, limits):
        rounding = quantisation.rounding or "nearest"
        most = (1 << (self.weight_bits - 1)) - 1
        return [self._quantised(layer, most, rounding) for layer in network.layers]

    def update(self, network, layer, presynaptic, state):
        before = state.membrane
        membrane, lost = before - (before >> 2), 0
        for synapses, spikes in zip(layer.synapses, presynaptic, strict=True):
            arrived = spikes.astype(np.int64) @ synapses.weight.astype(np.int64)
            membrane, over = self.membrane.fit_counted(membrane + arrived)
            lost = lost + over
        spikes = membrane > layer.threshold
        state.membrane = np.where(spikes, 0, membrane)
        return StepResult(spikes, (before != 0) | (membrane != 0), lost)

    def describe(self):
        weights = f"{self.weight_bits} bits with the sign"
        return Description("LIF, leak by a shift", weights, self.membrane.describe())

    def _quantised(self, layer, most, rounding):
        scale = most / max(np.abs(s.weight).max() for s in layer.synapses)
        zeros = np.zeros(layer.size, np.int64)
        return replace(
            layer,
            synapses=tuple(
                replace(s, weight=round_values(s.weight * scale, rounding).astype(np.int16))
                for s in layer.synapses
            ),
            bias=zeros,
            voltage_bias=zeros,
            threshold=np.minimum(
                round_values(layer.threshold * scale, rounding), self.membrane.limit
            ),
            current_decay=zeros,
            membrane_decay=zeros + 2,
            scale=1 / scale,
        )
