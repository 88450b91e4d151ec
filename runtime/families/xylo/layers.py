"""A network as Xylo has it, still in floats: populations, dashes, biases and time.

In each timestep of a neuron, with a = 1 - 2**-dash_syn and b = 1 - 2**-dash_mem:

    I = a (I + w x)        NIR:  I = a I + w x
    V = b V + I + bias     NIR:  V = b V + I, a bias of an Affine goes into I

A current on Xylo has decayed before it is used, so weights are divided by a; membranes then mean
the same in both.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Layer, Program, Synapses
from spikedeploy.runtime.compiler.wiring import LayerGraph
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.xylo.arithmetic import XyloArithmetic

Floats = NDArray[np.float64]

# a time constant that is off by more than this part of it is worth a remark
NOTABLE = 0.01


def as_held(
    wires: LayerGraph,
    layers: list[Layer],
    point: XyloArithmetic,
    convention: Convention,
    stagger: bool | None,
) -> tuple[list[Layer], list[str]]:
    """The float layers with dashes for decays, and what of them is not as the file has it.

    stagger: as in compile; None staggers where it changes nothing but when to look.
    """
    remarks = [*_spike_remarks(point, convention)]
    for layer in layers:
        remarks += _remarks(layer, point, convention)
    starts, why = _starts(wires, layers, convention, stagger)
    held = [_held(layer, point, wires, convention, starts[layer.name]) for layer in layers]
    return held, remarks + why


def check_output(program: Program, point: XyloArithmetic) -> None:
    """Only output neurons are read, and they hear hidden neurons alone."""
    if point.read == "output" and not program.output_apart:
        raise RuleError(
            f"rule outputs: layer {program.output!r} is no output population of "
            f"{program.chip.name}. The output is read from it, and output neurons hear hidden "
            "neurons only: not the input, nor each other, and nobody hears them. Put a spiking "
            "layer behind it, or read hidden neurons, as a simulator lets one, with read='any' of "
            "the chip."
        )


def _held(
    layer: Layer, point: XyloArithmetic, wires: LayerGraph, convention: Convention, start: int
) -> Layer:
    keep, (current, membrane) = layer.current_decay, _dashes(layer, point, convention)
    return replace(
        layer,
        synapses=tuple(_synapses(layer, wires, _gain(keep, current))),
        bias=np.zeros(layer.size),
        # what the current adds in every timestep once it has settled
        voltage_bias=layer.voltage_bias + layer.bias / (1 - keep),
        current_decay=current[None],
        membrane_decay=membrane,
        start=start,
    )


def _gain(keep: Floats, dash: NDArray[np.int64]) -> Floats:
    """(N,) times which a spike adds up to as much current as in the file."""
    # sum of a^k from k = 1 is a/(1-a) on Xylo; from k = 0 it is 1/(1-a) in NIR
    left = 0.5**dash
    return np.asarray(left / (1 - left) / (1 - keep))


def _synapses(layer: Layer, wires: LayerGraph, gain: Floats) -> Iterator[Synapses]:
    """One matrix for each source, in the order in which the chip delivers events."""
    for source in (wires.input, *wires.layers):
        presynaptic = [synapses for synapses in layer.synapses if synapses.source == source]
        # the host may hold the input back; the chip takes one timestep
        for delay in sorted({s.delay if source == wires.input else 1 for s in presynaptic}):
            weights = [s.weight for s in presynaptic if source != wires.input or s.delay == delay]
            yield Synapses(source, gain * np.sum(weights, axis=0), delay)


def _dashes(
    layer: Layer, point: XyloArithmetic, convention: Convention
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(N,) of the currents, at least 1 as 0 forgets events before they are used; of membranes."""
    current = _dash(layer.name, "current", layer.current_decay, point, convention)
    membrane = _dash(layer.name, "membrane", layer.membrane_decay, point, convention)
    return np.maximum(current, 1), membrane


