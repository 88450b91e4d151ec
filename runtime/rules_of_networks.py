"""Design rules on the network as a whole: inputs, outputs, cores, chips, convention."""

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from runtime.design import Design
from runtime.layer_cores import assigned, entries
from runtime.mapping import mapping
from runtime.ruling import Ruling, at_most
from runtime.topology import Population


def inputs(design: Design) -> Iterator[Ruling]:
    """Input channels."""
    found = sum(design.network.inputs.values())
    remedy = "Give the network fewer inputs, for example fewer neurons in its code."
    yield at_most("inputs", None, found, design.limits.inputs, "inputs", remedy)


def outputs(design: Design) -> Iterator[Ruling]:
    """Neurons whose spikes leave the chip."""
    found = sum(population.size for population in design.outputs)
    remedy = "Put a small layer at the end."
    yield at_most("outputs", None, found, design.limits.outputs, "outputs", remedy)


def input_targets(design: Design) -> Iterator[Ruling]:
    """Neurons that hear inputs."""
    remedy = "Let fewer neurons hear the inputs."
    found = sum(_hearing(p, design.network.inputs) for p in design.inside)
    limit = design.limits.input_targets
    yield at_most("input-targets", None, found, limit, "neurons that hear inputs", remedy)


def output_sources(design: Design) -> Iterator[Ruling]:
    """Neurons that outputs hear."""
    remedy = "Let the outputs hear fewer neurons."
    targets = {population.name for population in design.outputs}
    found = sum(
        int(np.count_nonzero(design.network.fan_out(population.name, targets)))
        for population in design.inside
    )
    limit = design.limits.output_sources
    yield at_most("output-sources", None, found, limit, "neurons that outputs hear", remedy)


def _hearing(population: Population, sources: Collection[str]) -> int:
    """Neurons with a synapse from one of these sources."""
    into = [c.fan.into for c in population.heard if c.source in sources]
    return int(np.count_nonzero(np.sum(into, axis=0))) if into else 0


def fan_out_mean(design: Design) -> Iterator[Ruling]:
    """Synapses of all neurons, over the neurons."""
    targets = {population.name for population in design.inside}
    out = [design.network.fan_out(name, targets) for name in sorted(targets)]
    sizes = sum(population.size for population in design.inside)
    found = float(sum(int(np.sum(each)) for each in out) / sizes) if sizes else 0.0
    remedy = "Prune the network."
    limit = design.limits.fan_out_mean
    yield at_most("fan-out-mean", None, found, limit, "synapses of a mean spike", remedy)


def cores(design: Design) -> Iterator[Ruling]:
    """Cores that the network takes."""
    if design.limits.layer_cores:
        yield _layer_cores(design)
        return
    remedy = "Prune the network, or make its layers smaller."
    found = design.mapping.cores
    if found is None or design.limits.cores is None:
        yield Ruling("cores", None, "unknown", found, None, "cores")
    else:
        limit = design.limits.cores if design.limits.alone else None
        ruling = at_most("cores", None, found, limit, "cores", remedy, _mixed(design))
        yield ruling if limit else replace(ruling, status="pass", limit=design.limits.cores)


def _layer_cores(design: Design) -> Ruling:
    """A core for each layer."""
    layers = [entries(design.graph, p) for p in design.network.populations]
    held = design.limits.layer_cores
    taken = assigned(layers, held)
    names = [population.name for population in design.network.populations]
    if taken is None:
        found, remedy = f"{len(layers)} layers that find no cores", "Make the layers smaller."
        return Ruling("cores", None, "fail", found, f"{len(held)} of them", "", remedy)
    note = ", ".join(f"{names[layer]}: core {core}" for layer, core in sorted(taken.items()))
    return Ruling("cores", None, "pass", len(layers), len(held), "cores", note=note)


def _mixed(design: Design) -> str:
    """What the other way to store signs would take."""
    fixed = design.chip.fixed
    if fixed is None or fixed.sign_mode != "split" or fixed.weight_bits < 2:
        return ""
    other = replace(design.chip, arithmetic=replace(fixed, sign_mode="mixed"))
    found = mapping(design.network, other, design.graph).cores
    if found == design.mapping.cores:
        return ""
    return f"{found} where both signs share a list (sign_mode 'mixed')"


def chips(design: Design) -> Iterator[Ruling]:
    """Chips that hold the cores."""
    found = design.mapping.chips
    if found is None:
        yield Ruling("chips", None, "unknown", None, None, "chips")
    elif design.limits.alone:
        yield at_most("chips", None, found, 1, "chips", "Prune the network.")
    else:
        note = "more than one chip, which this one can be joined to" if found > 1 else ""
        yield Ruling("chips", None, "pass", found, None, "chips", note=note)


def convention(design: Design) -> Iterator[Ruling]:
    """When a neuron spikes, and below what its membrane cannot go."""
    stated = design.artifact.convention
    found = f"spikes {stated.spikes!r}, floor {stated.floor!r}"
    if design.chip.fixed is None:
        yield Ruling("convention", None, "unknown", found, note=stated.describe())
        return
    fits = stated.spikes == "above" and stated.floor == "none"
    yield Ruling(
        rule="convention",
        node=None,
        status="pass" if fits else "fail",
        found=found,
        limit="spikes 'above', floor 'none'",
        remedy="Run the network in float.",
        note=stated.describe(),
    )
