"""Xylo's neurons: events added one by one, states that saturate, decays by shifts.

`update` is the specification, equal to SynSense's simulator xylosim. In each timestep of a neuron,
with a = 1 - 2**-dash_syn and b = 1 - 2**-dash_mem:

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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.arithmetic import ArithmeticDefaults, Description, refuse_convention
from spikedeploy.runtime.chips.layer import (
    NEVER,
    Layer,
    LayerState,
    Network,
    Numbers,
    StepResult,
    Synapses,
)
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.chips.registers import (
    Register,
    Rounding,
    magnitude,
    round_values,
    shift_decay,
)
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, RuleError

Read = Literal["output", "any"]


@dataclass(frozen=True)
class XyloRegisters:
    """The registers of Xylo's cores: leaky integrators that spike several times in a timestep.

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

    @property
    def weight_max(self) -> int:
        """Largest weight of either sign that quantising makes."""
        return int((1 << (self.weight_bits - 1)) - 1)


def update(
    registers: XyloRegisters,
    network: Network,
    layer: Layer,
    presynaptic: Sequence[Numbers],
    state: LayerState,
) -> StepResult:
    """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
    current, lost = _add_events(registers, network, layer, presynaptic, state.current)
    # I = I - dec(I)      V = V + (sum I - dec(V) + bias)      each sum as its register holds it
    current = current - shift_decay(current, layer.current_decay)
    # the lowest membrane with a dash of 0 leaks what does not fit: it stays where it is (xylosim)
    leak = registers.leak.fit(-shift_decay(state.membrane, layer.membrane_decay))
    change, low = registers.state.fit_counted(current.sum(axis=1) + leak)
    change, turned = registers.state.fit_counted(change + layer.voltage_bias)
    membrane, high = registers.state.fit_counted(state.membrane + change)
    is_output = layer.name == network.output and network.output_apart
    most = registers.output_spikes_max if is_output else registers.spikes_max
    spikes = np.zeros(membrane.shape, np.int64)
    if layer.spiking:
        spikes, membrane = _spikes(layer, membrane, most)
    active = (state.membrane != 0) | current.any(axis=1) | (layer.voltage_bias != 0)
    state.current, state.membrane = current, membrane
    return StepResult(spikes, active, lost + low + turned + high)


def _add_events(
    registers: XyloRegisters,
    network: Network,
    layer: Layer,
    presynaptic: Sequence[Numbers],
    current: Numbers,
) -> tuple[Numbers, NDArray[np.int64]]:
    """The currents (B, K, N) after the events, axon by axon, and how many additions saturated."""
    current, lost = current.copy(), np.zeros((len(current), layer.size), np.int64)
    for synapses, counts in zip(layer.synapses, presynaptic, strict=True):
        weight, fed = synapses.weight.astype(np.int64), synapses.current
        events = counts.astype(np.int64)
        if synapses.source == network.input:
            events = events.clip(max=registers.events_max)
        if (np.abs(current[:, fed]) + events @ np.abs(weight)).max() <= registers.state.limit:
            # no partial sum can saturate, and so their order does not matter
            current[:, fed] += events @ weight
            continue
        for index, axon in np.argwhere(events):
            added = _add_axon(
                registers, current[index, fed], weight[axon], int(events[index, axon])
            )
            current[index, fed], over = added
            lost[index] += over
    return current, lost


def _add_axon(
    registers: XyloRegisters, current: Numbers, weight: Numbers, count: int
) -> tuple[Numbers, Numbers]:
    """Currents (N,) after so many events of one axon, and how many additions saturated."""
    if registers.state.overflow != "saturate" or registers.state.between:
        lost = np.zeros_like(current)
        for _ in range(count):
            current, over = registers.state.fit_counted(current + weight)
            lost = lost + over
        return current, lost
    low, high = -registers.state.limit - 1, registers.state.limit
    # additions of one weight saturate for good, so their order does not matter
    room = np.where(weight > 0, high - current, current - low)
    fitting = np.where(weight == 0, count, room // np.maximum(np.abs(weight), 1))
    return registers.state.fit(current + count * weight), (count - fitting).clip(min=0)


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
    """Spikes while there is a threshold to take off the membrane, and what is left of it."""
    spikes = 0 * budget
    for _ in range(budget.max()):
        fires = (membrane >= threshold) & (spikes < budget)
        if not fires.any():
            break
        spikes, membrane = spikes + fires, membrane - threshold * fires
    return spikes, membrane


Floats = NDArray[np.float64]

# a time constant that is off by more than this part of it is remarked on
_NOTABLE = 0.01


def xylo_layers(
    layers: Sequence[Layer],
    network_input: str,
    registers: XyloRegisters,
    convention: Convention,
    stagger: bool,
) -> tuple[list[Layer], list[str]]:
    """The float layers with dashes for decays, and what of them is not as the file has it.

    layers: with the lags of the graph for delays.
    stagger: start each layer when the first spikes can reach it, where that changes nothing but
        when to look; elsewhere all start at once, and a remark says so.
    """
    remarks = [*_spike_remarks(registers, convention)]
    for layer in layers:
        remarks += _remarks(layer, registers, convention)
    starts, why = _starts(layers, network_input, stagger)
    sources = (network_input, *(layer.name for layer in layers))
    found = [_layer(layer, registers, sources, convention, starts[layer.name]) for layer in layers]
    return found, remarks + why


def check_output(network: Network, registers: XyloRegisters, chip_name: str) -> None:
    """Refuse to read other neurons than outputs, which have hidden neurons alone for sources."""
    if registers.read == "output" and not network.output_apart:
        raise RuleError(
            f"rule outputs: layer {network.output!r} is no output population of "
            f"{chip_name}. The output is read from it, and output neurons are connected "
            "to hidden neurons only, not to the input, nor to each other, and are presynaptic to "
            "none. Put a spiking layer behind it, or read hidden neurons, as a simulator lets one, "
            "with read='any' of the chip."
        )


def _layer(
    layer: Layer,
    registers: XyloRegisters,
    sources: Sequence[str],
    convention: Convention,
    start: int,
) -> Layer:
    current, membrane = _decay_shifts(layer, registers, convention)
    return replace(
        layer,
        synapses=tuple(_synapses(layer, sources, _gain(layer.current_decay, current))),
        bias=np.zeros(layer.size),
        # what the current adds in every timestep once it has settled
        voltage_bias=layer.voltage_bias + layer.bias / (1 - layer.current_decay),
        current_decay=current[None],
        membrane_decay=membrane,
        start=start,
    )


def _gain(decay_factor: Floats, dash: NDArray[np.int64]) -> Floats:
    """(N,) times which a spike adds up to as much current as in the file."""
    # sum of a^k from k = 1 is a/(1-a) on Xylo; from k = 0 it is 1/(1-a) in NIR
    left = 0.5**dash
    return np.asarray(left / (1 - left) / (1 - decay_factor))


def _synapses(layer: Layer, sources: Sequence[str], gain: Floats) -> Iterator[Synapses]:
    """One matrix for each source, in the order in which the chip delivers events.

    sources: the input, then the layers.
    """
    for source in sources:
        from_input = source == sources[0]
        presynaptic = [synapses for synapses in layer.synapses if synapses.source == source]
        # the host may hold the input back; the chip takes one timestep
        for delay in sorted({s.delay if from_input else 1 for s in presynaptic}):
            weights = [s.weight for s in presynaptic if not from_input or s.delay == delay]
            yield Synapses(source, gain * np.sum(weights, axis=0), delay)


def _decay_shifts(
    layer: Layer, registers: XyloRegisters, convention: Convention
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(N,) of the currents, at least 1 as 0 forgets events before they are used; of membranes."""
    current = _dash(layer.name, "current", layer.current_decay, registers, convention)
    membrane = _dash(layer.name, "membrane", layer.membrane_decay, registers, convention)
    return np.maximum(current, 1), membrane


