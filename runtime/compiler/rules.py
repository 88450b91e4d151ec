"""The design rules: everything that a network must keep to fit on a chip, and what it found.

Most rules are rows: what is measured, the limit, the unit and the remedy. The others are functions
of a network that is placed on a chip, which yield their results. A new rule is a line in RULES.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, Literal, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import READOUTS, Chip, Limits
from spikedeploy.runtime.compiler.mapping import CoreMapping, Placement, map_to_cores
from spikedeploy.runtime.compiler.topology import Population, Topology, topology
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.graph.neurons import SPIKING
from spikedeploy.runtime.graph.order import delay_timesteps
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE, POOLS, window_of

Floats: TypeAlias = NDArray[np.float64]
Status = Literal["pass", "fail", "unknown", "not applicable"]
Value = float | str | None

# a decay or mantissa that is a limit itself may come out a last bit beyond it
_LAST_BIT = 1e-9
# of the smallest mantissa: what is no more becomes 0 when it is rounded
_HALF = 0.5
_NONE = Limits(primitives=(), sources={})


@dataclass(frozen=True, eq=False)
class PlacedNetwork:
    """A network on a chip, which rules are about.

    artifact: the network and its convention.
    chip: where it is to run.
    """

    artifact: Artifact
    chip: Chip

    @property
    def limits(self) -> Limits:
        """The limits of the chip; nothing is limited where nothing is published."""
        return self.chip.limits or _NONE

    @cached_property
    def network(self) -> Topology:
        """Populations and synapses."""
        membranes = self.chip.membrane_output != "none"
        return topology(self.artifact.graph, membranes, frozenset(self.artifact.sigma_delta))

    @cached_property
    def mapping(self) -> CoreMapping:
        """The network on the chip's cores."""
        return map_to_cores(self.network, self.chip)

    @property
    def nodes(self) -> list[tuple[str, nir.NIRNode]]:
        """Names and nodes of the graph, sorted."""
        return sorted(self.artifact.graph.nodes.items())

    @property
    def outputs(self) -> list[Population]:
        """Populations whose spikes leave the chip."""
        return [p for p in self.network.populations if p.leaves]

    @property
    def inside(self) -> list[Population]:
        """Populations that count as neurons of the chip, not as its outputs."""
        limited = self.limits.outputs is not None
        return [p for p in self.network.populations if not (limited and p.leaves)]


@dataclass(frozen=True)
class RuleResult:
    """The result of a rule.

    rule: its name.
    node: None for the whole network.
    status: "unknown" where no limit is published; "not applicable" where the node has nothing that
        the rule is about.
    found, limit: numbers in `unit`, or words; the limit is the most, or what is possible.
    unit: what is counted.
    remedy: what to do where it fails.
    note: what a reader must know to judge it.
    """

    rule: str
    node: str | None
    status: Status
    found: Value = None
    limit: Value = None
    unit: str = ""
    remedy: str = ""
    note: str = ""

    @property
    def failed(self) -> bool:
        """True if the network breaks the rule here."""
        return self.status == "fail"

    def describe(self, chip: str) -> str:
        """One line on a failure: the rule, the node, what was found, the limit, the remedy."""
        where = "the network" if self.node is None else f"node {self.node!r}"
        if self.limit is None:
            found = format_value(self.found).rstrip(".")
            if found.startswith("rule "):  # the compiler names one of its own
                return f"{self.rule}: {found}."
            return f"rule {self.rule}: {where}: {found}. {self.remedy}".rstrip()
        has = "at most " if isinstance(self.limit, int | float) else ""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"rule {self.rule}: {where} has {format_value(self.found)}{unit}; {chip} has "
            f"{has}{format_value(self.limit)}. {self.remedy}"
        )

    def as_json(self) -> dict[str, Any]:
        """All of it, for machines."""
        return {**vars(self), "remedy": self.remedy if self.failed else ""}


def format_value(value: Value) -> str:
    """A number with its thousands apart, or the words."""
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


# a rule, whose name its results are given at the end, and what it measures: (node or None, number),
# with a note where it needs one
Rule: TypeAlias = Callable[[PlacedNetwork], Iterable[RuleResult]]
Measure: TypeAlias = Callable[
    [PlacedNetwork], Iterable[tuple[str | None, float] | tuple[str | None, float, str]]
]
_result = partial(RuleResult, "")


