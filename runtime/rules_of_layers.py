"""Design rules on how much a layer takes: neurons, synapses, memory and axons of its cores."""

from collections.abc import Iterator

from runtime.design import Design
from runtime.layer_cores import entries
from runtime.mapping import Placement
from runtime.ruling import Ruling, at_most

ENTRIES = "entries"


def neurons(design: Design) -> Iterator[Ruling]:
    """Neurons of the fullest core; neurons of the chip, where that is the limit."""
    limits = design.limits
    for population in design.network.populations:
        if limits.layer_cores:
            found, most = (
                entries(design.graph, population).neurons,
                max(core.neurons for core in limits.layer_cores),
            )
            remedy = "Make the layer smaller."
            yield at_most("neurons", population.name, found, most, ENTRIES, remedy)
        elif limits.neurons_per_core is not None:
            found = _placement(design, population.name).block
            unit, remedy = "neurons in a core", "Divide the layer."
            yield at_most("neurons", population.name, found, limits.neurons_per_core, unit, remedy)
    if not limits.layer_cores and limits.neurons_per_core is None:
        total = sum(population.size for population in design.inside)
        unit = "neurons" if limits.outputs is None else "neurons besides the outputs"
        remedy = "Make the layers smaller."
        yield at_most("neurons", None, total, limits.neurons, unit, remedy)


def fan_in(design: Design) -> Iterator[Ruling]:
    """Synapses of a neuron."""
    remedy = "Prune it, or divide what it hears among several neurons."
    for population in design.network.populations:
        found, limit = population.fan_in, design.limits.fan_in
        yield at_most("fan-in", population.name, found, limit, "synapses of a neuron", remedy)


def fan_out(design: Design) -> Iterator[Ruling]:
    """Synapses that a spike reaches; outputs do not count where they are limited themselves."""
    remedy = "Prune it."
    targets = {population.name for population in design.inside}
    sources = [population.name for population in design.network.populations]
    if design.limits.outputs is None:
        sources = [*design.network.inputs, *sources]
    for name in sources:
        found = int(design.network.fan_out(name, targets).max())
        yield at_most("fan-out", name, found, design.limits.fan_out, "synapses of a spike", remedy)


def synaptic_memory(design: Design) -> Iterator[Ruling]:
    """Memory of the fullest core, or entries of the layer's kernel."""
    remedy = "Prune the layer, or make it smaller."
    for population in design.network.populations:
        limits, name = design.limits, population.name
        if limits.layer_cores:
            most = max(core.kernel for core in limits.layer_cores)
            found = entries(design.graph, population).kernel
            yield at_most("synaptic-memory", name, found, most, ENTRIES, remedy)
        elif limits.memory is None:
            yield Ruling("synaptic-memory", name, "unknown")
        else:
            placement = _placement(design, name)
            found = placement.memory or 0
            unit, note = "bits in a core", _note(placement)
            most = limits.memory.size
            yield at_most("synaptic-memory", name, found, most, unit, remedy, note)


def axons_in(design: Design) -> Iterator[Ruling]:
    """Different sources that the fullest core hears."""
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


def axons_out(design: Design) -> Iterator[Ruling]:
    """Pairs of a neuron in the fullest core and a core that hears it."""
    remedy = "Make the layers that hear it smaller, so that they take fewer cores."
    for placement in design.mapping.placements:
        if placement.kind == "bias":
            continue
        limit, unit = design.limits.axons_out, "axons out of a core"
        yield at_most("axons-out", placement.name, placement.axons_out, limit, unit, remedy)


def _placement(design: Design, name: str) -> Placement:
    return next(p for p in design.mapping.placements if p.name == name and p.kind == "neurons")


def _note(placement: Placement) -> str:
    return "estimated: its synapses are not listed" if placement.estimated else ""


def shape(design: Design) -> Iterator[Ruling]:
    """Channels and extents of what a layer puts out."""
    limits = design.limits.convolutions
    if limits is None:
        return
    for population in design.network.populations:
        channels, *extents = population.shape
        fits = channels <= limits.channels and max(extents, default=1) <= limits.extent
        yield Ruling(
            rule="shape",
            node=population.name,
            status="pass" if fits else "fail",
            found=" x ".join(map(str, population.shape)),
            limit=f"{limits.channels} channels of {limits.extent} in each axis",
            remedy="Make the layer smaller, with a stride or a pool.",
        )


def destinations(design: Design) -> Iterator[Ruling]:
    """Layers that hear a layer."""
    if design.limits.destinations is None:
        return
    remedy = "Let fewer layers hear it."
    for population in design.network.populations:
        found = len({c.target for c in design.network.leaving(population.name)})
        limit = design.limits.destinations
        yield at_most("destinations", population.name, found, limit, "layers", remedy)
