"""The design rules: limits that a network must keep to fit on a chip, and their results.

A rule is a row of RULES. Most measure a number and compare it with a limit of the chip; the others
are functions of a network that is placed on a chip, which yield their results.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import READOUTS, Chip, Limits
from spikedeploy.runtime.compiler.lowering import Lowering, Population, lower
from spikedeploy.runtime.compiler.mapping import CoreMapping, Placement, map_to_cores
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.graph.discretisation import SPIKING
from spikedeploy.runtime.graph.order import delay_timesteps
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE, POOLS, window_of

Floats: TypeAlias = NDArray[np.float64]
Status = Literal["pass", "fail", "unknown", "not applicable"]
Value = float | str | None

# a decay or mantissa that is a limit itself may come out a last bit beyond it
_LAST_BIT = 1e-9
# of the smallest mantissa: what is no more becomes 0 when it is rounded
_HALF = 0.5
_NO_LIMITS = Limits(primitives=(), sources={})


@dataclass(frozen=True, eq=False)
class PlacedNetwork:
    """A network on a chip, which rules are about.

    artifact: the network and its convention.
    chip: where it is to run.
    lowered: its populations and projections, on any chip.
    network: those of them that are on this one.
    """

    artifact: Artifact
    chip: Chip
    lowered: Lowering
    network: Lowering

    @property
    def limits(self) -> Limits:
        """The limits of the chip; nothing is limited where nothing is published."""
        return self.chip.limits or _NO_LIMITS

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

    @property
    def projections(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Name of each population, and the maps that lead to it, once for each projection."""
        return ((p.name, each.maps) for p in self.network.populations for each in p.presynaptic)


def place(artifact: Artifact, chip: Chip, lowered: Lowering | None = None) -> PlacedNetwork:
    """The network on a chip. lowered: of the artifact, where that was done before."""
    lowered = lowered or lower(artifact)
    membranes, graded = chip.membrane_output != "none", frozenset(artifact.sigma_delta)
    return PlacedNetwork(artifact, chip, lowered, lowered.on_chip(membranes, graded))


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
    note: context that is needed to judge it.
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
        """Describe a failure in one line: rule, node, found value, limit, remedy."""
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
        """Return all fields as plain data."""
        return {**vars(self), "remedy": self.remedy if self.failed else ""}


def format_value(value: Value) -> str:
    """A number with its thousands apart, or the words."""
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


# the results of a rule, whose name they are given at the end
Results: TypeAlias = Iterator[RuleResult]
# what a rule with a number for a limit measures: (node or None, number), and a note if need be
Measured: TypeAlias = Iterable[tuple[str | None, float] | tuple[str | None, float, str]]


def _judge(
    node: str | None,
    keeps: bool,
    found: Value,
    limit: Value,
    remedy: str,
    unit: str = "",
    note: str = "",
) -> RuleResult:
    return RuleResult("", node, "pass" if keeps else "fail", found, limit, unit, remedy, note)


def _unknown(node: str | None, found: Value = None, unit: str = "", note: str = "") -> RuleResult:
    return RuleResult("", node, "unknown", found, None, unit, "", note)


def _at_most(
    node: str | None, found: float, limit: float | None, unit: str, remedy: str, note: str = ""
) -> RuleResult:
    if limit is None:
        return RuleResult("", node, "unknown", found, None, unit, remedy, note)
    return _judge(node, found <= limit, found, limit, remedy, unit, note)


def _one_of(node: str, found: str, possible: Sequence[str], remedy: str) -> RuleResult:
    """Pass where the chip has what was found."""
    return _judge(node, found in possible, found, ", ".join(possible) or "none", remedy)


_FEW_WEIGHTS = "Quantise to so few weights, or double sources so that each has one more."
_FEWER, _PRUNE = "Connect fewer.", "Prune the network."
_FEW_INPUTS = (
    "Pool or choose features before they become spikes, or take fewer neurons in the codec."
)

# rules on single nodes: kinds, resets, decays, thresholds, weights, kernels

_NO_LEAK = (
    "Its neurons have no exponential leak and no synaptic current: train with beta=1 "
    "(integrate-and-fire, in snnTorch Leaky), or run the network in float."
)


def _has_leak_the_chip_lacks(design: PlacedNetwork, name: str | None = None) -> bool:
    """Return True if a neuron, or the named one, has a leak or current that the chip lacks."""
    kinds, nodes = design.limits.primitives, design.artifact.graph.nodes
    has_none = "IF" in kinds and not {"LIF", "CubaLIF"} & {*kinds}
    found = nodes.values() if name is None else [nodes[name]]
    return has_none and any(isinstance(node, nir.LIF | nir.CubaLIF) for node in found)