def _at_most(unit: str, remedy: str, limit: str, measure: Measure) -> Rule:
    """A rule that passes up to a field of Limits, fails above it, and is unknown without one."""

    def judge(design: PlacedNetwork) -> Iterator[RuleResult]:
        most = getattr(design.limits, limit)
        for node, found, *note in measure(design):
            yield _compare(node, found, most, unit, remedy, *note)

    return judge


def _verdict(keeps: bool) -> Status:
    return "pass" if keeps else "fail"


def _compare(
    node: str | None, found: float, limit: float | None, unit: str, remedy: str, note: str = ""
) -> RuleResult:
    status: Status = "unknown" if limit is None else _verdict(found <= limit)
    return _result(node, status, found, limit, unit, remedy, note)


def _choose(node: str, found: str, possible: Sequence[str], remedy: str) -> RuleResult:
    """Pass where the chip has what was found."""
    return _result(
        node, _verdict(found in possible), found, ", ".join(possible) or "none", "", remedy
    )


# rules on single nodes: kinds, resets, decays, thresholds, weights, kernels


_REPLACE = "Replace the node, or run the network in float."
_NO_LEAK = (
    "Its neurons have no exponential leak and no synaptic current: train with beta=1 "
    "(integrate-and-fire, in snnTorch Leaky), or run the network in float."
)


def _leaks_in_vain(design: PlacedNetwork, name: str | None = None) -> bool:
    """True where a neuron, or that of this name, leaks or has a current, as none of the chip's."""
    kinds, nodes = design.limits.primitives, design.artifact.graph.nodes
    has_none = "IF" in kinds and not {"LIF", "CubaLIF"} & {*kinds}
    found = nodes.values() if name is None else [nodes[name]]
    return has_none and any(isinstance(node, nir.LIF | nir.CubaLIF) for node in found)


