"""The integer CuBa-LIF arithmetic of Loihi."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import ArithmeticDefaults, Description
from spikedeploy.runtime.chips.layer import Layer, LayerState, Network, Numbers, StepResult
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.chips.registers import decay
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.bounds import with_headroom
from spikedeploy.runtime.families.cuba.neurons import (
    CubaRegisters,
    arriving,
    sigma_delta,
    update,
)
from spikedeploy.runtime.families.cuba.quantise import quantise
from spikedeploy.runtime.families.cuba.readouts import range_of

# from rounded weights to the chip, each with those before it
_ROUNDING_STEPS = ("weights", "thresholds", "decays", "states")
# of lava's neurons
_GRADED_BITS = 24


@dataclass(frozen=True)
class CubaFixedPoint(CubaRegisters, ArithmeticDefaults):
    """The integer CuBa-LIF arithmetic of a chip; its fields are those of CubaRegisters."""

    backends: ClassVar[Mapping[str, str]] = {
        "numpy": "spikedeploy.runtime.families.cuba_numpy.pipeline:NumpyPipeline",
        "numba": "spikedeploy.runtime.families.cuba_numba.pipeline:NumbaPipeline",
    }
    spikes_max: ClassVar[int] = 1
    choices: ClassVar[tuple[str, ...]] = (
        "granularity",
        "rounding",
        "headroom",
        "thresholds",
        "tuned",
    )
    spikes_and_floor: ClassVar[tuple[str, str] | None] = ("above", "none")
    ablation_steps: ClassVar[tuple[str, ...]] = _ROUNDING_STEPS

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its current and its membrane."""
        return self.current.bits, self.membrane.bits

    @property
    def weights_have_signs(self) -> bool:
        """Whether one of a weight's bits is its sign; else its list has it."""
        return self.sign_mode == "mixed"

    def input_delay(self, delay: int) -> int:
        """Delay of the network's input [timesteps], that of spikes or none."""
        return delay if self.input_acts == "next" else 0

    @property
    def threshold_range(self) -> tuple[int, int]:
        """Step and largest threshold [state units]."""
        return 1 << self.mantissa_shift, self.threshold_max << self.mantissa_shift

    @property
    def weight_lists(self) -> int:
        """Lists that hold the weights of an axon: 2 where each sign has its own."""
        return 2 if self.sign_mode == "split" else 1

    def with_one_list(self) -> "CubaFixedPoint | None":
        """The same with weights of both signs in one list; None where that is no choice."""
        if self.sign_mode != "split" or self.weight_bits < 2:
            return None
        return replace(self, sign_mode="mixed")

    def quantise(
        self,
        network: Network,
        quantisation: Quantisation,
        chip_name: str,
        timesteps: int | None,
        limits: bool,
    ) -> Sequence[Layer]:
        """The float layers as integers, with as much headroom as is asked for."""
        if quantisation.headroom == "proven":
            _refuse_graded(network)
            return with_headroom(self, network, quantisation, timesteps)
        return [quantise(layer, self, quantisation) for layer in network.layers]

    def ranges(self, layers: Sequence[Layer], timesteps: int | None) -> list[str]:
        """Of quantised layers that their leaks do not bound what registers hold, a sentence each.

        timesteps: T of an inference; None where it is not known, or states are kept.
        """
        drifts = not any(layer.graded for layer in layers)
        found = [range_of(layer, self, timesteps, drifts) for layer in layers]
        return [sentence for sentence in found if sentence]

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        return update(self, network.convention, layer, arriving(layer, presynaptic), state)

    def partly_rounded(self, before: Layer, after: Layer, step: str) -> Layer:
        """The layer in float64 and state units, rounded up to one of the ablation steps."""
        units, one = 1.0 / after.scale, float(1 << self.mantissa_shift)
        thresholds, decays = step != "weights", step == "decays"
        return replace(
            after,
            synapses=tuple(
                replace(s, weight=s.weight.astype(np.float64) * one) for s in after.synapses
            ),
            bias=after.bias * one,
            threshold=after.threshold.astype(np.float64)
            if thresholds
            else before.threshold * units,
            voltage_bias=after.voltage_bias * 1.0 if thresholds else before.voltage_bias * units,
            current_decay=after.current_decay / self.decay_one if decays else before.current_decay,
            membrane_decay=after.membrane_decay / self.decay_one
            if decays
            else before.membrane_decay,
        )

    def before_reset(
        self,
        layer: Layer,
        convention: Convention,
        current: Numbers,
        membrane: Numbers,
        spikes: Numbers,
    ) -> Numbers:
        """Membranes (B, T, N) before a spike reset them, computed once more [state units]."""
        # v = b v + (u + bias)      each as its register holds it
        push = self.push.fit(current + layer.voltage_bias)
        factor = layer.membrane_decay.astype(np.int64)
        return self.membrane.fit(decay(_one_step_later(membrane), factor, self.decay_bits) + push)

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        signs = "with the sign" if self.sign_mode == "mixed" else "and sign"
        return Description("CuBa-LIF", f"{self.weight_bits} bits {signs}", self.membrane.describe())


@dataclass(frozen=True)
class CubaGradedSpikes(CubaFixedPoint):
    """The same where neurons can also be sigma-delta neurons, which send graded spikes.

    Of 24 bits with the sign, as lava keeps them (lava-nc 0.10.0, proc.sdn, source read); 32 by
    public statements on Loihi 2 (Orchard et al. 2021, IEEE SiPS). That the chip's microcode counts
    thresholds is derived, and measured on no board.
    """

    graded_bits: ClassVar[int | None] = _GRADED_BITS

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        if layer.graded:
            weights = arriving(layer, presynaptic)
            return sigma_delta(self, _GRADED_BITS, layer, weights, state)
        return super().update(network, layer, presynaptic, state)


def _refuse_graded(network: Network) -> None:
    for layer in network.layers:
        if layer.graded:
            raise RuleError(
                f"rule headroom: layer {layer.name!r}: nothing bounds its graded spikes, so no "
                "scale is proven to hold their sums. Choose headroom 'none'."
            )


def _one_step_later(states: NDArray[Any]) -> NDArray[Any]:
    """States (B, T, N) of the timestep before, from zero."""
    return np.concatenate([np.zeros_like(states[:, :1]), states[:, :-1]], axis=1)