def _dash(
    name: str, of: str, decay_factor: Floats, registers: XyloRegisters, convention: Convention
) -> NDArray[np.int64]:
    exact = _octaves(decay_factor, convention)
    if (far := exact > registers.dash_max + 0.5).any():
        raise RuleError(
            f"rule decay-range: layer {name!r}: a {of} that keeps "
            f"{decay_factor[far].max():.6g} of itself in a timestep needs a shift (dash) of "
            f"{exact[far].max():.3g}; Xylo has {registers.dash_max}, and none without a leak. "
            "Choose a shorter time constant, or a longer dt."
        )
    return np.asarray(np.rint(exact), np.int64)


def _octaves(decay_factor: Floats, convention: Convention) -> Floats:
    """log2(tau/dt), at least 0, of what keeps so much of itself in a timestep."""
    with np.errstate(divide="ignore"):
        lost = -np.log(decay_factor) if convention.integrator == "exponential" else 1 - decay_factor
        return np.asarray(np.maximum(-np.log2(lost), 0.0))


def _starts(
    layers: Sequence[Layer], network_input: str, stagger: bool
) -> tuple[dict[str, int], list[str]]:
    """When layers start, and what to say of it."""
    at_once = {layer.name: 0 for layer in layers}
    if not stagger:
        return at_once, []
    starts = _depths(layers)
    found = _obstacle(layers, network_input, starts)
    if found is None:
        return starts, []
    late = max(starts.values())
    return at_once, [f"{found}; all layers start at once, and outputs come {late} rows late"]


