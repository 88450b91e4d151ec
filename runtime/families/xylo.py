"""Xylo's neurons: events added one by one, states that saturate, decays by shifts.

`XyloArithmetic.update` is the specification, equal to SynSense's simulator xylosim. In each
timestep of a neuron, with a = 1 - 2**-dash_syn and b = 1 - 2**-dash_mem:

    I = a (I + w x)        NIR:  I = a I + w x
    V = b V + I + bias     NIR:  V = b V + I, a bias of an Affine goes into I

A current on Xylo has decayed before it is used, so weights are divided by a; membranes then mean
the same in both.

Weights become 8 bits, as in rockpool's `global_quantize` and `channel_quantize`: a scale makes the
largest weight or bias of a population, or the largest weight of a neuron, 127; where a threshold
then does not fit 16 bits, the scale is what makes it fit. Hidden and output neurons have scales of
their own.

Three things of rockpool 3.1.0 are not taken over: `global_quantize` scales the biases of outputs by
the hidden scale, and recurrent weights once more where the outputs' thresholds do not fit;
`channel_quantize` leaves biases unscaled where neurons have one synapse.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import (
    ArithmeticDefaults,
    Description,
    check_weights_left,
    refuse_convention,
)
from spikedeploy.runtime.chips.layer import (
    NEVER,
    Layer,
    LayerState,
    Network,
    Numbers,
    StepResult,
    Synapses,
    first_arrivals,
)
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.chips.registers import (
    Register,
    Rounding,
    round_values,
    shift_decay,
)
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, RuleError

Floats = NDArray[np.float64]
Read = Literal["output", "any"]

# a time constant that is off by more than this part of it is remarked on
_NOTABLE = 0.01


@dataclass(frozen=True)
class XyloArithmetic(ArithmeticDefaults):
    """The integers of Xylo's cores: leaky integrators that spike several times in a timestep.

    weight_bits: of a weight, with the sign.
    shift_max: weights may be shifted left by so much.
    dash_max: a state x loses x >> dash in each timestep, and at least 1; largest dash.
    currents: synaptic currents of a neuron, each with weights and a dash of its own.
    state: every current, membrane and threshold.
    leak: what decay adds to a membrane, before it is added.
    events_max: input events of a channel in a timestep; more are lost.
    spikes_max: spikes of a neuron in a timestep.
    output_spikes_max: spikes of an output neuron in a timestep.
    read: neurons whose spikes the host receives: those of the "output" population, or "any", hidden
        ones too, as a simulator lets one.
    """

    weight_bits: int
    shift_max: int
    dash_max: int
    currents: int
    state: Register
    leak: Register
    events_max: int
    spikes_max: int
    output_spikes_max: int
    read: Read = "output"
    backends: ClassVar[Mapping[str, str]] = {
        "numba": "spikedeploy.runtime.families.numba_xylo:XyloPipeline",
    }
    choices: ClassVar[tuple[str, ...]] = ("granularity", "rounding", "weight_shift")
    time_model: ClassVar[str | None] = "xylo-clocks"

    @property
    def weight_max(self) -> int:
        """Largest weight of either sign that quantising makes."""
        return int((1 << (self.weight_bits - 1)) - 1)

    @property
    def input_spikes_max(self) -> int:
        """Spikes of an input channel in a timestep."""
        return self.events_max

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its currents and its membrane."""
        return (self.state.bits,) * (self.currents + 1)

    @property
    def threshold_range(self) -> tuple[int, int]:
        """Step and largest threshold [state units]."""
        return 1, self.state.limit

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        bits = f"{self.weight_bits} bits with the sign"
        return Description("CuBa-LIF, event by event", bits, self.state.describe())

    # a timestep

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
        current, lost = self._add_events(network, layer, presynaptic, state.current)
        # I = I - dec(I)      V = V + (sum I - dec(V) + bias)      each sum as its register holds it
        current = current - shift_decay(current, layer.current_decay)
        # the lowest membrane with a dash of 0 leaks what does not fit: it stays (xylosim)
        leak = self.leak.fit(-shift_decay(state.membrane, layer.membrane_decay))
        change, low = self.state.fit_counted(current.sum(axis=1) + leak)
        change, turned = self.state.fit_counted(change + layer.voltage_bias)
        membrane, high = self.state.fit_counted(state.membrane + change)
        spikes = np.zeros(membrane.shape, np.int64)
        if layer.spiking:
            is_output = layer.name == network.output and network.output_apart
            most = self.output_spikes_max if is_output else self.spikes_max
            spikes, membrane = _spikes(layer, membrane, most)
        active = (state.membrane != 0) | current.any(axis=1) | (layer.voltage_bias != 0)
        state.current, state.membrane = current, membrane
        return StepResult(spikes, active, lost + low + turned + high)

    def _add_events(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], current: Numbers
    ) -> tuple[Numbers, NDArray[np.int64]]:
        """The currents (B, K, N) after the events, axon by axon, and how many saturated."""
        current, lost = current.copy(), np.zeros((len(current), layer.size), np.int64)
        for synapses, counts in zip(layer.synapses, presynaptic, strict=True):
            weight, fed = synapses.weight.astype(np.int64), synapses.current
            events = counts.astype(np.int64)
            if synapses.source == network.input:
                events = events.clip(max=self.events_max)
            if (np.abs(current[:, fed]) + events @ np.abs(weight)).max() <= self.state.limit:
                # no partial sum can saturate, and so their order does not matter
                current[:, fed] += events @ weight
                continue
            for b, axon in np.argwhere(events):
                for _ in range(events[b, axon]):
                    raised, over = self.state.fit_counted(current[b, fed] + weight[axon])
                    current[b, fed], lost[b] = raised, lost[b] + over
        return current, lost

    # from floats to the chip

    def check_convention(self, convention: Convention, chip_name: str) -> None:
        """Refuse a floor; the number of spikes per timestep is the chip's, which is remarked."""
        if convention.floor != "none":
            refuse_convention(convention, chip_name)

    def check_quantisation(self, quantisation: Quantisation, chip_name: str) -> None:
        """Refuse choices that Xylo lacks."""
        super().check_quantisation(quantisation, chip_name)
        if not 0 <= (shift := quantisation.weight_shift) <= self.shift_max:
            raise ConfigError(f"weight_shift is {shift}; choose 0 to {self.shift_max} bits.")

    def check_output(self, network: Network) -> None:
        """Refuse to read other neurons than outputs, which have hidden ones alone for sources."""
        if self.read == "output" and not network.output_apart:
            raise RuleError(
                f"rule outputs: layer {network.output!r} is no output population of "
                f"{network.chip_name}. The output is read from it, and output neurons are "
                "connected to hidden neurons only, not to the input, nor to each other, and are "
                "presynaptic to none. Put a spiking layer behind it, or read hidden neurons, as a "
                "simulator lets one, with read='any' of the chip."
            )

    def prepare(
        self, layers: Sequence[Layer], source: str, convention: Convention, delay: int, waits: bool
    ) -> tuple[list[Layer], list[str]]:
        """The float layers with dashes for decays, and remarks on what is not as in the file.

        waits: start each layer when the first spikes can reach it, where that changes nothing but
            when to look; elsewhere all start at once, and a remark says so.
        """
        remarks = []
        if convention.spikes != "many":
            remarks.append(
                "neurons of Xylo spike at their threshold and above, up to "
                f"{self.spikes_max} times in a timestep; the convention says "
                f"{convention.spikes!r}, once"
            )
        starts = dict.fromkeys((layer.name for layer in layers), 0)
        why = ""
        if waits:
            # the input itself arrives at once
            delays = {a.name: [int(s.source != source) for s in a.synapses] for a in layers}
            staggered = first_arrivals(layers, source, delays)
            why = _obstacle(layers, source, staggered)
            if why:
                late = max(staggered.values())
                why += f"; all layers start at once, and outputs come {late} rows late"
            else:
                starts = staggered
        sources, found = (source, *(layer.name for layer in layers)), []
        for layer in layers:
            current = self._dashes(layer.name, "current", layer.current_decay, convention)
            # 0 would forget events before they are used
            current = np.maximum(current, 1)
            membrane = self._dashes(layer.name, "membrane", layer.membrane_decay, convention)
            remarks += _remarks(layer, current, membrane, convention)
            # sum of a^k from k = 1 is a/(1-a) on Xylo; from k = 0 it is 1/(1-a) in NIR
            left = 0.5**current
            gain = np.asarray(left / (1 - left) / (1 - layer.current_decay))
            ready = replace(
                layer,
                synapses=tuple(_synapses(layer, sources, gain)),
                bias=np.zeros(layer.size),
                # what the current adds in every timestep once it has settled
                voltage_bias=layer.voltage_bias + layer.bias / (1 - layer.current_decay),
                current_decay=current[None],
                membrane_decay=membrane,
                start=starts[layer.name],
            )
            found.append(ready)
        return found, [*remarks, *filter(None, [why])]

    def _dashes(
        self, name: str, of: str, decay_factor: Floats, convention: Convention
    ) -> NDArray[np.int64]:
        exact = _octaves(decay_factor, convention)
        if (far := exact > self.dash_max + 0.5).any():
            raise RuleError(
                f"rule decay-range: layer {name!r}: a {of} that keeps "
                f"{decay_factor[far].max():.6g} of itself in a timestep needs a shift (dash) of "
                f"{exact[far].max():.3g}; Xylo has {self.dash_max}, and none without a leak. "
                "Choose a shorter time constant, or a longer dt."
            )
        return np.asarray(np.rint(exact), np.int64)

    def quantise(
        self, network: Network, quantisation: Quantisation, timesteps: int | None, limits: bool
    ) -> Sequence[Layer]:
        """The float layers as Xylo's integers.

        quantisation: "layer" is one scale for all hidden neurons and one for all outputs, "channel"
            one for each neuron, which a spike without size allows; rounding is to the nearest by
            itself.
        """
        one = 1 << quantisation.weight_shift
        each = quantisation.granularity == "channel"
        scales = {a.name: self._largest_scales(a, one, not each) for a in network.layers}
        if not each:
            outputs = {network.output} if network.output_apart else set()
            for population in filter(None, (scales.keys() - outputs, outputs)):
                least = min(scales[name].min() for name in population)
                scales |= {name: np.full(scales[name].shape, least) for name in population}
        rounding = quantisation.rounding or "nearest"
        return [self._quantise(a, scales[a.name], rounding, one) for a in network.layers]

    def _largest_scales(self, layer: Layer, one: int, biases_too: bool) -> Floats:
        """(N,) largest weights per float unit at which weights, biases and thresholds fit.

        one: state units that a weight of 1 is worth.
        biases_too: whether biases, which have 16 bits, are to be no larger than weights all the
            same.
        """
        if layer.threshold.min() <= 0:
            raise RuleError(
                f"rule threshold-range: layer {layer.name!r}: threshold {layer.threshold.min():g}; "
                "a membrane of Xylo at rest would spike without end. Train with positive "
                "thresholds."
            )
        bias = np.abs(layer.voltage_bias)
        weight = np.concatenate([np.abs(s.weight) for s in layer.synapses]).max(axis=0, initial=0.0)
        largest = np.maximum(weight, bias) if biases_too else weight
        wide = self.state.limit / one
        threshold = layer.threshold if layer.spiking else 0 * largest
        with np.errstate(divide="ignore"):
            scales = self.weight_max / largest, wide / threshold, wide / bias
        return np.asarray(np.min(scales, axis=0))

    def _quantise(self, layer: Layer, scale: Floats, rounding: Rounding, one: int) -> Layer:
        def whole(weight: Floats) -> NDArray[np.int32]:
            held = round_values(weight * scale, rounding).clip(-self.weight_max, self.weight_max)
            return (held * one).astype(np.int32)

        synapses = tuple(replace(s, weight=whole(s.weight)) for s in layer.synapses)
        states = scale * one
        threshold = np.full(layer.size, NEVER)
        if layer.spiking:
            threshold = round_values(layer.threshold * states, rounding)
        if (lost := threshold < 1).any():
            raise RuleError(
                f"rule threshold-range: layer {layer.name!r}: threshold "
                f"{layer.threshold[lost].min():g} becomes 0 beside the largest weight or bias, and "
                "a membrane at rest would spike without end. Clip the weights, raise the "
                "threshold, or give each channel a scale."
            )
        check_weights_left(
            layer,
            synapses,
            "beside a threshold, a bias or the weights of another layer. Give each channel a "
            "scale, or scale the weights up.",
        )
        return replace(
            layer,
            synapses=synapses,
            bias=np.zeros(layer.size, np.int64),
            voltage_bias=round_values(layer.voltage_bias * states, rounding),
            threshold=threshold,
            scale=layer.scale / (states[0] if np.ptp(states) == 0 else states),
        )