def _primitive(design: PlacedNetwork) -> Results:
    """Each node is of a kind that the chip has; what the host computes may be any."""
    for name, node in design.nodes:
        kind, possible = type(node).__name__, design.limits.primitives
        if name in design.network.host:
            yield RuleResult("", name, "pass", kind, note="computed by the host")
            continue
        spikes = name in design.artifact.sigma_delta
        if kind in READOUTS and not spikes and design.network.leaving.get(name):
            kind = f"{kind} before neurons"
            possible = tuple(each for each in possible if each not in READOUTS)
        replace_it = "Replace the node, or run the network in float."
        remedy = _NO_LEAK if _has_leak_the_chip_lacks(design, name) else replace_it
        yield _one_of(name, kind, possible, remedy)


def _reset(design: PlacedNetwork) -> Results:
    """A spike does to the membrane what the convention says, from 0."""
    reset, resets = design.artifact.convention.reset, design.chip.resets
    remedy = reset_remedy(reset, spiking_kinds(design.artifact), resets)
    if trained_for := design.artifact.trained_for:
        remedy = f"Run it on {trained_for}, for which it was trained."
    elif _has_leak_the_chip_lacks(design):  # the leak has to go first
        remedy = reset_remedy(reset, {"IF"}, resets)
        if reset == "subtract-delayed" and "subtract" in resets:
            remedy = "With beta=1 it passes as well, as snnTorch's default."
    shift = "Shift the membrane so that it resets to 0, or run the network in float."
    for name, node in design.nodes:
        if isinstance(node, SPIKING) and node.v_reset.any():
            found = f"v_reset {float(node.v_reset.flat[np.abs(node.v_reset).argmax()]):g}"
            yield _judge(name, False, found, "v_reset 0", shift)
        elif isinstance(node, SPIKING):
            yield _one_of(name, f"reset {reset!r}", [f"reset {r!r}" for r in resets], remedy)


def spiking_kinds(artifact: Artifact) -> frozenset[str]:
    """Names of the primitives of its spiking neurons."""
    nodes = artifact.graph.nodes.values()
    return frozenset(type(node).__name__ for node in nodes if isinstance(node, SPIKING))


def reset_remedy(reset: str, kinds: Collection[str], resets: Sequence[str]) -> str:
    """Advice on a reset that a chip lacks.

    kinds: of the neurons, such as "LIF".
    resets: of the chip.
    """
    integrates = {*kinds} == {"IF"} and "subtract" in resets
    if reset == "zero-delayed" and "CubaLIF" not in kinds:
        return "Give --reset zero, with which these neurons spike alike."
    if reset == "subtract-delayed" and integrates:
        return "Give --reset subtract, with which neurons without a leak spike alike."
    possible = f"reset {' or '.join(map(repr, resets))}"
    ours = reset in ("zero", "subtract")
    return (
        f"{'' if ours else 'No chip has this one. '}Train with "
        f"{'reset_delay=True, or with ' if integrates and not ours else ''}{possible} "
        "(docs/snntorch-to-chips.md; `spikedeploy adapt` goes on from this network), or run the "
        "network in float. Given as an option, --reset makes another network."
    )


def _graded(design: PlacedNetwork) -> Results:
    possible = () if design.chip.arithmetic.graded_bits is None else ("graded spikes",)
    for name in sorted(design.artifact.sigma_delta):
        remedy = "Choose loihi2 or ideal, or run the network in float."
        yield _one_of(name, "graded spikes", possible, remedy)


def _shape(design: PlacedNetwork) -> Results:
    """Channels and extents of the input, and of what a layer puts out."""
    limits: Any = design.limits.convolutions
    shapes = [(p.name, p.shape, limits.extent) for p in design.network.populations]
    for name in design.network.inputs:
        taken = design.artifact.graph.nodes[name].input_type["input"]
        shapes.append((name, tuple(int(n) for n in taken), limits.source))
    for name, (channels, *extents), extent in shapes:
        fits = channels <= limits.channels and max(extents, default=1) <= extent
        most = f"{limits.channels} channels of {extent} in each axis"
        remedy = "Make it smaller, with a stride or a pool."
        yield _judge(name, fits, _by(channels, *extents), most, remedy)