def _dash(
    name: str, of: str, keep: Floats, point: XyloArithmetic, convention: Convention
) -> NDArray[np.int64]:
    exact = _octaves(keep, convention)
    if (far := exact > point.dash_max + 0.5).any():
        raise RuleError(
            f"rule decay-range: layer {name!r}: a {of} that keeps {keep[far].max():.6g} of itself "
            f"in a timestep needs a shift (dash) of {exact[far].max():.3g}; Xylo has "
            f"{point.dash_max}, and none without a leak. Choose a shorter time constant, or a "
            "longer dt."
        )
    return np.asarray(np.rint(exact), np.int64)


def _octaves(keep: Floats, convention: Convention) -> Floats:
    """log2(tau/dt), at least 0, of what keeps so much of itself in a timestep."""
    with np.errstate(divide="ignore"):
        share = -np.log(keep) if convention.integrator == "exponential" else 1 - keep
        return np.asarray(np.maximum(-np.log2(share), 0.0))


def _starts(
    wires: LayerGraph, layers: list[Layer], convention: Convention, stagger: bool | None
) -> tuple[dict[str, int], list[str]]:
    """When layers start, and what to say of it."""
    at_once = dict.fromkeys(wires.layers, 0)
    if stagger is False or (stagger is None and convention.delay):
        return at_once, []
    starts = _depths(wires)
    found = _obstacle(wires, layers, starts)
    if found is None:
        return starts, []
    rule, obstacle = found
    if stagger:
        raise RuleError(f"rule {rule}: {obstacle}. Compile with stagger=False.")
    late = max(starts[name] for name in wires.layers)
    return at_once, [f"{obstacle}; all layers start at once, and outputs come {late} rows late"]


def _depths(wires: LayerGraph) -> dict[str, int]:
    """Timestep in which each layer can first hear of the input, which itself arrives at once."""
    starts: dict[str, int] = {}
    for name in wires.layers:
        # sources that come later, or the layer itself, are feedback
        ahead = [wire for wire in wires.wires[name] if wire.source in starts]
        starts[name] = max((starts[w.source] + max(0, 1 - w.lag) for w in ahead), default=0)
    return starts


def _obstacle(
    wires: LayerGraph, layers: list[Layer], starts: dict[str, int]
) -> tuple[str, str] | None:
    """Why layers that start one after another would not be what Xylo does: the rule, in words."""
    for layer in layers:
        name = layer.name
        if starts[name] and (layer.bias.any() or layer.voltage_bias.any()):
            return "bias", f"layer {name!r} has a bias, which Xylo adds from the first timestep on"
        for wire in wires.wires[name]:
            due = starts[name] - starts.get(wire.source, 0) + wire.lag
            if due != (wire.lag if wire.source == wires.input else 1):
                return "delay", f"{wire.source!r} -> {name!r} would need a delay of {due} on Xylo"
    return None


def _spike_remarks(point: XyloArithmetic, convention: Convention) -> Iterator[str]:
    if convention.spikes != "many":
        yield (
            f"neurons of Xylo spike at their threshold and above, up to {point.spikes_max} times "
            f"in a timestep; the convention says {convention.spikes!r}, once"
        )


def _remarks(layer: Layer, point: XyloArithmetic, convention: Convention) -> Iterator[str]:
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
    current, membrane = _dashes(layer, point, convention)
    there = layer.current_decay > 0
    for of, keep, dash in (
        ("current", layer.current_decay[there], current[there]),
        ("membrane", layer.membrane_decay, membrane),
    ):
        yield from _rounding(layer.name, of, np.exp2(_octaves(keep, convention)), np.exp2(dash))


def _rounding(name: str, of: str, wanted: Floats, held: Floats) -> Iterable[str]:
    """A remark on the time constant, in timesteps, that changes most."""
    if not wanted.size:
        return []
    ratios = np.abs(np.log(held / wanted))
    worst = int(ratios.argmax())
    if ratios[worst] < NOTABLE:
        return []
    return [
        f"layer {name!r}: the {of}'s time constant of {wanted[worst]:.3g} timesteps becomes "
        f"{held[worst]:g}, a power of two"
    ]