def _depths(layers: Sequence[Layer]) -> dict[str, int]:
    """Timestep in which the input can first reach each layer; it itself arrives at once."""
    starts: dict[str, int] = {}
    for layer in layers:
        # sources that come later, or the layer itself, are feedback
        ahead = [s for s in layer.synapses if s.source in starts]
        starts[layer.name] = max((starts[s.source] + max(0, 1 - s.delay) for s in ahead), default=0)
    return starts


def _obstacle(layers: Sequence[Layer], network_input: str, starts: dict[str, int]) -> str | None:
    """The reason why layers cannot start one after another on Xylo; None where they can."""
    for layer in layers:
        name = layer.name
        if starts[name] and (layer.bias.any() or layer.voltage_bias.any()):
            return f"layer {name!r} has a bias, which Xylo adds from the first timestep on"
        for synapses in layer.synapses:
            lag = synapses.delay
            due = starts[name] - starts.get(synapses.source, 0) + lag
            if due != (lag if synapses.source == network_input else 1):
                return f"{synapses.source!r} -> {name!r} would need a delay of {due} on Xylo"
    return None


def _spike_remarks(registers: XyloRegisters, convention: Convention) -> Iterator[str]:
    if convention.spikes != "many":
        yield (
            "neurons of Xylo spike at their threshold and above, up to "
            f"{registers.spikes_max} times in a timestep; the convention says "
            f"{convention.spikes!r}, once"
        )


def _remarks(layer: Layer, registers: XyloRegisters, convention: Convention) -> Iterator[str]:
    """Deviations of a layer from the file."""
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
    current, membrane = _decay_shifts(layer, registers, convention)
    there = layer.current_decay > 0
    for of, decay_factor, dash in (
        ("current", layer.current_decay[there], current[there]),
        ("membrane", layer.membrane_decay, membrane),
    ):
        yield from _rounding(
            layer.name, of, np.exp2(_octaves(decay_factor, convention)), np.exp2(dash)
        )


def _rounding(name: str, of: str, wanted: Floats, held: Floats) -> Iterable[str]:
    """A remark on the time constant, in timesteps, that changes most."""
    if not wanted.size:
        return []
    ratios = np.abs(np.log(held / wanted))
    worst = int(ratios.argmax())
    if ratios[worst] < _NOTABLE:
        return []
    return [
        f"layer {name!r}: the {of}'s time constant of {wanted[worst]:.3g} timesteps becomes "
        f"{held[worst]:g}, a power of two"
    ]


def quantise(
    network: Network, registers: XyloRegisters, quantisation: Quantisation = PLAIN
) -> list[Layer]:
    """The float layers of the network as Xylo's integers.

    quantisation: "layer" is one scale for all hidden neurons and one for all outputs, "channel" one
        for each neuron, which a spike without size allows; rounding is to the nearest by itself.
    """
    one = 1 << quantisation.weight_shift
    scales = _scales(network, registers, quantisation.granularity, one)
    rounding = quantisation.rounding or "nearest"
    return [
        _quantise_layer(layer, scales[layer.name], registers, rounding, one)
        for layer in network.layers
    ]