def _primitive(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Each node is of a kind that the chip has; what the host computes may be any."""
    for name, node in design.nodes:
        kind, possible = type(node).__name__, design.limits.primitives
        if name in design.network.host:
            yield _result(name, "pass", kind, note="computed by the host")
            continue
        spikes = name in design.artifact.sigma_delta
        if kind in READOUTS and not spikes and design.network.leaving(name):
            kind = f"{kind} before neurons"
            possible = tuple(each for each in possible if each not in READOUTS)
        remedy = _NO_LEAK if _leaks_in_vain(design, name) else _REPLACE
        yield _choose(name, kind, possible, remedy)


def _reset(design: PlacedNetwork) -> Iterator[RuleResult]:
    """A spike does to the membrane what the convention says, from 0."""
    reset, resets = design.artifact.convention.reset, design.chip.resets
    kinds = spiking_kinds(design.artifact)
    for name, node in design.nodes:
        if not isinstance(node, SPIKING):
            continue
        if node.v_reset.any():
            found = f"v_reset {float(node.v_reset.flat[np.abs(node.v_reset).argmax()]):g}"
            remedy = "Shift the membrane so that it resets to 0, or run the network in float."
            yield _result(name, "fail", found, "v_reset 0", "", remedy)
        else:
            remedy = reset_remedy(reset, kinds, resets)
            if _leaks_in_vain(design):  # the leak has to go first
                remedy = reset_remedy(reset, {"IF"}, resets)
                if reset == "subtract-delayed" and "subtract" in resets:
                    remedy = "With beta=1 it passes as well, as snnTorch's default."
            if trained_for := design.artifact.trained_for:
                remedy = f"Run it on {trained_for}, for which it was trained."
            yield _choose(name, f"reset {reset!r}", [f"reset {r!r}" for r in resets], remedy)


def spiking_kinds(artifact: Artifact) -> frozenset[str]:
    """Names of the primitives of its spiking neurons."""
    nodes = artifact.graph.nodes.values()
    return frozenset(type(node).__name__ for node in nodes if isinstance(node, SPIKING))


def reset_remedy(reset: str, kinds: Collection[str], resets: Sequence[str]) -> str:
    """Advice on a reset that a chip lacks.

    kinds: of the neurons, such as "LIF".
    resets: of the chip.
    """
    integrates = {*kinds} == {"IF"}
    if reset == "zero-delayed" and "CubaLIF" not in kinds:
        return "Give --reset zero, with which these neurons spike alike."
    if reset == "subtract-delayed" and integrates and "subtract" in resets:
        return "Give --reset subtract, with which neurons without a leak spike alike."
    if reset in ("zero", "subtract"):
        return (
            f"Train with reset {' or '.join(map(repr, resets))} (docs/own-network.md says how in "
            "snnTorch; `spikedeploy adapt` does it), or run the network in float. Given as an "
            f"option ({' or '.join(f'--reset {each}' for each in resets)}), it makes another "
            "network."
        )
    ways = []
    if integrates and "subtract" in resets:
        ways.append("reset_delay=True, its default, as no leak tells the two apart")
    if "zero" in resets:
        ways.append("reset_mechanism='zero' and reset_delay=False")
    if not ways:
        ways.append("neurons that subtract at once")
    subtracts = reset.startswith("subtract")
    is_on_none = (
        "snnTorch's subtraction is on no chip, whatever its reset_delay"
        if subtracts
        else f"No chip has reset {reset!r}"
    )
    return (
        f"{is_on_none}. Train with {', or '.join(ways)} (docs/own-network.md, Neurons of snnTorch "
        "for chips, has working lines), go on from this network with the chip's reset, as "
        "`spikedeploy adapt` does, or run the network in float."
    )


def _graded(design: PlacedNetwork) -> Iterator[RuleResult]:
    possible = () if design.chip.arithmetic.graded_bits is None else ("graded spikes",)
    remedy = "Choose loihi2 or ideal, or run the network in float."
    for name in sorted(design.artifact.sigma_delta):
        yield _choose(name, "graded spikes", possible, remedy)


def _shape(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Channels and extents of the input, and of what a layer puts out."""
    if (limits := design.limits.convolutions) is None:
        return
    remedy = "Make it smaller, with a stride or a pool."
    shapes = [(p.name, p.shape, limits.extent) for p in design.network.populations]
    for name in design.network.inputs:
        node = design.artifact.graph.nodes[name]
        taken = tuple(int(n) for n in node.input_type["input"])
        shapes.append((name, taken, limits.source))
    for name, (channels, *extents), extent in shapes:
        fits = channels <= limits.channels and max(extents, default=1) <= extent
        most = f"{limits.channels} channels of {extent} in each axis"
        yield _result(name, _verdict(fits), _by((channels, *extents)), most, "", remedy)


def _kernel(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Window of a convolution; a linear map is one as large as the maps that it flattens."""
    if (limits := design.limits.convolutions) is None:
        return
    most = (
        f"square kernels to {limits.kernel}, strides {', '.join(map(str, limits.strides))}, "
        f"padding to {limits.padding}, no dilation"
    )
    for name, node in design.nodes:
        if not isinstance(node, CONVOLUTIONS) or name in design.network.host:
            continue
        window = window_of(name, node)
        fits = (
            max(window.kernel) <= limits.kernel
            and len({*window.kernel}) == 1
            and {*window.stride} <= {*limits.strides}
            and max(max(pair) for pair in window.padding) <= limits.padding
            and {*window.dilation} == {1}
        )
        found = f"a kernel of {_by(window.kernel)}, stride {_by(window.stride)}"
        if any(pair != (0, 0) for pair in window.padding):
            found += f", padding {', '.join(f'{a} and {b}' for a, b in window.padding)}"
        if {*window.dilation} != {1}:
            found += f", dilation {_by(window.dilation)}"
        remedy = "Train with such a kernel, or fill it up with zeros to one."
        yield _result(name, _verdict(fits), found, most, "", remedy)
    for flattened, name in _flattened(design):
        extent = max(flattened[1:], default=1)
        note = "" if len({*flattened[1:]}) < 2 else f"filled up with zeros to {extent} x {extent}"
        remedy = "Make the maps that it hears smaller, with a stride or a pool."
        found = f"a kernel of {_by(flattened[1:])}"
        yield _result(name, _verdict(extent <= limits.kernel), found, most, "", remedy, note)


def _flattened(design: PlacedNetwork) -> Iterator[tuple[tuple[int, ...], str]]:
    """Shapes (C, Y, X) that linear maps hear behind a Flatten, and their names."""
    nodes = design.artifact.graph.nodes
    for population in design.network.populations:
        for maps in (each.maps for each in population.presynaptic):
            for before, name in pairwise(maps):
                if isinstance(nodes[before], nir.Flatten) and isinstance(nodes[name], DENSE):
                    yield tuple(int(n) for n in nodes[before].input_type["input"]), name


def _layer_order(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Pools, then one map with weights, then neurons: what a core does with what it hears."""
    if design.limits.convolutions is None:
        return
    nodes = design.artifact.graph.nodes
    most = "pools, then one convolution or linear map"
    remedy = "Put neurons between maps, and pools behind neurons."
    for population in design.network.populations:
        for maps in (each.maps for each in population.presynaptic):
            kinds = [nodes[name] for name in maps if not isinstance(nodes[name], nir.Flatten)]
            weights = [isinstance(node, (*CONVOLUTIONS, *DENSE)) for node in kinds]
            fits = weights[-1:] == [True] and sum(weights) == 1
            found = ", then ".join(type(node).__name__ for node in kinds) or "no map"
            yield _result(population.name, _verdict(fits), found, most, "", remedy)


def _pool(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Each pool, with those before it, divides coordinates by what a core can divide them by."""
    if (limits := design.limits.convolutions) is None:
        return
    nodes = design.artifact.graph.nodes
    most = f"square pools of {', '.join(map(str, limits.pools))} without overlap or padding"
    presynaptic = (each for p in design.network.populations for each in p.presynaptic)
    for maps in dict.fromkeys(each.maps for each in presynaptic):
        divided = np.ones(2, np.int64)
        for name in (each for each in maps if isinstance(nodes[each], POOLS)):
            window = window_of(name, nodes[name])
            divided *= window.kernel
            fits = window.kernel == window.stride and not np.any(window.padding)
            fits = fits and divided[0] == divided[1] and int(divided[0]) in limits.pools
            found = f"a pool of {_by(window.kernel)}, stride {_by(window.stride)}"
            if tuple(divided) != window.kernel:
                found += f", {_by(tuple(divided))} with those before it"
            yield _result(name, _verdict(fits), found, most, "", "Train with such a pool.")


def _by(extents: tuple[int, ...]) -> str:
    return " x ".join(map(str, extents))


def _axon_signs(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Sources excite all that they reach, or inhibit all, where a chip keeps signs by source."""
    if not design.limits.axon_signs:
        return
    remedy = (
        "Train with weights of one sign for each source, a column of Linear.weight in snnTorch; or "
        "double each source: one neuron with the positive weights, one with the negative."
    )
    for name in (*design.network.inputs, *(p.name for p in design.network.populations)):
        found = design.network.leaving(name)
        if weights := [each.weight for each in found if each.weight is not None]:
            up = np.any([(weight > 0).any(axis=1) for weight in weights], axis=0)
            down = np.any([(weight < 0).any(axis=1) for weight in weights], axis=0)
            mixed = int((up & down).sum())
            said = f"{mixed:,} of {up.size:,} sources with both positive and negative weights"
            yield _result(name, _verdict(not mixed), said, "one sign for a source", "", remedy)


def _weight_values(design: PlacedNetwork) -> Iterator[tuple[str, int]]:
    for name, node in design.nodes:
        dense = isinstance(node, DENSE) and name not in design.network.host
        if dense and design.limits.weight_values is not None:
            rows = node.weight.reshape(-1, node.weight.shape[-1])
            yield name, max(len(np.unique(row[row != 0])) for row in rows)


def _on_mantissas(judge: Callable[[Floats, float, int, int], RuleResult]) -> Rule:
    """A rule on thresholds (N,) and the largest weight, of which the chip keeps so many steps."""

    def rule(design: PlacedNetwork) -> Iterator[RuleResult]:
        most, widest = design.limits.threshold_max, design.limits.weight_max
        for population in design.network.populations:
            node = design.artifact.graph.nodes[population.name]
            if not isinstance(node, SPIKING):
                continue
            weight = max((each.largest for each in population.presynaptic), default=0.0)
            gain = design.artifact.neurons[population.name].gain
            largest = weight * float(np.abs(gain).max())
            if widest is None or most is None or not largest:
                yield _result(population.name, "unknown")
            else:
                found = judge(node.v_threshold, largest, widest, most)
                yield replace(found, node=population.name)

    return rule


def _weight_bits(threshold: Floats, largest: float, widest: int, most: int) -> RuleResult:
    """The largest weight is not 0 beside the largest threshold."""
    top = float(threshold.max())
    found = min(float(widest), largest * most / top if top > 0 else widest)
    limit, unit = f"weights above {_HALF}, to {widest}", "mantissa of the largest weight"
    remedy = "Scale the weights up, or the threshold down."
    return _result(None, _verdict(found > _HALF), found, limit, unit, remedy)


def _threshold_range(threshold: Floats, largest: float, widest: int, most: int) -> RuleResult:
    """Thresholds are whole numbers within their register when the largest weight fills its own."""
    found = float(threshold.min()) * widest / largest
    dead = found < 0 or 0 < found <= _HALF
    limit, unit = f"thresholds above {_HALF}, to {most}", "units of the smallest weight"
    remedy = "Raise the threshold, or clip the weights."
    note = "thresholds above the range scale the weights down" if found > most else ""
    return _result(None, _verdict(not dead), found, limit, unit, remedy, note)


def _decay_range(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Measure the rounding of the losses of current and membrane to what the registers hold."""
    for name, neuron in sorted(design.artifact.neurons.items()):
        if name in design.network.host:
            continue
        losses = {"membrane": (1 - neuron.membrane_decay, design.limits.membrane_loss)}
        if neuron.current_decay is not None:
            losses["current"] = (1 - neuron.current_decay, design.limits.current_loss)
        ranges = [f"{state} {_span(np.array(held))}" for state, (_, held) in losses.items() if held]
        status: Status = "unknown" if len(ranges) < len(losses) else "pass"
        if any(held is not None and not _holds(held, loss) for loss, held in losses.values()):
            status = "fail"
        found = "a loss of " + ", ".join(f"{s} {_span(loss)}" for s, (loss, _) in losses.items())
        unit = "of 1 in a timestep"
        remedy = _NO_LEAK if _leaks_in_vain(design, name) else "Choose another time constant."
        yield _result(name, status, found, ", ".join(ranges) or None, unit, remedy)


def _holds(held: tuple[float, float], loss: Floats) -> bool:
    """Mask of the losses at most half a step outside; next to an end the step is as it is."""
    least, most = held[0] / 2, held[1] + (1 - held[1]) / 2 * (held[1] > held[0])
    return bool(loss.min() >= least - _LAST_BIT and loss.max() <= most + _LAST_BIT)


def _span(values: Floats) -> str:
    least, most = float(values.min()), float(values.max())
    return f"{least:.4g}" if least == most else f"{least:.4g} to {most:.4g}"


def _recurrence(design: PlacedNetwork) -> Iterator[RuleResult]:
    remedy = "Take the loop out, or run the network in float."
    for population in design.network.populations:
        if population.recurrent and design.limits.recurrence is None:
            yield _result(population.name, "unknown", "a loop")
        elif population.recurrent:
            possible = ("a loop",) if design.limits.recurrence else ()
            yield _choose(population.name, "a loop", possible, remedy)


def _delay(design: PlacedNetwork) -> Iterator[RuleResult]:
    for name, node in design.nodes:
        if isinstance(node, nir.Delay):
            steps = int(delay_timesteps(name, node, design.artifact.convention).max())
            most = design.chip.delay_max
            yield _compare(name, steps, most, "timesteps", "Shorten the delay.")


# rules on capacity: of the layers on their cores, and of the network on the chip


def _placed(design: PlacedNetwork) -> Iterable[Placement]:
    return design.mapping.of_neurons.values()


def _note(placement: Placement) -> str:
    return "estimated: its synapses are not listed" if placement.estimated else ""


def _neurons(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Neurons of the fullest core; neurons of the chip, where that is the limit."""
    limits = design.limits
    if limits.layer_cores:
        most = max(core.neurons for core in limits.layer_cores)
        for each in _placed(design):
            yield _compare(each.name, each.block, most, "entries", "Make the layer smaller.")
    elif limits.neurons_per_core is not None:
        most = limits.neurons_per_core
        for each in _placed(design):
            yield _compare(each.name, each.block, most, "neurons in a core", "Divide the layer.")
    else:
        total = sum(population.size for population in design.inside)
        unit = "neurons" if limits.outputs is None else "neurons besides the outputs"
        yield _compare(None, total, limits.neurons, unit, "Make the layers smaller.")


def _synaptic_memory(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Memory of the fullest core, or entries of the layer's kernel."""
    limits, remedy = design.limits, "Prune the layer, or make it smaller."
    for placement in _placed(design):
        name, found = placement.name, placement.memory or 0
        if limits.layer_cores:
            most = max(core.kernel for core in limits.layer_cores)
            yield _compare(name, found, most, "entries", remedy)
        elif limits.memory is None:
            yield _result(name, "unknown")
        else:
            most, note = limits.memory.size, _note(placement)
            yield _compare(name, found, most, "bits in a core", remedy, note)


def _fan_out(design: PlacedNetwork) -> Iterator[tuple[str, int]]:
    """Synapses that a spike reaches; outputs do not count where they are limited themselves."""
    targets = {population.name for population in design.inside}
    inputs = design.network.inputs if design.limits.outputs is None else ()
    for name in (*inputs, *(population.name for population in design.network.populations)):
        yield name, int(design.network.fan_out(name, targets).max())


def _destinations(design: PlacedNetwork) -> Iterator[tuple[str, int]]:
    if design.limits.destinations is not None:
        for population in design.network.populations:
            targets = {each.target for each in design.network.leaving(population.name)}
            yield population.name, len(targets)


def _input_targets(design: PlacedNetwork) -> Iterator[tuple[None, int]]:
    found = 0
    for population in design.inside:
        presynaptic = [p for p in population.presynaptic if p.source in design.network.inputs]
        if into := [projection.into for projection in presynaptic]:
            found += int(np.count_nonzero(np.sum(into, axis=0)))
    yield None, found


def _output_sources(design: PlacedNetwork) -> Iterator[tuple[None, int]]:
    targets = {population.name for population in design.outputs}
    fan_outs = [design.network.fan_out(population.name, targets) for population in design.inside]
    yield None, sum(int(np.count_nonzero(fan_out)) for fan_out in fan_outs)


def _fan_out_mean(design: PlacedNetwork) -> Iterator[tuple[None, float]]:
    targets = {population.name for population in design.inside}
    synapses = sum(int(design.network.fan_out(name, targets).sum()) for name in sorted(targets))
    neurons = sum(population.size for population in design.inside)
    yield None, float(synapses / neurons) if neurons else 0.0


def _cores(design: PlacedNetwork) -> Iterator[RuleResult]:
    limits, found = design.limits, design.mapping.cores
    if limits.layer_cores:
        yield _layer_cores(design)
    elif found is None or limits.cores is None:
        yield _result(None, "unknown", found, None, "cores")
    else:
        remedy = "Prune the network, or make its layers smaller."
        result = _compare(None, found, limits.cores, "cores", remedy, _with_one_list(design))
        yield result if limits.alone else replace(result, status="pass")


def _layer_cores(design: PlacedNetwork) -> RuleResult:
    placements, cores = design.mapping.placements, len(design.limits.layer_cores)
    if design.mapping.chips is None:
        found, remedy = f"{len(placements)} layers that find no cores", "Make the layers smaller."
        return _result(None, "fail", found, f"{cores} of them", "", remedy)
    note = ", ".join(f"{each.name}: core {each.first}" for each in placements)
    return _result(None, "pass", len(placements), cores, "cores", note=note)


def _with_one_list(design: PlacedNetwork) -> str:
    """Words on what the other way to store signs would take."""
    if (one_list := design.chip.arithmetic.with_one_list()) is None:
        return ""
    found = map_to_cores(design.network, replace(design.chip, arithmetic=one_list)).cores
    if found == design.mapping.cores:
        return ""
    return f"{found} where both signs share a list (sign_mode 'mixed')"


def _chips(design: PlacedNetwork) -> Iterator[RuleResult]:
    found = design.mapping.chips
    if found is None:
        yield _result(None, "unknown", None, None, "chips")
    elif design.limits.alone:
        yield _compare(None, found, 1, "chips", "Prune the network.")
    else:
        note = "more than one chip, which this one can be joined to" if found > 1 else ""
        yield _result(None, "pass", found, None, "chips", note=note)


def _convention(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Check the threshold rule, and the floor below which no membrane goes."""
    stated = design.artifact.convention
    found, note = f"spikes {stated.spikes!r}, floor {stated.floor!r}", stated.describe()
    possible = design.chip.arithmetic.spikes_and_floor
    if possible is None:
        yield _result(None, "unknown", found, note=note)
        return
    spikes, floor = possible
    # at the threshold or above it: the compiler makes a remark of it
    near = (stated.spikes, spikes) == ("reached", "above") and stated.floor == floor
    status = _verdict(near or (stated.spikes, stated.floor) == possible)
    limit = f"spikes {spikes!r}, floor {floor!r}"
    yield _result(None, status, found, limit, "", "Run the network in float.", note)


# the table: rules on single nodes, which do not apply to the others, then those on the network

NODE_RULES: dict[str, Rule] = {
    "primitive": _primitive,
    "reset": _reset,
    "graded": _graded,
    "neurons": _neurons,
    "fan-in": _at_most(
        "synapses of a neuron",
        "Prune it, or divide what it hears among several neurons.",
        "fan_in",
        lambda design: ((p.name, p.fan_in) for p in design.network.populations),
    ),
    "fan-out": _at_most("synapses of a spike", "Prune it.", "fan_out", _fan_out),
    "synaptic-memory": _synaptic_memory,
    # different sources that are presynaptic to the fullest core
    "axons-in": _at_most(
        "sources of a core",
        "Prune the layer's sources, or divide them among relay neurons.",
        "axons_in",
        lambda design: ((p.name, p.axons_in, _note(p)) for p in _placed(design)),
    ),
    # pairs of a neuron in the fullest core and a core with postsynaptic neurons
    "axons-out": _at_most(
        "axons out of a core",
        "Make the layers that receive its spikes smaller, so that they take fewer cores.",
        "axons_out",
        lambda design: (
            (p.name, p.axons_out) for p in design.mapping.placements if p.kind != "bias"
        ),
    ),
    "shape": _shape,
    "destinations": _at_most(
        "layers", "Connect it to fewer layers.", "destinations", _destinations
    ),
    "kernel": _kernel,
    "pool": _pool,
    "layer-order": _layer_order,
    "sign": _axon_signs,
    "axon-types": _at_most(
        "weights of a neuron",
        "Quantise to so few weights, or double sources so that each has one more.",
        "weight_values",
        _weight_values,
    ),
    "weight-bits": _on_mantissas(_weight_bits),
    "threshold-range": _on_mantissas(_threshold_range),
    "decay-range": _decay_range,
    "recurrence": _recurrence,
    "delay": _delay,
}
_NETWORK_RULES: dict[str, Rule] = {
    "inputs": _at_most(
        "inputs",
        "Give the network fewer inputs: pool or choose features before they become spikes, or "
        "take fewer neurons in its codec, where it has one.",
        "inputs",
        lambda design: [(None, sum(design.network.inputs.values()))],
    ),
    "outputs": _at_most(
        "outputs",
        "Put a small layer at the end.",
        "outputs",
        lambda design: [(None, sum(population.size for population in design.outputs))],
    ),
    "input-targets": _at_most(
        "neurons that hear inputs",
        "Let fewer neurons hear the inputs.",
        "input_targets",
        _input_targets,
    ),
    "output-sources": _at_most(
        "neurons that outputs hear",
        "Let the outputs hear fewer neurons.",
        "output_sources",
        _output_sources,
    ),
    "fan-out-mean": _at_most(
        "synapses of a mean spike", "Prune the network.", "fan_out_mean", _fan_out_mean
    ),
    "cores": _cores,
    "chips": _chips,
    "convention": _convention,
}
RULES = {**NODE_RULES, **_NETWORK_RULES}
# about numbers and not about capacity: the compiler looks at them when it rounds, too
ARITHMETIC = (
    "primitive",
    "reset",
    "graded",
    "sign",
    "axon-types",
    "weight-bits",
    "threshold-range",
    "decay-range",
    "convention",
)
CAPACITY = tuple(name for name in RULES if name not in ARITHMETIC)


def evaluate(design: PlacedNetwork, names: Collection[str] = tuple(RULES)) -> list[RuleResult]:
    """The results of these rules on every node, and on the network."""
    results = []
    for name, rule in RULES.items():
        if name not in names:
            continue
        found = [replace(result, rule=name) for result in rule(design)]
        results += found
        if name in NODE_RULES:
            others = set(design.artifact.graph.nodes) - {result.node for result in found}
            results += [RuleResult(name, node, "not applicable") for node in sorted(others)]
    return results


def refuse(design: PlacedNetwork, names: Collection[str]) -> None:
    """Refuse a network that breaks one of these rules of the chip; the first is described."""
    broken = [result for result in evaluate(design, names) if result.failed]
    if not broken:
        return
    others = list(dict.fromkeys(each.rule for each in broken if each.rule != broken[0].rule))
    also = f" It breaks {', '.join(others)} too, which `check` describes." if others else ""
    raise RuleError(
        f"{broken[0].describe(design.chip.name)}{also} Or compute with its arithmetic alone: "
        "--limits off (limits=False)."
    )
