"""A network as Xylo has it, still in floats: populations, dashes, biases and time.

In each timestep of a neuron, with a = 1 - 2**-dash_syn and b = 1 - 2**-dash_mem:

    I = a (I + w x)        NIR:  I = a I + w x
    V = b V + I + bias     NIR:  V = b V + I, a bias of an Affine goes into I

A current on Xylo has decayed before it is used, so weights are divided by a; membranes then mean
the same in both.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, Network, Synapses
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.xylo.neurons import XyloRegisters

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
    current, membrane = _dashes(layer, registers, convention)
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


def _dashes(
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
    """Why layers that start one after another would not be what Xylo does."""
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
    """What of a layer is not as the file has it."""
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
    current, membrane = _dashes(layer, registers, convention)
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