def _scales(
    network: Network, registers: XyloRegisters, granularity: Granularity, one: int
) -> dict[str, Floats]:
    """Weights per float unit (N,) of each layer; a weight of 1 is worth so many state units."""
    biases_too = granularity == "layer"
    each = {
        layer.name: _largest_scales(layer, registers, one, biases_too) for layer in network.layers
    }
    if granularity == "channel":
        return each
    outputs = {network.output} if network.output_apart else set()
    common: dict[str, Floats] = {}
    for population in filter(None, (each.keys() - outputs, outputs)):
        least = min(each[name].min() for name in population)
        common |= {name: np.full(each[name].shape, least) for name in population}
    return common


def _largest_scales(layer: Layer, registers: XyloRegisters, one: int, biases_too: bool) -> Floats:
    """(N,) largest scale at which the weights, the bias and the threshold of each neuron fit.

    biases_too: whether biases, which have 16 bits, are to be no larger than weights all the same.
    """
    _check_thresholds(layer)
    bias = np.abs(layer.voltage_bias)
    weight = np.concatenate([np.abs(s.weight) for s in layer.synapses]).max(axis=0, initial=0.0)
    largest = np.maximum(weight, bias) if biases_too else weight
    wide = registers.state.limit / one
    threshold = layer.threshold if layer.spiking else 0 * largest
    with np.errstate(divide="ignore"):
        scales = registers.weight_max / largest, wide / threshold, wide / bias
    return np.asarray(np.min(scales, axis=0))


def _check_thresholds(layer: Layer) -> None:
    if layer.threshold.min() <= 0:
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold {layer.threshold.min():g}; a "
            "membrane of Xylo at rest would spike without end. Train with positive thresholds."
        )


def _quantise_layer(
    layer: Layer, scale: Floats, registers: XyloRegisters, rounding: Rounding, one: int
) -> Layer:
    synapses = tuple(_quantise_synapses(s, scale, registers, rounding, one) for s in layer.synapses)
    states = scale * one
    threshold = _threshold(layer, states, rounding)
    if (lost := threshold < 1).any():
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold "
            f"{layer.threshold[lost].min():g} becomes 0 beside the largest weight or bias, and a "
            "membrane at rest would spike without end. Clip the weights, raise the threshold, or "
            "give each channel a scale."
        )
    _check_alive(layer, synapses)
    return replace(
        layer,
        synapses=synapses,
        bias=np.zeros(layer.size, np.int64),
        voltage_bias=round_values(layer.voltage_bias * states, rounding),
        threshold=threshold,
        scale=layer.scale / (states[0] if np.ptp(states) == 0 else states),
    )


def _threshold(layer: Layer, states: Floats, rounding: Rounding) -> NDArray[np.int64]:
    if not layer.spiking:
        return np.full(layer.size, NEVER)
    return round_values(layer.threshold * states, rounding)


def _quantise_synapses(
    synapses: Synapses, scale: Floats, registers: XyloRegisters, rounding: Rounding, one: int
) -> Synapses:
    most = registers.weight_max
    weight = round_values(synapses.weight * scale, rounding).clip(-most, most)
    return replace(synapses, weight=(weight * one).astype(np.int32))


def _check_alive(layer: Layer, quantised: Sequence[Synapses]) -> None:
    """A layer with weights must not lose all of them to its threshold or to another layer."""
    before = max(magnitude(s.weight) for s in layer.synapses)
    if before > 0 and not any(s.weight.any() for s in quantised):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
            f"{before:g}, is too small beside a threshold, a bias or the weights of another layer. "
            "Give each channel a scale, or scale the weights up."
        )


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

    @property
    def threshold_range(self) -> tuple[int, int]:
        """Step and largest threshold [state units]."""
        return 1, self.state.limit

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
        stagger: bool,
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
