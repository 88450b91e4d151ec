"""The arithmetic of chips that add spikes straight to the membrane, without a synaptic current."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from spikedeploy.runtime.chips.arithmetic import ArithmeticDefaults, Description
from spikedeploy.runtime.chips.layer import (
    Layer,
    LayerState,
    Network,
    Numbers,
    StepResult,
)
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.integrate_and_fire.neurons import update
from spikedeploy.runtime.families.integrate_and_fire.quantise import check_axons, quantise
from spikedeploy.runtime.families.integrate_and_fire.rules import IntegrateAndFireRules
from spikedeploy.runtime.families.integrate_and_fire.spike_queue import update_together

_LEAKS = {
    "none": "IF",
    "linear": "IF, linear leak",
    "crossing": "IF, linear leak",
    "shift": "LIF, leak by a shift",
}
# sources of the options of a queue, on chips without one
WITHOUT_QUEUE = {
    "queue": "none between neurons was found in any source that was read",
    "queue_entries": "there is no queue",
    "host": "there is no queue",
}
_RELAYED = (
    "spikes from neuron to neuron are relayed by the host (queue 'off'), those of a timestep by "
    "index; the chip's own queue is emulated with queue=on"
)
_QUEUED = (
    "spikes from neuron to neuron go through the chip's queue, and arrive in the same timestep"
)
_SOONER = "; those of recurrent neurons one timestep sooner than in the file"


@dataclass(frozen=True)
class IntegrateAndFire(IntegrateAndFireRules, ArithmeticDefaults):
    """The integers of integrate-and-fire neurons; its fields are those of IntegrateAndFireRules."""

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its membrane."""
        return (self.membrane.bits,)

    @property
    def weights_have_signs(self) -> bool:
        """Whether one of a weight's bits is its sign; else its axon has it."""
        return self.signs == "weight"

    @property
    def own_weights(self) -> bool:
        """Whether every synapse has a weight of its own."""
        return self.axon_types == 0

    @property
    def threshold_range(self) -> tuple[int, int]:
        """Step and largest threshold [state units]."""
        return 1, self.threshold_max

    @property
    def spikes_at_threshold(self) -> bool:
        """Whether a neuron spikes where its membrane is the threshold, and not only above it."""
        return self.fires == "reached"

    @property
    def together(self) -> bool:
        """Whether all layers advance as one, because spikes reach others in the same timestep."""
        return self.queue == "on"

    def prepare(
        self,
        layers: Sequence[Layer],
        network_input: str,
        convention: Convention,
        delay: int,
        stagger: bool,
    ) -> tuple[list[Layer], list[str]]:
        """The float layers with starts and delays, and remarks on what is not as in the file."""
        if self.together and delay:
            raise ConfigError(
                f"queue is 'on' and delay {delay}: spikes from the queue arrive in the same "
                "timestep. Leave the delay at 0, or choose queue 'off'."
            )
        return super().prepare(layers, network_input, convention, delay, stagger)

    def input_delay(self, delay: int) -> int:
        """Delay of the network's input [timesteps]: a late reset makes neurons' spikes late."""
        return 0 if self.reset_at == "leak" else delay

    def carried(self, layers: Sequence[Layer], network_input: str) -> list[str]:
        """Who brings spikes from neuron to neuron, on a chip with a queue for them."""
        inside = [s for layer in layers for s in layer.synapses if s.source != network_input]
        if not (self.queue_entries and inside):
            return []
        if not self.together:
            return [_RELAYED]
        late = any(s.delay for s in inside)
        return [_QUEUED + (_SOONER if late else "")]

    def check_convention(self, convention: Convention, chip_name: str) -> None:
        """Refuse spikes and floors that the chip's neurons have not."""
        if convention.spikes == "many" and self.spikes_max == 1:
            raise RuleError(
                f"rule convention: spikes 'many': a neuron on {chip_name} sends at most one in a "
                "timestep. Run in float, or choose spikes 'above'."
            )
        if convention.floor not in self.floors:
            raise RuleError(
                f"rule convention: floor {convention.floor!r}: membranes on {chip_name} can have "
                f"{', '.join(map(repr, self.floors))}. Choose one of them, or run in float."
            )

    def quantise(
        self,
        network: Network,
        quantisation: Quantisation,
        chip_name: str,
        timesteps: int | None,
        limits: bool,
    ) -> Sequence[Layer]:
        """The float layers as integers that the chip's axons can carry."""
        rounding = quantisation.rounding
        layers = [quantise(layer, chip_name, self, rounding, limits) for layer in network.layers]
        if limits:
            check_axons(layers, chip_name, self)
        return layers

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        return update(self, network.convention, layer, presynaptic, state)

    def update_together(
        self,
        network: Network,
        presynaptic: Mapping[str, Sequence[Numbers]],
        states: Mapping[str, LayerState],
    ) -> Mapping[str, StepResult]:
        """Advance all layers by one timestep, in which these spikes (B, M) of the input arrive."""
        return update_together(self, network, presynaptic, states)

    def before_reset(
        self,
        layer: Layer,
        convention: Convention,
        current: Numbers,
        membrane: Numbers,
        spikes: Numbers,
    ) -> Numbers:
        """Membranes (B, T, N) before a spike reset them [state units]; NaN where none can tell."""
        if self.reset_at == "leak":
            return membrane
        return super().before_reset(layer, convention, current, membrane, spikes)

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        each = ", event by event" if self.adds == "event" else ""
        signs = "and the axon's sign" if self.signs == "axon" else "with the sign"
        types = f", {self.axon_types} a neuron" if self.axon_types else ""
        return Description(
            f"{_LEAKS[self.leak]}{each}",
            f"{self.weight_bits} bits {signs}{types}",
            self._membrane(),
        )

    def _membrane(self) -> str:
        described = self.membrane.describe()
        if self.floor != 0:
            return described
        _, _, overflow = described.partition(", ")
        return f"{self.membrane.bits - 1} bits unsigned, {overflow}"
