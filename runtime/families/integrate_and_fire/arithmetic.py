"""The arithmetic of chips that add spikes straight to the membrane, without a synaptic current.

All numbers of a layer are multiplied by one scale: as large as weights, biases and the threshold
allow. What a network has that these neurons do not is refused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import (
    ArithmeticDefaults,
    Description,
    check_thresholds,
    check_weights_left,
)
from spikedeploy.runtime.chips.layer import (
    Layer,
    LayerState,
    Network,
    Numbers,
    Recording,
    StepResult,
)
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.chips.registers import Rounding, round_values
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.integrate_and_fire.event_queues import update_by_events
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules, update
from spikedeploy.runtime.families.integrate_and_fire.spike_queue import update_together

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# the shift of a membrane that does not leak
_NO_LEAK = -1
_LINEAR = (
    "{chip} takes the same amount away in each timestep. Train with IF neurons, or compile with "
    "limits off, which takes away what is lost half-way to the threshold."
)
# remedies where neurons do not leak as the chip's do
_REMEDIES = {
    "none": "{chip} has no leak. Train with IF neurons.",
    "linear": _LINEAR,
    "crossing": _LINEAR,
    "shift": "every neuron on {chip} leaks by a shift; none without was found. Train with LIF "
    "neurons, or compile with limits off.",
}


def check_axon_types(layers: Sequence[Layer], chip_name: str, rules: IntegrateAndFireRules) -> None:
    """Refuse weights that need more types of axons than the chip has."""
    for layer in layers if rules.axon_types else ():
        found = axon_types(
            np.concatenate([s.dense("a core of typed axons").weight for s in layer.synapses])
        )
        if found > rules.axon_types:
            raise RuleError(
                f"rule axon-types: layer {layer.name!r}: its weights need {found} types of axons, "
                f"put into the first that fits; {chip_name} has {rules.axon_types}, and each "
                "neuron one weight for each. Train with fewer different weights, or compile with "
                "limits off."
            )


def axon_types(weight: NDArray[Any]) -> int:
    """Types of axons that the weights (M, N) need, each axon put into the first that it fits.

    Axons fit together where every neuron that both reach gives them the same weight. First-fit may
    find more types than the best choice would.
    """
    types: list[NDArray[Any]] = []
    for row in weight:
        for held in types:
            if not ((row != 0) & (held != 0) & (row != held)).any():
                np.copyto(held, row, where=held == 0)
                break
        else:
            types.append(row.copy())
    return len(types)


def _check_neurons(
    layer: Layer, chip_name: str, rules: IntegrateAndFireRules, limits: bool
) -> None:
    """Refuse neurons with a current, or with another leak than the chip's, in floats.

    limits: False lets a leak pass that the chip has something near for.
    """
    if layer.current_decay.any():
        raise RuleError(
            f"rule primitive: layer {layer.name!r} has a synaptic current that keeps "
            f"{layer.current_decay.max():.3g} of itself; {chip_name} adds spikes to the membrane. "
            "Train with LIF or IF neurons."
        )
    other = (layer.membrane_decay == 1) == (rules.leak == "shift")
    if other.any() and (rules.leak == "none" or limits):
        raise RuleError(
            f"rule decay-range: layer {layer.name!r} keeps "
            f"{layer.membrane_decay[other].min():.3g} of its membrane; "
            f"{_REMEDIES[rules.leak].format(chip=chip_name)}"
        )


def _check_events(layers: Sequence[Layer], network_input: str) -> None:
    """Refuse what has no place where layers work on queues of events."""
    earlier = {network_input}
    for layer in layers:
        if layer.bias.any() or layer.voltage_bias.any():
            raise RuleError(
                f"rule bias: layer {layer.name!r} has biases; event by event nothing says when "
                "they are added. Train with bias=False, or choose queue 'off', which adds them in "
                "each timestep."
            )
        for synapses in layer.synapses:
            if synapses.source not in earlier or synapses.delay:
                raise RuleError(
                    f"rule recurrence: layers {synapses.source!r} -> {layer.name!r}: event by "
                    "event a spike arrives at once and reaches layers behind its own alone. Take "
                    "the loop or the delay out, or choose queue 'off'."
                )
        earlier.add(layer.name)


def quantise(
    layer: Layer,
    chip_name: str,
    rules: IntegrateAndFireRules,
    rounding: Rounding | None,
    limits: bool,
) -> Layer:
    """The float layer as the chip's integers.

    rounding: None is the chip's own.
    limits: False emulates a leak that the chip lacks by the nearest that it has.
    """
    _check_neurons(layer, chip_name, rules, limits)
    rounding = rounding or rules.rounding
    bias = layer.bias + layer.voltage_bias
    scale = _scale(layer, bias, rules)
    whole_bias = np.clip(round_values(bias * scale, rounding), *rules.bias_range)
    nothing = np.zeros_like(whole_bias)
    quantised = replace(
        layer,
        synapses=tuple(
            # clipping only catches a last bit of the scale
            replace(
                s,
                weight=round_values(s.weight * scale, rounding)
                .clip(*rules.weight_range)
                .astype(np.int16),
            )
            for s in layer.synapses
        ),
        bias=nothing if rules.bias_bits else whole_bias,
        voltage_bias=whole_bias if rules.bias_bits else nothing,
        threshold=_threshold(layer, chip_name, scale, rules, rounding, limits),
        current_decay=nothing,
        membrane_decay=_quantise_leak(layer, rules, scale, rounding),
        scale=layer.scale / scale,
    )
    check_weights_left(
        layer,
        quantised.synapses,
        f"on {chip_name} beside its threshold, {layer.threshold.max():g}, or its bias. Scale the "
        "weights up, or the others down.",
    )
    return quantised


def _scale(layer: Layer, bias: Floats, rules: IntegrateAndFireRules) -> float:
    """Factor that makes the largest weight, bias or threshold the largest that fits."""
    ranges = [
        *((s.weight, *rules.weight_range) for s in layer.synapses),
        (bias, *rules.bias_range),
        (layer.threshold, 0, rules.threshold_max),
    ]
    scale = np.inf
    for values, low, high in ranges:
        top, bottom = float(values.max(initial=0.0)), float(values.min(initial=0.0))
        above = high / top if top > 0 else np.inf
        below = low / bottom if bottom < 0 and low < 0 else np.inf
        scale = min(scale, above, below)
    if not np.isfinite(scale):
        return 1.0
    return float(2.0 ** np.floor(np.log2(scale))) if rules.scaling == "binary" else float(scale)


def _threshold(
    layer: Layer,
    chip_name: str,
    scale: float,
    rules: IntegrateAndFireRules,
    rounding: Rounding,
    limits: bool,
) -> Integers:
    whole = np.minimum(round_values(layer.threshold * scale, rounding), rules.threshold_max)
    if not limits:
        whole = np.where((whole == 0) & (layer.threshold > 0), 1, whole)
    why = (
        f"beside the largest weight, which has {rules.weight_bits} bits on {chip_name}. Clip the "
        "weights, raise the threshold, or compile with limits off."
    )
    return np.asarray(check_thresholds(layer, whole, why))


def _quantise_leak(
    layer: Layer, rules: IntegrateAndFireRules, scale: float, rounding: Rounding
) -> Integers:
    """(N,) amounts, or shifts."""
    lost = 1 - layer.membrane_decay
    if rules.leak == "shift":
        with np.errstate(divide="ignore"):
            # shift = int(|log2(1 - beta)|)
            shift = np.abs(np.log2(lost))
        return np.where(lost > 0, np.minimum(np.trunc(shift), rules.leak_max), _NO_LEAK).astype(int)
    # leak = (1 - beta) threshold / 2
    amount = round_values(lost * layer.threshold * scale / 2, rounding)
    return np.minimum(amount, rules.leak_max)


_EVENTS = "spikedeploy.runtime.families.integrate_and_fire.event_machine:EventPipeline"
_TIMESTEPS = "spikedeploy.runtime.families.integrate_and_fire.numba_steps:IntegrateAndFirePipeline"
_LEAKS = {
    "none": "IF",
    "linear": "IF, linear leak",
    "crossing": "IF, linear leak",
    "shift": "LIF, leak by a shift",
}
_RELAYED = (
    "spikes from neuron to neuron are relayed by the host (queue 'off'), those of a timestep by "
    "index; the chip's own queue is emulated with queue=on"
)
_QUEUED = (
    "spikes from neuron to neuron go through the chip's queue, and arrive in the same timestep"
)
_BY_EVENTS = (
    "events go from layer to layer one by one, no neuron sends more than {most} for an event, and "
    "those of one event leave in the order {order!r}, which is assumed"
)
IN_TIMESTEPS = (
    "in timesteps, as the vendor's tools compute it; the chip itself works event by event: "
    "queue=on, and --step event where --events are its input (docs/chip-models.md#speck)"
)
_SOONER = "; those of recurrent neurons one timestep sooner than in the file"


@dataclass(frozen=True)
class IntegrateAndFire(IntegrateAndFireRules, ArithmeticDefaults):
    """The integers of integrate-and-fire neurons; its fields are those of IntegrateAndFireRules."""

    @property
    def backends(self) -> Mapping[str, str]:
        """Name -> "module:class" of each backend, besides the interpreter, that has kernels."""
        if self.all_at_once and not self.by_events:
            return {}
        return {"numba": _EVENTS if self.by_events else _TIMESTEPS}

    @property
    def input_spikes_max(self) -> int:
        """Spikes of an input channel in a timestep; counts on a chip without timesteps."""
        return 1 if self.event_order == "none" else self.spikes_max

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its membrane."""
        return (self.membrane.bits,)

    @property
    def weights_have_signs(self) -> bool:
        """True where one of a weight's bits is its sign; else its axon has it."""
        return self.signs == "weight"

    @property
    def own_weights(self) -> bool:
        """True where every synapse has a weight of its own."""
        return self.axon_types == 0

    @property
    def threshold_range(self) -> tuple[int, int]:
        """Step and largest threshold [state units]."""
        return 1, self.threshold_max

    @property
    def spikes_at_threshold(self) -> bool:
        """True where a membrane equal to the threshold spikes, not only one above it."""
        return self.fires == "reached"

    @property
    def all_at_once(self) -> bool:
        """True where all layers advance as one: spikes reach others in the same timestep."""
        return self.queue == "on"

    def prepare(
        self, layers: Sequence[Layer], source: str, convention: Convention, delay: int, waits: bool
    ) -> tuple[list[Layer], list[str]]:
        """The float layers with starts and delays, and remarks on what is not as in the file."""
        if self.all_at_once and delay:
            raise ConfigError(
                f"queue is 'on' and delay {delay}: spikes from the queue arrive in the same "
                "timestep. Leave the delay at 0, or choose queue 'off'."
            )
        if self.by_events:
            _check_events(layers, source)
        return super().prepare(layers, source, convention, delay, waits)

    def input_delay(self, delay: int) -> int:
        """Delay of the network's input [timesteps]: a late reset makes neurons' spikes late."""
        return 0 if self.reset_at == "leak" else delay

    def transport_remarks(self, layers: Sequence[Layer], network_input: str) -> list[str]:
        """A remark on what carries spikes between neurons, on a chip with a queue for them."""
        if self.by_events:
            most = 1 if self.event_spikes == "single" else self.spikes_max
            return [_BY_EVENTS.format(most=most, order=self.event_order)]
        if self.event_order != "none":
            return [IN_TIMESTEPS]
        inside = [s for layer in layers for s in layer.synapses if s.source != network_input]
        if not (self.queue_entries and inside):
            return []
        if not self.all_at_once:
            return [_RELAYED]
        late = any(s.delay for s in inside)
        return [_QUEUED + (_SOONER if late else "")]

    def check_convention(self, convention: Convention, chip_name: str) -> None:
        """Refuse spikes and floors that the chip's neurons lack."""
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
        self, network: Network, quantisation: Quantisation, timesteps: int | None, limits: bool
    ) -> Sequence[Layer]:
        """The float layers as integers that the chip's axons can carry."""
        rounding, chip_name = quantisation.rounding, network.chip_name
        layers = [quantise(layer, chip_name, self, rounding, limits) for layer in network.layers]
        if limits:
            check_axon_types(layers, chip_name, self)
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
        together = update_by_events if self.by_events else update_together
        return together(self, network, presynaptic, states)

    def before_reset(self, layer: Layer, convention: Convention, ran: Recording) -> Numbers:
        """Membranes (B, T, N) before a spike reset them [state units]; NaN where none can tell."""
        if self.reset_at == "leak":
            return ran.membrane
        return super().before_reset(layer, convention, ran)

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        each = ", event by event" if self.adds == "event" or self.by_events else ""
        signs = "and the axon's sign" if self.signs == "axon" else "with the sign"
        types = f", {self.axon_types} a neuron" if self.axon_types else ""
        membrane = self.membrane.describe()
        if self.floor == 0:
            membrane = f"{self.membrane.bits - 1} bits unsigned, {membrane.partition(', ')[2]}"
        weights = f"{self.weight_bits} bits {signs}{types}"
        return Description(f"{_LEAKS[self.leak]}{each}", weights, membrane)
