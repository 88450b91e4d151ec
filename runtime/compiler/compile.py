"""The compiler: an artifact becomes the program of a chip; and the check of all design rules."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import nir
import numpy as np

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.layer import MAX_BYTES, Layer
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.lowering import Lowering, lower
from spikedeploy.runtime.compiler.mapping import CoreMapping
from spikedeploy.runtime.compiler.outliers import outlier_remarks
from spikedeploy.runtime.compiler.program import Output, Program, Readout
from spikedeploy.runtime.compiler.rules import (
    ARITHMETIC,
    CAPACITY,
    RULES,
    PlacedNetwork,
    RuleResult,
    Status,
    evaluate,
    place,
    refuse,
    reset_remedy,
    spiking_kinds,
)
from spikedeploy.runtime.compiler.synapses import LayerGraph, layer_graph
from spikedeploy.runtime.convention import Clock, Convention
from spikedeploy.runtime.errors import RuleError, SpikedeployError

# [timesteps] beyond any network's longest path
_ENDLESS = 1 << 30


def compile_program(
    artifact: Artifact,
    chip: Chip,
    quantisation: Quantisation = PLAIN,
    clock: Clock | None = None,
    limits: bool = True,
) -> Program:
    """The artifact as a program of the chip.

    quantisation: of weights, biases, thresholds and decays.
    clock: how layers advance, as in Program; None is the chip's, or `clock_on`. Gated and free,
        each layer, and so its bias axon, starts when the first spikes can reach it, so that a
        network without delays means the same on a chip that has some: always when gated; free where
        states are reset and no bias stands in a register. Pipelined starts all at once, as lava.
    limits: refuse what breaks a design rule of the chip; False emulates the arithmetic also where
        the chip lacks capacity for the network, or something that the network asks for.
    """
    clocked, on, clock = _prepared(artifact, chip, clock, limits)
    lowered = lower(clocked)
    placed = place(artifact, chip, lowered) if limits and chip.limits else None
    return _compile(clocked, on, lowered, quantisation, clock, limits, placed)


def _compile(
    artifact: Artifact,
    chip: Chip,
    lowered: Lowering,
    quantisation: Quantisation,
    clock: Clock,
    limits: bool,
    placed: PlacedNetwork | None = None,
) -> Program:
    """The program of a network that `_prepared` made ready for the chip.

    placed: to judge by the design rules; None where that is not asked for, or was done before.
    """
    graph = layer_graph(lowered, artifact)
    if placed:
        refuse(placed, CAPACITY)
    chip.arithmetic.check_quantisation(quantisation, chip.name)
    program = float_program(artifact, chip, graph, clock)
    rows = _rows(artifact, program)
    layers = tuple(chip.arithmetic.quantise(program, quantisation, rows, limits=limits))
    if placed:  # last: the compiler itself is more precise
        refuse(placed, ARITHMETIC)
    outliers = tuple(outlier_remarks(chip.arithmetic, program.layers, layers, quantisation))
    remarks = (*program.remarks, *chip.arithmetic.ranges(layers, rows), *outliers)
    return replace(program, layers=layers, remarks=remarks, outliers=outliers)


def _prepared(
    artifact: Artifact, chip: Chip, clock: Clock | None, limits: bool
) -> tuple[Artifact, Chip, Clock]:
    """The artifact with its clock on the chip, the chip within its limits or not, and the clock."""
    _check_neurons(artifact, chip)
    if not limits:
        chip = replace(chip, delay_max=_ENDLESS)
    clock = clock or chip.clock or clock_on(artifact.convention, chip)
    # a convention's own delay is a pipeline already
    delays = clock == "pipelined" and not artifact.convention.delay
    stated = replace(artifact.convention, clock="pipelined" if delays else "gated")
    clocked = artifact if stated == artifact.convention else artifact.with_convention(stated)
    return clocked, chip, clock


class Recompiler:
    """A compiler for a network whose numbers change, as in training through a chip.

    The graph is lowered once. Rules on capacity are judged once, of the first numbers; what the
    arithmetic cannot compute is refused each time.

    artifact: the network with its first numbers.
    chip, limits: as in `compile_program`.
    """

    def __init__(
        self,
        artifact: Artifact,
        chip: Chip,
        limits: bool = True,
    ) -> None:
        self.first = compile_program(artifact, chip, limits=limits)
        self._limits = limits
        self._artifact, self._chip, self._clock = _prepared(artifact, chip, None, limits)
        self._lowered = lower(self._artifact)

    def program(self, numbers: nir.NIRGraph) -> Program:
        """The program of the same network with the numbers of a graph of the same nodes."""
        artifact, chip = self._artifact.with_numbers(numbers), self._chip
        program = float_program(artifact, chip, layer_graph(self._lowered, artifact), self._clock)
        rows = _rows(artifact, program)
        layers = chip.arithmetic.quantise(program, PLAIN, rows, limits=self._limits)
        return replace(program, layers=tuple(layers))


def own_clock(convention: Convention) -> Clock:
    """The clock that a network of this convention was made for; a delay of all is a pipeline."""
    return "pipelined" if convention.delay else convention.clock


def clock_on(convention: Convention, chip: Chip) -> Clock:
    """The clock by which a chip runs a network of this convention: the network's own, or free.

    Raises RuleError where the chip has neither.
    """
    if (wanted := own_clock(convention)) in chip.clocks:
        return wanted
    if convention.clock == "gated":
        return "free" if "free" in chip.clocks and not convention.delay else "gated"
    raise RuleError(
        f"rule clock: {chip.name} advances its layers {' or '.join(chip.clocks)}, and this network "
        f"was made for clock {wanted!r}. Train it for the chip, or emulate it as "
        f"{chip.name}:clock={wanted}."
    )


def _check_neurons(artifact: Artifact, chip: Chip) -> None:
    convention = artifact.convention
    there = f"The policy was trained for {artifact.trained_for}: run it there."
    if convention.reset not in chip.resets:
        remedy = reset_remedy(convention.reset, spiking_kinds(artifact), chip.resets)
        raise RuleError(
            f"rule reset: reset {convention.reset!r}: a spike on {chip.name} can only do "
            f"{', '.join(map(repr, chip.resets))}. {there if artifact.trained_for else remedy}"
        )
    try:
        chip.arithmetic.check_convention(convention, chip.name)
    except RuleError as error:
        raise (RuleError(f"{error} {there}") if artifact.trained_for else error) from error
    if artifact.sigma_delta and chip.arithmetic.graded_bits is None:
        raise RuleError(
            f"rule graded: node {min(artifact.sigma_delta)!r}: sigma-delta neurons send graded "
            f"spikes to neurons, and {chip.name} has none between neurons. Choose loihi2 or ideal, "
            "or run in float."
        )


def float_program(artifact: Artifact, chip: Chip, graph: LayerGraph, clock: Clock) -> Program:
    """The program in floats, with the starts, delays and decays that the chip has."""
    arithmetic, convention = chip.arithmetic, artifact.convention
    floats = [_layer(artifact, graph, name) for name in graph.layers]
    here = [layer for layer in floats if layer.spiking or chip.membrane_output != "none"]
    host = [layer for layer in floats if layer not in here]
    if not here:
        raise RuleError(
            f"rule primitive: layer {floats[0].name!r}: no neuron of the network spikes, and "
            f"membranes do not leave {chip.name}, so that the host would compute everything. Run "
            "it in float."
        )
    layers, remarks = arithmetic.prepare(
        here, graph.input, convention, chip.delay, clock != "pipelined"
    )
    remarks += arithmetic.transport_remarks(layers, graph.input)
    remarks += [_describe_host(layer, chip) for layer in host]
    if arithmetic.is_rounded:
        remarks += [_describe_readout(layer, chip) for layer in here if not layer.spiking]
    if clock not in chip.clocks:
        remarks.append(
            f"clock {clock!r} is an assumption: nothing published says that {chip.name} can "
            f"advance its layers so; it advances them {' or '.join(chip.clocks)}"
        )
    silent = {layer.name for layer in floats if not layer.spiking}
    output, readout, host_outputs = _way_out(graph, convention, bool(host), silent)
    if output in {layer.name for layer in host}:
        output = layers[-1].name
    program = Program(
        chip=chip,
        convention=convention,
        input=graph.input,
        width=graph.width,
        layers=tuple(layers),
        output=output,
        readout=readout,
        inputs=graph.inputs,
        outputs=tuple(node.port for node in graph.outputs),
        host_outputs=host_outputs,
        remarks=tuple(remarks),
        host=tuple(host),
        clock=clock,
    )
    arithmetic.check_output(program)
    return program


def _describe_readout(layer: Layer, chip: Chip) -> str:
    ways = {
        "probe": "which the host reads from their registers",
        "graded": "which are sent as graded spikes",
        "software": "which the chip's program puts out",
    }
    return (
        f"readout {layer.name!r}: the membranes of {layer.size} neurons leave {chip.name} in each "
        f"timestep, {ways[chip.membrane_output]} (membrane_output {chip.membrane_output!r})"
    )


def _describe_host(layer: Layer, chip: Chip) -> str:
    fan_outs = [
        f"{synapses.fan_out.mean():.3g} additions for each spike of {synapses.source!r}"
        for synapses in layer.synapses
    ]
    return (
        f"readout {layer.name!r}: membranes do not leave {chip.name}, so the host integrates it in "
        f"float64: {layer.multiplications} multiplications in each timestep, and on average "
        f"{', '.join(fan_outs)}"
    )


def _layer(artifact: Artifact, graph: LayerGraph, name: str) -> Layer:
    """A layer in floats, with the lags of the graph for delays.

    Gains of the neuron are folded into the weights, which is exact.
    """
    neuron = artifact.neurons[name].flat()
    graded = artifact.sigma_delta.get(name)
    if neuron.threshold is not None and neuron.v_reset.any():
        raise RuleError(
            f"rule reset: layer {name!r}: v_reset goes to {neuron.v_reset.max():g}; on a chip a "
            "spike resets the membrane to 0. Shift it, or run in float."
        )
    threshold = np.full(neuron.gain.shape, np.inf) if graded is None else graded.threshold.ravel()
    threshold = threshold if neuron.threshold is None else neuron.threshold
    current_decay = neuron.current_decay
    return Layer(
        name=name,
        synapses=tuple(synapses.scaled(neuron.gain) for synapses in graph.synapses[name]),
        bias=graph.bias[name] * neuron.gain,
        voltage_bias=neuron.leak if graded is None else graded.bias.ravel(),
        threshold=threshold,
        current_decay=np.zeros_like(threshold) if current_decay is None else current_decay,
        membrane_decay=neuron.membrane_decay,
        scale=1.0,
        start=0,
        spiking=neuron.threshold is not None or graded is not None,
        graded=graded is not None,
    )


def _rows(artifact: Artifact, program: Program) -> int | None:
    """Return the rows of an inference; None if unknown, or if states are kept between them."""
    reset = artifact.convention.state == "reset"
    return program.rows(artifact.codec.timesteps) if artifact.codec is not None and reset else None


def _way_out(
    graph: LayerGraph, convention: Convention, on_host: bool, silent: Collection[str]
) -> tuple[str, Readout | None, tuple[Output, ...]]:
    """The layer that leaves the chip and its readout; outputs where there is more than that.

    on_host: whether the host integrates a layer, which only outputs can say.
    silent: names of the readout layers; where there are some, the host remembers what is late.
    """
    terms = [term for node in graph.outputs for term in node.terms]
    first, node = terms[0], graph.outputs[0]
    if len(terms) == 1 and not on_host:
        plain = first.weight is None and not first.lag and not node.bias.any()
        if plain:
            return first.layer, None, ()
        weight = first.weight
        if weight is None:
            if 8 * node.port.size**2 > MAX_BYTES:
                raise RuleError(
                    f"rule outputs: node {node.port.name!r}: {node.port.size} spikes reach it "
                    "late or beside a bias, so that the host would multiply them by a matrix; at "
                    f"most {MAX_BYTES} bytes. Leave out the delay and the bias before it."
                )
            weight = np.eye(node.port.size)
        return first.layer, Readout(weight, node.bias, first.lag), ()
    if not silent and convention.state == "kept" and any(term.lag for term in terms):
        raise RuleError(
            f"rule delay: node {node.port.name!r}: it receives several layers, some of "
            "them late, while states are kept. Remove the delay before it, or choose state 'reset'."
        )
    return first.layer, None, graph.outputs


COMPILE = "compile"
# of a rule on several nodes the first of these that occurs counts
_STATUSES: tuple[Status, ...] = ("fail", "pass", "unknown", "not applicable")


@dataclass(frozen=True, eq=False)
class DesignCheck:
    """A network on one chip.

    chip: its datasheet.
    results: those of every rule on every node, then on the network, and the compiler's last.
    mapping: onto its cores.
    program: what it becomes; None where it does not compile.
    """

    chip: Chip
    results: tuple[RuleResult, ...]
    mapping: CoreMapping
    program: Program | None = None

    @property
    def passed(self) -> bool:
        """True if no rule is broken; what is unknown breaks none."""
        return not any(result.failed for result in self.results)

    def results_of(self, rule: str) -> list[RuleResult]:
        """The results of one rule, of each node or of the network."""
        return [result for result in self.results if result.rule == rule]

    @cached_property
    def worst(self) -> dict[str, RuleResult]:
        """Rule -> the first failure, else the largest that passes, else one that is unknown.

        Rules without a result on this chip are not applicable.
        """

        def rank(result: RuleResult) -> tuple[int, float]:
            found = result.found if isinstance(result.found, int | float) else 0.0
            return _STATUSES.index(result.status), 0.0 if result.failed else -found

        absent = RuleResult("", None, "not applicable")
        return {
            rule: min(self.results_of(rule), key=rank, default=absent) for rule in (*RULES, COMPILE)
        }


def check(artifact: Artifact, on: Chip, lowered: Lowering | None = None) -> DesignCheck:
    """Judge the artifact by every rule of the chip.

    lowered: of the artifact, where several chips are asked about.
    """
    placed = place(artifact, on, lowered or lower(artifact))
    results: Sequence[RuleResult] = evaluate(placed) if on.limits is not None else ()
    limits = not any(result.failed for result in results)
    try:
        clocked, chip, clock = _prepared(artifact, on, None, limits)
        program = _compile(clocked, chip, placed.lowered, PLAIN, clock, limits)
    except SpikedeployError as error:
        result = RuleResult(COMPILE, None, "fail", str(error))
        return DesignCheck(on, (*results, result), placed.mapping)
    arithmetic, layers = program.chip.arithmetic, program.layers
    ranges = arithmetic.ranges(layers, _rows(artifact, program))
    transport = arithmetic.transport_remarks(layers, program.input)
    own = (*transport, *ranges, *program.outliers)
    note = "; ".join(program.remarks if program.reads_membranes else own)
    result = RuleResult(COMPILE, None, "pass", "a program", note=note)
    return DesignCheck(on, (*results, result), placed.mapping, program)