def _kernel(design: PlacedNetwork) -> Results:
    """Window of a convolution; a linear map is one as large as the maps that it flattens."""
    limits: Any = design.limits.convolutions
    nodes = design.artifact.graph.nodes
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
        found = f"a kernel of {_by(*window.kernel)}, stride {_by(*window.stride)}"
        if any(pair != (0, 0) for pair in window.padding):
            found += f", padding {', '.join(f'{a} and {b}' for a, b in window.padding)}"
        if {*window.dilation} != {1}:
            found += f", dilation {_by(*window.dilation)}"
        remedy = "Train with such a kernel, or fill it up with zeros to one."
        yield _judge(name, fits, found, most, remedy)
    for before, name in (pair for _, maps in design.projections for pair in pairwise(maps)):
        if isinstance(nodes[before], nir.Flatten) and isinstance(nodes[name], DENSE):
            _, *extents = (int(n) for n in nodes[before].input_type["input"])
            extent = max(extents, default=1)
            note = "" if len({*extents}) < 2 else f"filled up with zeros to {extent} x {extent}"
            remedy = "Make the maps before it smaller, with a stride or a pool."
            found = f"a kernel of {_by(*extents)}"
            yield _judge(name, extent <= limits.kernel, found, most, remedy, note=note)


def _layer_order(design: PlacedNetwork) -> Results:
    """A core applies pools, then one map with weights, then neurons, in this order."""
    nodes = design.artifact.graph.nodes
    most = "pools, then one convolution or linear map"
    for name, maps in design.projections:
        kinds = [nodes[each] for each in maps if not isinstance(nodes[each], nir.Flatten)]
        weights = [isinstance(node, (*CONVOLUTIONS, *DENSE)) for node in kinds]
        fits = weights[-1:] == [True] and sum(weights) == 1
        found = ", then ".join(type(node).__name__ for node in kinds) or "no map"
        yield _judge(name, fits, found, most, "Put neurons between maps, and pools behind neurons.")


def _pool(design: PlacedNetwork) -> Results:
    """Each pool, with those before it, divides coordinates by what a core can divide them by."""
    limits: Any = design.limits.convolutions
    nodes = design.artifact.graph.nodes
    most = f"square pools of {', '.join(map(str, limits.pools))} without overlap or padding"
    for maps in dict.fromkeys(maps for _, maps in design.projections):
        divided = np.ones(2, np.int64)
        for name in (each for each in maps if isinstance(nodes[each], POOLS)):
            window = window_of(name, nodes[name])
            divided *= window.kernel
            fits = window.kernel == window.stride and not np.any(window.padding)
            fits = fits and divided[0] == divided[1] and int(divided[0]) in limits.pools
            found = f"a pool of {_by(*window.kernel)}, stride {_by(*window.stride)}"
            if tuple(divided) != window.kernel:
                found += f", {_by(*divided)} with those before it"
            yield _judge(name, fits, found, most, "Train with such a pool.")


def _by(*extents: int) -> str:
    return " x ".join(map(str, extents))


def _axon_signs(design: PlacedNetwork) -> Results:
    """Sources excite all their targets or inhibit all, where a chip stores signs by source."""
    remedy = (
        "Train with weights of one sign for each source, a column of Linear.weight in snnTorch; or "
        "double each source: one neuron with the positive weights, one with the negative."
    )
    for name in (*design.network.inputs, *(p.name for p in design.network.populations)):
        found = design.network.leaving.get(name, ())
        if weights := [each.weight for each in found if each.weight is not None]:
            up = np.any([(weight > 0).any(axis=1) for weight in weights], axis=0)
            down = np.any([(weight < 0).any(axis=1) for weight in weights], axis=0)
            mixed = int((up & down).sum())
            said = f"{mixed:,} of {up.size:,} sources with both positive and negative weights"
            yield _judge(name, not mixed, said, "one sign for a source", remedy)


def _weight_values(design: PlacedNetwork) -> Measured:
    for name, node in design.nodes:
        if isinstance(node, DENSE) and name not in design.network.host:
            rows = node.weight.reshape(-1, node.weight.shape[-1])
            yield name, max(len(np.unique(row[row != 0])) for row in rows)


