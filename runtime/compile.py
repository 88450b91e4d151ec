"""The compiler: an artifact becomes the program of a chip."""

import numpy as np
from numpy.typing import NDArray

from runtime.artifact import Artifact
from runtime.chip import Chip
from runtime.convention import Convention
from runtime.discrete import Discrete, discretise
from runtime.errors import RuleError
from runtime.outlets import Outlet
from runtime.program import Layer, Program, Readout, Synapses
from runtime.quantize import Rounding, quantise
from runtime.wiring import Wire, Wiring, wiring


def compile(
    artifact: Artifact, chip: Chip, rounding: Rounding = "nearest", stagger: bool | None = None
) -> Program:
    """The artifact as a program of the chip.

    rounding: of weights, biases, thresholds and decays, as in quantise.
    stagger: start each layer, and so its biases, when the first spikes can reach it: a network then
        means the same with delays as without. False starts all at once, as lava does. None staggers
        unless the convention itself has a delay.
    """
    _check_reset(artifact.convention, chip)
    if chip.events is not None:
        raise RuleError(
            f"{chip.name}: networks cannot be compiled for it yet, only traces of it replayed. "
            "Choose another chip."
        )
    wires = wiring(artifact.graph, artifact.convention)
    if stagger is None:
        stagger = artifact.convention.delay == 0
    starts = _starts(wires, chip.delay if stagger else 0)
    layers = [_layer(artifact, wires, name, starts, chip.delay) for name in wires.layers]
    if chip.fixed is not None:
        layers = [quantise(layer, chip.fixed, rounding) for layer in layers]
    output, readout, outlets = _ways_out(wires, artifact.convention)
    return Program(
        chip=chip,
        convention=artifact.convention,
        input=wires.input,
        width=wires.width,
        layers=tuple(layers),
        output=output,
        readout=readout,
        inputs=wires.inputs,
        outputs=tuple(outlet.port for outlet in wires.outlets),
        outlets=outlets,
    )


def _check_reset(convention: Convention, chip: Chip) -> None:
    if convention.reset not in chip.resets:
        raise RuleError(
            f"reset {convention.reset!r}: a spike on {chip.name} can only do "
            f"{', '.join(map(repr, chip.resets))}. Train with that reset, or run in float."
        )
    if convention.spikes != "above" or convention.floor != "none":
        raise RuleError(
            f"spikes {convention.spikes!r}, floor {convention.floor!r}: a neuron on {chip.name} "
            "sends one spike where its membrane is above the threshold, and its membrane has no "
            "floor. Run in float."
        )


def _starts(wires: Wiring, delay: int) -> dict[str, int]:
    """Timestep at which each layer can first hear of the input; slower paths decide."""
    starts = {wires.input: 0}
    for name in wires.layers:
        # sources that come later, or the layer itself, are feedback
        ahead = [wire for wire in wires.wires[name] if wire.source in starts]
        starts[name] = max(
            (starts[wire.source] + max(0, delay - wire.lag) for wire in ahead), default=0
        )
    return starts


def _layer(
    artifact: Artifact, wires: Wiring, name: str, starts: dict[str, int], delay: int
) -> Layer:
    """A layer in floats; gains of the neuron are folded into the weights, which is exact."""
    neuron = discretise(name, artifact.graph.nodes[name], artifact.convention).in_a_row()
    threshold = _threshold(name, neuron)
    keep = neuron.current_decay
    return Layer(
        name=name,
        synapses=tuple(
            Synapses(
                source=wire.source,
                weight=wire.weight * neuron.gain,
                delay=_delay(wire, name, starts, delay),
            )
            for wire in wires.wires[name]
        ),
        bias=wires.bias[name] * neuron.gain,
        voltage_bias=neuron.leak,
        threshold=threshold,
        current_keep=np.zeros_like(threshold) if keep is None else keep,
        membrane_keep=neuron.membrane_decay,
        scale=1.0,
        start=starts[name],
    )


def _threshold(name: str, neuron: Discrete) -> NDArray[np.float64]:
    if neuron.threshold is None or neuron.v_reset.any():
        raise RuleError(
            f"layer {name!r}: v_reset goes to {neuron.v_reset.max():g}; on a chip a spike resets "
            "the membrane to 0. Shift it, or run in float."
        )
    return neuron.threshold


def _delay(wire: Wire, target: str, starts: dict[str, int], delay: int) -> int:
    """Delay of a connection: skips wait for the layers they skip, feedback takes its lag more."""
    due = starts[target] - starts[wire.source] + wire.lag
    if due < delay and any(starts.values()):
        raise RuleError(
            f"layers {wire.source!r} -> {target!r}: the feedback would have to arrive "
            f"{delay - due} timesteps before it can. Compile with stagger=False, which "
            "lengthens every loop by the delays of its layers."
        )
    return max(due, delay)


def _ways_out(
    wires: Wiring, convention: Convention
) -> tuple[str, Readout | None, tuple[Outlet, ...]]:
    """The layer that leaves the chip and its readout; outlets where there is more than that."""
    taps = [tap for outlet in wires.outlets for tap in outlet.taps]
    first, outlet = taps[0], wires.outlets[0]
    if len(taps) == 1:
        plain = first.weight is None and not first.lag and not outlet.bias.any()
        weight = np.eye(outlet.port.size) if first.weight is None else first.weight
        return first.layer, None if plain else Readout(weight, outlet.bias, first.lag), ()
    if convention.state == "kept" and any(tap.lag for tap in taps):
        raise RuleError(
            f"node {outlet.port.name!r}: it hears several layers, some of them late, while states "
            "are kept. Remove the delay before it, or choose state 'reset'."
        )
    return first.layer, None, wires.outlets
