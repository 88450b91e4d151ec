"""The arithmetic of Xylo: events added one by one, states that saturate, decays by shifts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from spikedeploy.runtime.chips.arithmetic import (
    ArithmeticDefaults,
    Description,
    refuse_convention,
)
from spikedeploy.runtime.chips.layer import Layer, LayerState, Network, Numbers, StepResult
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.xylo.layers import check_output, xylo_layers
from spikedeploy.runtime.families.xylo.neurons import XyloRegisters, update
from spikedeploy.runtime.families.xylo.quantise import quantise


@dataclass(frozen=True)
class XyloArithmetic(XyloRegisters, ArithmeticDefaults):
    """The integers of Xylo's cores; its fields are those of XyloRegisters."""

    choices: ClassVar[tuple[str, ...]] = ("granularity", "rounding")
    time_model: ClassVar[str | None] = "xylo-clocks"

    @property
    def input_spikes_max(self) -> int:
        """Spikes of an input channel in a timestep."""
        return self.events_max

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its currents and its membrane."""
        return (self.state.bits,) * (self.currents + 1)

    def check_convention(self, convention: Convention, chip_name: str) -> None:
        """Refuse a floor; how often neurons spike is the chip's own, and a remark."""
        if convention.floor != "none":
            refuse_convention(convention, chip_name)

    def check_quantisation(self, quantisation: Quantisation, chip_name: str) -> None:
        """Refuse choices that Xylo does not have."""
        quantisation.only(chip_name, *self.choices)
        if not 0 <= (shift := quantisation.weight_shift) <= self.shift_max:
            raise ConfigError(f"weight_shift is {shift}; choose 0 to {self.shift_max} bits.")

    def prepare(
        self,
        layers: Sequence[Layer],
        network_input: str,
        convention: Convention,
        delay: int,
        stagger: bool | None,
    ) -> tuple[list[Layer], list[str]]:
        """The float layers with dashes for decays, and remarks on what is not as in the file."""
        return xylo_layers(layers, network_input, self, convention, stagger)

    def check_output(self, network: Network, chip_name: str) -> None:
        """Refuse to read neurons that are no output population."""
        check_output(network, self, chip_name)

    def quantise(
        self,
        network: Network,
        quantisation: Quantisation,
        chip_name: str,
        timesteps: int | None,
        limits: bool,
    ) -> Sequence[Layer]:
        """The float layers as Xylo's integers."""
        return quantise(network, self, quantisation)

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        return update(self, network, layer, presynaptic, state)

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        bits = f"{self.weight_bits} bits with the sign"
        return Description("CuBa-LIF, event by event", bits, self.state.describe())