def _mantissas(design: PlacedNetwork) -> Iterator[tuple[str, Floats, float]]:
    """Name, thresholds (N,) and largest weight of the spiking populations; 0 where not known."""
    most, widest = design.limits.threshold_max, design.limits.weight_max
    for population in design.network.populations:
        node = design.artifact.graph.nodes[population.name]
        if isinstance(node, SPIKING):
            weight = max((each.largest for each in population.presynaptic), default=0.0)
            gain = float(np.abs(design.artifact.neurons[population.name].gain).max())
            known = widest is not None and most is not None
            yield population.name, node.v_threshold, weight * gain if known else 0.0


def _weight_bits(design: PlacedNetwork) -> Results:
    """The largest weight is not 0 beside the largest threshold."""
    most, widest = design.limits.threshold_max or 0, design.limits.weight_max or 0
    for name, threshold, largest in _mantissas(design):
        if not largest:
            yield _unknown(name)
            continue
        top = float(threshold.max())
        found = min(float(widest), largest * most / top if top > 0 else widest)
        limit, unit = f"weights above {_HALF}, to {widest}", "mantissa of the largest weight"
        remedy = "Scale the weights up, or the threshold down."
        yield _judge(name, found > _HALF, found, limit, remedy, unit)


def _threshold_range(design: PlacedNetwork) -> Results:
    """Thresholds are whole numbers within their register when the largest weight fills its own."""
    most, widest = design.limits.threshold_max or 0, design.limits.weight_max or 0
    for name, threshold, largest in _mantissas(design):
        if not largest:
            yield _unknown(name)
            continue
        found = float(threshold.min()) * widest / largest
        keeps = found == 0 or found > _HALF
        limit, unit = f"thresholds above {_HALF}, to {most}", "units of the smallest weight"
        note = "thresholds above the range scale the weights down" if found > most else ""
        yield _judge(
            name, keeps, found, limit, "Raise the threshold, or clip the weights.", unit, note
        )


def _decay_range(design: PlacedNetwork) -> Results:
    """The losses of current and membrane are no further from the registers' than rounding."""
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
        remedy = (
            _NO_LEAK if _has_leak_the_chip_lacks(design, name) else "Choose another time constant."
        )
        limit, unit = ", ".join(ranges) or None, "of 1 in a timestep"
        yield RuleResult("", name, status, found, limit, unit, remedy)


def _holds(held: tuple[float, float], loss: Floats) -> bool:
    """True if losses are at most half a step outside; next to an end the step is as it is."""
    least, most = held[0] / 2, held[1] + (1 - held[1]) / 2 * (held[1] > held[0])
    return bool(loss.min() >= least - _LAST_BIT and loss.max() <= most + _LAST_BIT)


def _span(values: Floats) -> str:
    least, most = float(values.min()), float(values.max())
    return f"{least:.4g}" if least == most else f"{least:.4g} to {most:.4g}"


def _recurrence(design: PlacedNetwork) -> Results:
    allowed, remedy = design.limits.recurrence, "Take the loop out, or run the network in float."
    for name in (p.name for p in design.network.populations if p.recurrent):
        if allowed is None:
            yield _unknown(name, "a loop")
        else:
            yield _one_of(name, "a loop", ("a loop",) * allowed, remedy)


def _delay(design: PlacedNetwork) -> Results:
    for name, node in design.nodes:
        if isinstance(node, nir.Delay):
            steps = int(delay_timesteps(name, node, design.artifact.convention).max())
            yield _at_most(name, steps, design.chip.delay_max, "timesteps", "Shorten the delay.")


# rules on capacity: of the layers on their cores, and of the network on the chip


def _layers(design: PlacedNetwork) -> Iterable[Placement]:
    return design.mapping.of_neurons.values()


def _estimate(placement: Placement) -> str:
    return "estimated: its synapses are not listed" if placement.estimated else ""


def _neurons(design: PlacedNetwork) -> Results:
    """Neurons of the fullest core; neurons of the chip, where that is the limit."""
    limits = design.limits
    if limits.layer_cores:
        most = max(core.neurons for core in limits.layer_cores)
        for each in _layers(design):
            yield _at_most(each.name, each.block, most, "entries", "Make the layer smaller.")
    elif limits.neurons_per_core is not None:
        most = limits.neurons_per_core
        for each in _layers(design):
            yield _at_most(each.name, each.block, most, "neurons in a core", "Divide the layer.")
    else:
        total = sum(population.size for population in design.inside)
        unit = "neurons" if limits.outputs is None else "neurons besides the outputs"
        yield _at_most(None, total, limits.neurons, unit, "Make the layers smaller.")