def _spikes(layer: Layer, membrane: Numbers, most: int) -> tuple[Numbers, Numbers]:
    """Spikes (B, N) of the membranes, and what they leave of them; at most so many of a neuron."""
    budget = np.full(membrane.shape, most)
    if not layer.aliases:
        return _fire(membrane, layer.threshold, budget)
    membrane, spikes = membrane.copy(), 0 * budget
    for n, others in enumerate(layer.aliases):
        # spikes that were counted for a neuron before its turn use up its budget
        left = budget[:, n] - spikes[:, n]
        own, membrane[:, n] = _fire(membrane[:, n], layer.threshold[n], left)
        spikes[:, n] += own
        for other in others:
            spikes[:, other] = np.minimum(spikes[:, other] + spikes[:, n], most)
    return spikes, membrane


def _fire(membrane: Numbers, threshold: Numbers, budget: Numbers) -> tuple[Numbers, Numbers]:
    """Return spikes while the membrane holds a threshold to subtract, and the rest of it."""
    spikes = 0 * budget
    for _ in range(budget.max()):
        fires = (membrane >= threshold) & (spikes < budget)
        if not fires.any():
            break
        spikes, membrane = spikes + fires, membrane - threshold * fires
    return spikes, membrane


def _synapses(layer: Layer, sources: Sequence[str], gain: Floats) -> Iterator[Synapses]:
    """One matrix for each source, in the order in which the chip delivers events.

    sources: the input, then the layers.
    gain: (N,) times which a spike adds up to as much current as in the file.
    """
    for source in sources:
        from_input = source == sources[0]
        presynaptic = [synapses for synapses in layer.synapses if synapses.source == source]
        # the host may hold the input back; the chip takes one timestep
        for delay in sorted({s.delay if from_input else 1 for s in presynaptic}):
            arriving = [s for s in presynaptic if not from_input or s.delay == delay]
            weights = [s.dense("Xylo").weight for s in arriving]
            yield Synapses(source, gain * np.sum(weights, axis=0), delay)


