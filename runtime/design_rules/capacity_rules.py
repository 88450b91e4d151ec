"""Design rules on capacity: of the layers on their cores, and of the network on the chip.

Of a layer its neurons, synapses, memory and axons; of the network its inputs, outputs, cores, chips
and convention.
"""

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from spikedeploy.runtime.design_rules.core_memory import assigned, entries
from spikedeploy.runtime.design_rules.mapping import Placement, mapping
from spikedeploy.runtime.design_rules.rule import PlacedNetwork, RuleResult, at_most
from spikedeploy.runtime.design_rules.topology import Population

_ENTRIES = "entries"


def neurons(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Neurons of the fullest core; neurons of the chip, where that is the limit."""
    limits = design.limits
    for population in design.network.populations:
        if limits.layer_cores:
            found, most = (
                entries(design.graph, population).neurons,
                max(core.neurons for core in limits.layer_cores),
            )
            remedy = "Make the layer smaller."
            yield at_most("neurons", population.name, found, most, _ENTRIES, remedy)
        elif limits.neurons_per_core is not None:
            found = _placement(design, population.name).block
            unit, remedy = "neurons in a core", "Divide the layer."
            yield at_most("neurons", population.name, found, limits.neurons_per_core, unit, remedy)
    if not limits.layer_cores and limits.neurons_per_core is None:
        total = sum(population.size for population in design.inside)
        unit = "neurons" if limits.outputs is None else "neurons besides the outputs"
        remedy = "Make the layers smaller."
        yield at_most("neurons", None, total, limits.neurons, unit, remedy)


def fan_in(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Synapses of a neuron."""
    remedy = "Prune it, or divide what it hears among several neurons."
    for population in design.network.populations:
        found, limit = population.fan_in, design.limits.fan_in
        yield at_most("fan-in", population.name, found, limit, "synapses of a neuron", remedy)


def fan_out(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Synapses that a spike reaches; outputs do not count where they are limited themselves."""
    remedy = "Prune it."
    targets = {population.name for population in design.inside}
    sources = [population.name for population in design.network.populations]
    if design.limits.outputs is None:
        sources = [*design.network.inputs, *sources]
    for name in sources:
        found = int(design.network.fan_out(name, targets).max())
        yield at_most("fan-out", name, found, design.limits.fan_out, "synapses of a spike", remedy)


def synaptic_memory(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Memory of the fullest core, or entries of the layer's kernel."""
    remedy = "Prune the layer, or make it smaller."
    for population in design.network.populations:
        limits, name = design.limits, population.name
        if limits.layer_cores:
            most = max(core.kernel for core in limits.layer_cores)
            found = entries(design.graph, population).kernel
            yield at_most("synaptic-memory", name, found, most, _ENTRIES, remedy)
        elif limits.memory is None:
            yield RuleResult("synaptic-memory", name, "unknown")
        else:
            placement = _placement(design, name)
            found = placement.memory or 0
            unit, note = "bits in a core", _note(placement)
            most = limits.memory.size
            yield at_most("synaptic-memory", name, found, most, unit, remedy, note)


def axons_in(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Different sources that are presynaptic to the fullest core."""
    remedy = "Prune the layer's sources, or divide them among relay neurons."
    for population in design.network.populations:
        placement = _placement(design, population.name)
        yield at_most(
            "axons-in",
            population.name,
            placement.axons_in,
            design.limits.axons_in,
            "sources of a core",
            remedy,
            _note(placement),
        )


def axons_out(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Pairs of a neuron in the fullest core and a core with postsynaptic neurons."""
    remedy = "Make the layers that receive its spikes smaller, so that they take fewer cores."
    for placement in design.mapping.placements:
        if placement.kind == "bias":
            continue
        limit, unit = design.limits.axons_out, "axons out of a core"
        yield at_most("axons-out", placement.name, placement.axons_out, limit, unit, remedy)


def _placement(design: PlacedNetwork, name: str) -> Placement:
    return design.mapping.of_neurons[name]


def _note(placement: Placement) -> str:
    return "estimated: its synapses are not listed" if placement.estimated else ""


def shape(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Channels and extents of what a layer puts out."""
    limits = design.limits.convolutions
    if limits is None:
        return
    for population in design.network.populations:
        channels, *extents = population.shape
        fits = channels <= limits.channels and max(extents, default=1) <= limits.extent
        yield RuleResult(
            rule="shape",
            node=population.name,
            status="pass" if fits else "fail",
            found=" x ".join(map(str, population.shape)),
            limit=f"{limits.channels} channels of {limits.extent} in each axis",
            remedy="Make the layer smaller, with a stride or a pool.",
        )


def destinations(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Postsynaptic layers of a layer."""
    if design.limits.destinations is None:
        return
    remedy = "Connect it to fewer layers."
    for population in design.network.populations:
        found = len({c.target for c in design.network.leaving(population.name)})
        limit = design.limits.destinations
        yield at_most("destinations", population.name, found, limit, "layers", remedy)


def inputs(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Input channels."""
    found = sum(design.network.inputs.values())
    remedy = "Give the network fewer inputs, for example fewer neurons in its code."
    yield at_most("inputs", None, found, design.limits.inputs, "inputs", remedy)


def outputs(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Neurons whose spikes leave the chip."""
    found = sum(population.size for population in design.outputs)
    remedy = "Put a small layer at the end."
    yield at_most("outputs", None, found, design.limits.outputs, "outputs", remedy)


def input_targets(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Neurons with synapses from inputs."""
    remedy = "Let fewer neurons hear the inputs."
    found = sum(_postsynaptic(p, design.network.inputs) for p in design.inside)
    limit = design.limits.input_targets
    yield at_most("input-targets", None, found, limit, "neurons that hear inputs", remedy)


def output_sources(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Neurons with synapses onto outputs."""
    remedy = "Let the outputs hear fewer neurons."
    targets = {population.name for population in design.outputs}
    found = sum(
        int(np.count_nonzero(design.network.fan_out(population.name, targets)))
        for population in design.inside
    )
    limit = design.limits.output_sources
    yield at_most("output-sources", None, found, limit, "neurons that outputs hear", remedy)


def _postsynaptic(population: Population, sources: Collection[str]) -> int:
    """Neurons with a synapse from one of these sources."""
    into = [c.fan.into for c in population.presynaptic if c.source in sources]
    return int(np.count_nonzero(np.sum(into, axis=0))) if into else 0


def fan_out_mean(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Synapses of all neurons, over the neurons."""
    targets = {population.name for population in design.inside}
    out = [design.network.fan_out(name, targets) for name in sorted(targets)]
    sizes = sum(population.size for population in design.inside)
    found = float(sum(int(np.sum(each)) for each in out) / sizes) if sizes else 0.0
    remedy = "Prune the network."
    limit = design.limits.fan_out_mean
    yield at_most("fan-out-mean", None, found, limit, "synapses of a mean spike", remedy)


def cores(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Cores that the network takes."""
    if design.limits.layer_cores:
        yield _layer_cores(design)
        return
    remedy = "Prune the network, or make its layers smaller."
    found = design.mapping.cores
    if found is None or design.limits.cores is None:
        yield RuleResult("cores", None, "unknown", found, None, "cores")
    else:
        limit = design.limits.cores if design.limits.alone else None
        ruling = at_most("cores", None, found, limit, "cores", remedy, _mixed(design))
        yield ruling if limit else replace(ruling, status="pass", limit=design.limits.cores)


def _layer_cores(design: PlacedNetwork) -> RuleResult:
    """A core for each layer."""
    layers = [entries(design.graph, p) for p in design.network.populations]
    held = design.limits.layer_cores
    taken = assigned(layers, held)
    names = [population.name for population in design.network.populations]
    if taken is None:
        found, remedy = f"{len(layers)} layers that find no cores", "Make the layers smaller."
        return RuleResult("cores", None, "fail", found, f"{len(held)} of them", "", remedy)
    note = ", ".join(f"{names[layer]}: core {core}" for layer, core in sorted(taken.items()))
    return RuleResult("cores", None, "pass", len(layers), len(held), "cores", note=note)


def _mixed(design: PlacedNetwork) -> str:
    """What the other way to store signs would take."""
    one_list = design.chip.arithmetic.with_one_list()
    if one_list is None:
        return ""
    other = replace(design.chip, arithmetic=one_list)
    found = mapping(design.network, other, design.graph).cores
    if found == design.mapping.cores:
        return ""
    return f"{found} where both signs share a list (sign_mode 'mixed')"


def chips(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Chips that hold the cores."""
    found = design.mapping.chips
    if found is None:
        yield RuleResult("chips", None, "unknown", None, None, "chips")
    elif design.limits.alone:
        yield at_most("chips", None, found, 1, "chips", "Prune the network.")
    else:
        note = "more than one chip, which this one can be joined to" if found > 1 else ""
        yield RuleResult("chips", None, "pass", found, None, "chips", note=note)


def convention(design: PlacedNetwork) -> Iterator[RuleResult]:
    """When a neuron spikes, and below what its membrane cannot go."""
    stated = design.artifact.convention
    found = f"spikes {stated.spikes!r}, floor {stated.floor!r}"
    possible = design.chip.arithmetic.spikes_and_floor
    if possible is None:
        yield RuleResult("convention", None, "unknown", found, note=stated.describe())
        return
    spikes, floor = possible
    # at the threshold or above it: the compiler makes a remark of it
    near = (stated.spikes, spikes) == ("reached", "above") and stated.floor == floor
    yield RuleResult(
        rule="convention",
        node=None,
        status="pass" if near or (stated.spikes, stated.floor) == possible else "fail",
        found=found,
        limit=f"spikes {spikes!r}, floor {floor!r}",
        remedy="Run the network in float.",
        note=stated.describe(),
    )
