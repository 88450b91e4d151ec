"""The compiler: an artifact becomes the program of a chip."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.compiler.program import HostOutput, Layer, Program, Readout, Synapses
from spikedeploy.runtime.compiler.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.quantise import quantised
from spikedeploy.runtime.compiler.wiring import Connection, LayerGraph, wiring
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.design_rules.placed import design
from spikedeploy.runtime.design_rules.table import ARITHMETIC, ROOM, refuse
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.cuba.bounds import with_headroom
from spikedeploy.runtime.families.integrate_and_fire.quantise import check_convention
from spikedeploy.runtime.families.xylo.arithmetic import XyloArithmetic
from spikedeploy.runtime.families.xylo.layers import as_held, check_output
from spikedeploy.runtime.families.xylo.quantise import quantise_xylo
from spikedeploy.runtime.graph.neurons import DiscreteNeuron, discretise

# [timesteps] beyond any network's longest path
ENDLESS = 1 << 30


def compile_program(
    artifact: Artifact,
    chip: Chip,
    quantisation: Quantisation = PLAIN,
    stagger: bool | None = None,
    limits: bool = True,
) -> Program:
    """The artifact as a program of the chip.

    quantisation: of weights, biases, thresholds and decays.
    stagger: start each layer, and so its biases, when the first spikes can reach it: a network then
        means the same with delays as without. False starts all at once, as lava does. None staggers
        unless the convention itself has a delay, and on Xylo where Xylo can.
    limits: refuse what breaks a design rule of the chip; False emulates the arithmetic also where
        the chip has no room for the network, and where it has not quite what the network asks for.
    """
    _check_reset(artifact.convention, chip)
    if not limits:
        chip = replace(chip, delay_max=ENDLESS)
    wires = wiring(artifact.graph, artifact.convention)
    plan = design(artifact, chip, chip.limits) if limits and chip.limits else None
    if plan:
        refuse(plan, ROOM)
    if chip.events is not None:
        held = for_xylo(artifact, chip, chip.events, wires, stagger)
        program = quantise_xylo(held, chip.events, quantisation)
    elif quantisation.weight_shift and chip.arithmetic is not None:
        raise ConfigError(
            f"weight_shift is {quantisation.weight_shift}: {chip.name} has no shift. Leave it out, "
            "or choose a Xylo."
        )
    else:
        program = _layered(artifact, chip, wires, quantisation, stagger, limits)
    if plan:  # last: the compiler itself is more precise
        refuse(plan, ARITHMETIC)
    return program


def _layered(
    artifact: Artifact,
    chip: Chip,
    wires: LayerGraph,
    quantisation: Quantisation,
    stagger: bool | None,
    limits: bool,
) -> Program:
    """The program of a chip whose layers may be as they are in the graph."""
    if stagger is None:
        stagger = artifact.convention.delay == 0
    starts = _starts(wires, chip.delay if stagger else 0)
    floats = [_layer(artifact, wires, name, starts, chip.delay) for name in wires.layers]
    layers = quantised(floats, chip, quantisation, limits)
    program = _program(artifact, chip, wires, layers)
    if chip.fixed is not None and quantisation.headroom == "proven":
        return with_headroom(program, floats, chip.fixed, quantisation, _window(artifact))
    return program


def for_xylo(
    artifact: Artifact, chip: Chip, point: XyloArithmetic, wires: LayerGraph, stagger: bool | None
) -> Program:
    """The program in floats, with Xylo's populations, shifts for decays and delays."""
    starts = _starts(wires, 0)
    layers = [_layer(artifact, wires, name, starts, 0) for name in wires.layers]
    held, remarks = as_held(wires, layers, point, artifact.convention, stagger)
    program = _program(artifact, chip, wires, held, remarks)
    check_output(program, point)
    return program


def _program(
    artifact: Artifact,
    chip: Chip,
    wires: LayerGraph,
    layers: Sequence[Layer],
    remarks: Sequence[str] = (),
) -> Program:
    """What the layers become together."""
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
        remarks=tuple(remarks),
    )


def _check_reset(convention: Convention, chip: Chip) -> None:
    if convention.reset not in chip.resets:
        raise RuleError(
            f"rule reset: reset {convention.reset!r}: a spike on {chip.name} can only do "
            f"{', '.join(map(repr, chip.resets))}. Train with that reset, give it as an option, or "
            "run in float."
        )
    if chip.steps is not None:
        check_convention(convention, chip.name, chip.steps)
        return
    many = chip.events is not None  # how many spikes is then the chip's own business
    if (convention.spikes != "above" and not many) or convention.floor != "none":
        raise RuleError(
            f"rule convention: spikes {convention.spikes!r}, floor {convention.floor!r}: a neuron "
            f"on {chip.name} sends one spike where its membrane is above the threshold, and its "
            "membrane has no floor. Run in float."
        )


def _starts(wires: LayerGraph, delay: int) -> dict[str, int]:
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
    artifact: Artifact, wires: LayerGraph, name: str, starts: dict[str, int], delay: int
) -> Layer:
    """A layer in floats; gains of the neuron are folded into the weights, which is exact."""
    neuron = discretise(name, artifact.graph.nodes[name], artifact.convention).flat()
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
        current_decay=np.zeros_like(threshold) if keep is None else keep,
        membrane_decay=neuron.membrane_decay,
        scale=1.0,
        start=starts[name],
    )


def _threshold(name: str, neuron: DiscreteNeuron) -> NDArray[np.float64]:
    if neuron.threshold is None or neuron.v_reset.any():
        raise RuleError(
            f"rule reset: layer {name!r}: v_reset goes to {neuron.v_reset.max():g}; on a chip a "
            "spike resets the membrane to 0. Shift it, or run in float."
        )
    return neuron.threshold


def _delay(wire: Connection, target: str, starts: dict[str, int], delay: int) -> int:
    """Delay of a connection: skips wait for the layers they skip, feedback takes its lag more."""
    due = starts[target] - starts[wire.source] + wire.lag
    if due < delay and any(starts.values()):
        raise RuleError(
            f"rule delay: layers {wire.source!r} -> {target!r}: the feedback would have to arrive "
            f"{delay - due} timesteps before it can. Compile with stagger=False, which "
            "lengthens every loop by the delays of its layers."
        )
    return max(due, delay)


def _window(artifact: Artifact) -> int | None:
    """T of an inference; None where it is not known or states go on from one to the next."""
    reset = artifact.convention.state == "reset"
    return artifact.codec.timesteps if artifact.codec is not None and reset else None


def _ways_out(
    wires: LayerGraph, convention: Convention
) -> tuple[str, Readout | None, tuple[HostOutput, ...]]:
    """The layer that leaves the chip and its readout; outlets where there is more than that."""
    taps = [tap for outlet in wires.outlets for tap in outlet.taps]
    first, outlet = taps[0], wires.outlets[0]
    if len(taps) == 1:
        plain = first.weight is None and not first.lag and not outlet.bias.any()
        weight = np.eye(outlet.port.size) if first.weight is None else first.weight
        return first.layer, None if plain else Readout(weight, outlet.bias, first.lag), ()
    if convention.state == "kept" and any(tap.lag for tap in taps):
        raise RuleError(
            f"rule delay: node {outlet.port.name!r}: it hears several layers, some of them late, "
            "while states are kept. Remove the delay before it, or choose state 'reset'."
        )
    return first.layer, None, wires.outlets
