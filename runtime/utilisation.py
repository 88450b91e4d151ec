"""The utilisation of a chip's cores: what is taken of what there is."""

from collections.abc import Iterable
from dataclasses import dataclass

from runtime.limits import Limits
from runtime.mapping import Mapping, Placement


@dataclass(frozen=True)
class Utilisation:
    """Shares of 1; None where the chip has no such limit.

    neurons: of the cores that are taken.
    memory: of their synaptic memory, each counted as the fullest of its layer.
    axons_in, axons_out: likewise.
    """

    neurons: float | None
    memory: float | None
    axons_in: float | None
    axons_out: float | None


def of_placement(placement: Placement, limits: Limits) -> Utilisation:
    """Of the fullest core of a layer."""
    if limits.layer_cores and placement.first is not None:
        core = limits.layer_cores[placement.first]
        memory = (placement.memory or 0) / core.kernel
        return Utilisation(placement.block / core.neurons, memory, None, None)
    return _shares([(1, placement)], limits, [placement.block])


def of_mapping(mapping: Mapping, limits: Limits) -> Utilisation:
    """Of all cores that are taken."""
    placed = [(placement.cores, placement) for placement in mapping.placements]
    return _shares(placed, limits, [placement.neurons for placement in mapping.placements])


def _shares(
    placed: list[tuple[int, Placement]], limits: Limits, neurons: Iterable[int]
) -> Utilisation:
    cores = sum(number for number, _ in placed)
    size = None if limits.memory is None else limits.memory.size

    def share(each: Iterable[int | None], most: int | None) -> float | None:
        total = sum(found or 0 for found in each)
        return total / (most * cores) if most and cores else None

    return Utilisation(
        neurons=share(neurons, limits.neurons_per_core),
        memory=share(((p.memory or 0) * number for number, p in placed), size),
        axons_in=share((p.axons_in * number for number, p in placed), limits.axons_in),
        axons_out=share((p.axons_out * number for number, p in placed), limits.axons_out),
    )