def _synaptic_memory(design: PlacedNetwork) -> Results:
    """Memory of the fullest core, or entries of the layer's kernel."""
    limits, remedy = design.limits, "Prune the layer, or make it smaller."
    for each in _layers(design):
        name, found = each.name, each.memory or 0
        if limits.layer_cores:
            most = max(core.kernel for core in limits.layer_cores)
            yield _at_most(name, found, most, "entries", remedy)
        elif limits.memory is None:
            yield _unknown(name)
        else:
            unit = "bits in a core"
            yield _at_most(name, found, limits.memory.size, unit, remedy, _estimate(each))


def _fan_in(design: PlacedNetwork) -> Measured:
    return ((p.name, p.fan_in) for p in design.network.populations)


def _axons_in(design: PlacedNetwork) -> Measured:
    """Different sources that are presynaptic to the fullest core."""
    return ((p.name, p.axons_in, _estimate(p)) for p in _layers(design))


def _axons_out(design: PlacedNetwork) -> Measured:
    """Pairs of a neuron in the fullest core and a core with postsynaptic neurons."""
    return ((p.name, p.axons_out) for p in design.mapping.placements if p.kind != "bias")


def _inputs(design: PlacedNetwork) -> Measured:
    return [(None, sum(design.network.inputs.values()))]


def _outputs(design: PlacedNetwork) -> Measured:
    return [(None, sum(population.size for population in design.outputs))]


def _fan_out(design: PlacedNetwork) -> Measured:
    """Synapses that a spike reaches; outputs do not count where they are limited themselves."""
    targets = {population.name for population in design.inside}
    inputs = design.network.inputs if design.limits.outputs is None else ()
    for name in (*inputs, *(population.name for population in design.network.populations)):
        yield name, int(design.network.fan_out(name, targets).max())


def _destinations(design: PlacedNetwork) -> Measured:
    for population in design.network.populations:
        yield (
            population.name,
            len({e.target for e in design.network.leaving.get(population.name, ())}),
        )


def _input_targets(design: PlacedNetwork) -> Measured:
    found = 0
    for population in design.inside:
        presynaptic = [p for p in population.presynaptic if p.source in design.network.inputs]
        if into := [projection.into for projection in presynaptic]:
            found += int(np.count_nonzero(np.sum(into, axis=0)))
    yield None, found


def _output_sources(design: PlacedNetwork) -> Measured:
    targets = {population.name for population in design.outputs}
    fan_outs = [design.network.fan_out(population.name, targets) for population in design.inside]
    yield None, sum(int(np.count_nonzero(fan_out)) for fan_out in fan_outs)


def _fan_out_mean(design: PlacedNetwork) -> Measured:
    targets = {population.name for population in design.inside}
    synapses = sum(int(design.network.fan_out(name, targets).sum()) for name in sorted(targets))
    neurons = sum(population.size for population in design.inside)
    yield None, float(synapses / neurons) if neurons else 0.0


def _cores(design: PlacedNetwork) -> Results:
    limits, mapping, found = design.limits, design.mapping, design.mapping.cores
    if limits.layer_cores and mapping.chips is None:
        said, most = f"{len(mapping.placements)} layers that find no cores", len(limits.layer_cores)
        yield _judge(None, False, said, f"{most} of them", "Make the layers smaller.")
    elif limits.layer_cores:
        note = ", ".join(f"{each.name}: core {each.first}" for each in mapping.placements)
        most = len(limits.layer_cores)
        yield _judge(None, True, len(mapping.placements), most, "", "cores", note)
    elif found is None or limits.cores is None:
        yield _unknown(None, found, "cores")
    else:
        remedy = "Prune the network, or make its layers smaller."
        result = _at_most(None, found, limits.cores, "cores", remedy)
        yield result if limits.alone else replace(result, status="pass")


def _chips(design: PlacedNetwork) -> Results:
    found = design.mapping.chips
    if found is None:
        yield _unknown(None, unit="chips")
    elif design.limits.alone:
        yield _at_most(None, found, 1, "chips", "Prune the network.")
    else:
        note = "more than one chip, which this one can be joined to" if found > 1 else ""
        yield _judge(None, True, found, None, "", "chips", note)