def _octaves(decay_factor: Floats, convention: Convention) -> Floats:
    """Return log2(tau/dt), at least 0, for a factor that is kept in a timestep."""
    with np.errstate(divide="ignore"):
        lost = -np.log(decay_factor) if convention.integrator == "exponential" else 1 - decay_factor
        return np.asarray(np.maximum(-np.log2(lost), 0.0))


def _obstacle(layers: Sequence[Layer], network_input: str, starts: dict[str, int]) -> str:
    """The reason why layers cannot start one after another on Xylo; "" where they can."""
    for layer in layers:
        name = layer.name
        if starts[name] and (layer.bias.any() or layer.voltage_bias.any()):
            return f"layer {name!r} has a bias, which Xylo adds from the first timestep on"
        for synapses in layer.synapses:
            lag = synapses.delay
            due = starts[name] - starts[synapses.source] + lag
            if due != (lag if synapses.source == network_input else 1):
                return f"{synapses.source!r} -> {name!r} would need a delay of {due} on Xylo"
    return ""


def _remarks(
    layer: Layer,
    current: NDArray[np.int64],
    membrane: NDArray[np.int64],
    convention: Convention,
) -> Iterator[str]:
    """Deviations of a layer with these dashes (N,) from the file."""
    if layer.current_decay.any() and layer.bias.any():
        yield (
            f"layer {layer.name!r}: its bias is added to the membrane, from the first timestep "
            "what it comes to through the current once that has settled"
        )
    if not layer.current_decay.all():
        yield (
            f"layer {layer.name!r}: it has no synaptic current; on Xylo it has the shortest, which "
            "halves in each timestep, and spreads a spike over the next"
        )
    there = layer.current_decay > 0
    for of, decay_factor, dash in (
        ("current", layer.current_decay[there], current[there]),
        ("membrane", layer.membrane_decay, membrane),
    ):
        # time constants in timesteps, of which the one that changes most is remarked on
        wanted, held = np.exp2(_octaves(decay_factor, convention)), np.exp2(dash)
        ratios = np.abs(np.log(held / wanted))
        if ratios.max(initial=0.0) >= _NOTABLE:
            worst = int(ratios.argmax())
            yield (
                f"layer {layer.name!r}: the {of}'s time constant of {wanted[worst]:.3g} timesteps "
                f"becomes {held[worst]:g}, a power of two"
            )
