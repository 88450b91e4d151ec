"""The compiler: an artifact becomes the program of a chip."""

import nir
import numpy as np
from numpy.typing import NDArray

from runtime.artifact import Artifact
from runtime.chip import Chip
from runtime.convention import Convention
from runtime.discrete import Discrete, discretise
from runtime.errors import RuleError
from runtime.headroom import with_headroom
from runtime.program import Layer, Program, Readout, Synapses
from runtime.quantisation import PLAIN, Quantisation
from runtime.quantize import quantise
from runtime.wiring import Wire, Wiring, wiring


def compile(
    artifact: Artifact,
    chip: Chip,
    quantisation: Quantisation = PLAIN,
    stagger: bool | None = None,
) -> Program:
    """The artifact as a program of the chip.

    quantisation: of weights, biases, thresholds and decays.
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
    wires = wiring(artifact.graph)
    if stagger is None:
        stagger = artifact.convention.delay == 0
    starts = _starts(wires, chip.delay if stagger else 0)
    delay = max(chip.delay, 0 if stagger else artifact.convention.delay)
    floats = [_layer(artifact, wires, name, starts, delay) for name in wires.layers]
    fixed, layers = chip.fixed, floats
    if fixed is not None:
        layers = [quantise(layer, fixed, quantisation) for layer in floats]
    program = Program(
        chip=chip,
        convention=artifact.convention,
        input=wires.input,
        width=wires.width,
        layers=tuple(layers),
        output=wires.output,
        readout=_readout(wires.readout, artifact.convention.delay),
    )
    if fixed is not None and quantisation.headroom == "proven":
        return with_headroom(program, floats, fixed, quantisation, _window(artifact))
    return program


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
        ahead = [wire.source for wire in wires.wires[name] if not wire.late]
        starts[name] = max((starts[source] for source in ahead), default=0) + delay
    return starts


def _layer(
    artifact: Artifact, wires: Wiring, name: str, starts: dict[str, int], delay: int
) -> Layer:
    """A layer in floats; gains of the neuron are folded into the weights, which is exact."""
    neuron = discretise(name, artifact.graph.nodes[name], artifact.convention)
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
    """Delay of a connection: skips wait for the layers they skip, feedback takes one row more."""
    ahead = starts[target] - starts.get(wire.source, 0)
    if not wire.late:
        return max(delay, ahead)
    if ahead + 1 < delay:
        raise RuleError(
            f"layers {wire.source!r} -> {target!r}: the feedback would have to arrive "
            f"{delay - ahead - 1} timesteps before it can. Compile with stagger=False, which "
            "lengthens every loop by the delays of its layers."
        )
    return max(ahead + 1, delay)


def _window(artifact: Artifact) -> int | None:
    """T of an inference; None where it is not known or states go on from one to the next."""
    reset = artifact.convention.state == "reset"
    return artifact.codec.timesteps if artifact.codec is not None and reset else None


def _readout(node: nir.NIRNode | None, lag: int) -> Readout | None:
    if node is None:
        return None
    weight = np.ascontiguousarray(node.weight.T, dtype=np.float64)
    bias = node.bias if isinstance(node, nir.Affine) else np.zeros(weight.shape[1])
    return Readout(weight, bias.astype(np.float64), lag)