def _convention(design: PlacedNetwork) -> Results:
    """The threshold rule, and the floor below which no membrane goes, are the chip's."""
    stated = design.artifact.convention
    found, note = f"spikes {stated.spikes!r}, floor {stated.floor!r}", stated.describe()
    possible = design.chip.arithmetic.spikes_and_floor
    if possible is None:
        yield _unknown(None, found, note=note)
        return
    spikes, floor = possible
    # at the threshold or above it: the compiler makes a remark of it
    near = (stated.spikes, spikes) == ("reached", "above") and stated.floor == floor
    keeps = near or (stated.spikes, stated.floor) == possible
    limit = f"spikes {spikes!r}, floor {floor!r}"
    yield _judge(None, keeps, found, limit, "Run the network in float.", note=note)


class Rule(NamedTuple):
    """A row of the table.

    find: yields the results on a placed network, nodes that it does not apply to left out; of a
        rule with a limit what is measured, which passes up to the limit, fails above it, and is
        unknown where the chip has none.
    limit, unit, remedy: field of Limits, what is counted, and what to do where it fails.
    needs: field of Limits without which it applies to nothing.
    numbers: whether it is about numbers, which the compiler judges when it has rounded them, and
        not about capacity.
    network: whether it is about the whole network, not about each node.
    """

    find: Callable[[PlacedNetwork], Iterable[Any]]
    limit: str = ""
    unit: str = ""
    remedy: str = ""
    needs: str = ""
    numbers: bool = False
    network: bool = False

    def results(self, design: PlacedNetwork) -> Results:
        """The results of the rule on a placed network."""
        if not self.limit:
            yield from self.find(design)
            return
        most = getattr(design.limits, self.limit)
        for node, found, *note in self.find(design):
            yield _at_most(node, found, most, self.unit, self.remedy, *note)


RULES = {
    "primitive": Rule(_primitive, numbers=True),
    "reset": Rule(_reset, numbers=True),
    "graded": Rule(_graded, numbers=True),
    "neurons": Rule(_neurons),
    "fan-in": Rule(_fan_in, "fan_in", "synapses of a neuron", "Prune it, or divide its sources."),
    "fan-out": Rule(_fan_out, "fan_out", "synapses of a spike", "Prune it."),
    "synaptic-memory": Rule(_synaptic_memory),
    "axons-in": Rule(_axons_in, "axons_in", "sources of a core", "Prune the layer's sources."),
    "axons-out": Rule(
        _axons_out, "axons_out", "axons out of a core", "Make the layers after it smaller."
    ),
    "shape": Rule(_shape, needs="convolutions"),
    "destinations": Rule(
        _destinations, "destinations", "layers", "Connect fewer layers.", needs="destinations"
    ),
    "kernel": Rule(_kernel, needs="convolutions"),
    "pool": Rule(_pool, needs="convolutions"),
    "layer-order": Rule(_layer_order, needs="convolutions"),
    "sign": Rule(_axon_signs, needs="axon_signs", numbers=True),
    "axon-types": Rule(
        _weight_values,
        "weight_values",
        "weights of a neuron",
        _FEW_WEIGHTS,
        needs="weight_values",
        numbers=True,
    ),
    "weight-bits": Rule(_weight_bits, numbers=True),
    "threshold-range": Rule(_threshold_range, numbers=True),
    "decay-range": Rule(_decay_range, numbers=True),
    "recurrence": Rule(_recurrence),
    "delay": Rule(_delay),
    "inputs": Rule(_inputs, "inputs", "inputs", _FEW_INPUTS, network=True),
    "outputs": Rule(_outputs, "outputs", "outputs", "Put a small layer at the end.", network=True),
    "input-targets": Rule(
        _input_targets, "input_targets", "neurons that receive inputs", _FEWER, network=True
    ),
    "output-sources": Rule(
        _output_sources, "output_sources", "neurons that outputs receive", _FEWER, network=True
    ),
    "fan-out-mean": Rule(
        _fan_out_mean, "fan_out_mean", "synapses of a mean spike", _PRUNE, network=True
    ),
    "cores": Rule(_cores, network=True),
    "chips": Rule(_chips, network=True),
    "convention": Rule(_convention, numbers=True, network=True),
}
ARITHMETIC = tuple(name for name, rule in RULES.items() if rule.numbers)
CAPACITY = tuple(name for name, rule in RULES.items() if not rule.numbers)


def evaluate(design: PlacedNetwork, names: Collection[str] = tuple(RULES)) -> list[RuleResult]:
    """The results of these rules on every node, and on the network."""
    results = []
    for name, rule in RULES.items():
        if name not in names:
            continue
        applies = not rule.needs or getattr(design.limits, rule.needs)
        found = [replace(each, rule=name) for each in (rule.results(design) if applies else ())]
        results += found
        if not rule.network:
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
