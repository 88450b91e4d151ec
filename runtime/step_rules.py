"""What a network must keep to on chips without a synaptic current: rules of their arithmetic."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.chip import Chip
from runtime.convention import Convention
from runtime.errors import RuleError
from runtime.program import Layer
from runtime.step_point import StepPoint

LINEAR = (
    "{chip} takes the same amount away in each timestep. Train with IF neurons, or compile with "
    "limits off, which takes away what is lost half-way to the threshold."
)
# what to do where neurons leak otherwise than the chip's
REMEDIES = {
    "none": "{chip} has no leak. Train with IF neurons.",
    "linear": LINEAR,
    "crossing": LINEAR,
    "shift": "every neuron on {chip} leaks by a shift; none without was found. Train with LIF "
    "neurons, or compile with limits off.",
}


def check_convention(convention: Convention, name: str, point: StepPoint) -> None:
    """Refuse spikes and floors that the chip's neurons have not."""
    if convention.spikes == "many" and point.spikes_max == 1:
        raise RuleError(
            f"rule convention: spikes 'many': a neuron on {name} sends at most one in a timestep. "
            "Run in float, or choose spikes 'above'."
        )
    if convention.floor not in point.floors:
        raise RuleError(
            f"rule convention: floor {convention.floor!r}: membranes on {name} can have "
            f"{', '.join(map(repr, point.floors))}. Choose one of them, or run in float."
        )


def check_neurons(layer: Layer, chip: Chip, point: StepPoint, limits: bool) -> None:
    """Refuse neurons with a current, or with another leak than the chip's, in floats.

    limits: False lets a leak pass that the chip has something near for.
    """
    _check_current(layer, chip)
    _check_leak(layer, chip, point, limits)


def check_axons(layers: Sequence[Layer], chip: Chip, point: StepPoint) -> None:
    """Refuse weights that the chip's axons cannot carry, however many bits they have."""
    if point.signs == "axon":
        _check_signs(layers, chip)
    if point.axon_types:
        for layer in layers:
            _check_types(layer, chip, point.axon_types)


def axon_types(weight: NDArray[Any]) -> int:
    """Types of axons that the weights (M, N) need, each axon put into the first that it fits.

    Axons fit together where every neuron that both reach gives them the same weight. First-fit may
    find more types than the best choice would.
    """
    types: list[NDArray[Any]] = []
    for row in weight:
        for held in types:
            if not ((row != 0) & (held != 0) & (row != held)).any():
                np.copyto(held, row, where=held == 0)
                break
        else:
            types.append(row.copy())
    return len(types)


def _check_current(layer: Layer, chip: Chip) -> None:
    if layer.current_keep.any():
        raise RuleError(
            f"rule primitive: layer {layer.name!r} has a synaptic current that keeps "
            f"{layer.current_keep.max():.3g} of itself; {chip.name} adds spikes to the membrane. "
            "Train with LIF or IF neurons."
        )


def _check_leak(layer: Layer, chip: Chip, point: StepPoint, limits: bool) -> None:
    strange = (layer.membrane_keep == 1) == (point.leak == "shift")
    if not strange.any() or (point.leak != "none" and not limits):
        return
    found = f"{layer.membrane_keep[strange].min():.3g}"
    remedy = REMEDIES[point.leak].format(chip=chip.name)
    raise RuleError(
        f"rule decay-range: layer {layer.name!r} keeps {found} of its membrane; {remedy}"
    )


def _check_signs(layers: Sequence[Layer], chip: Chip) -> None:
    """A neuron excites or inhibits all that hear it, in whichever layer."""
    signs: dict[str, tuple[Any, Any]] = {}
    for layer in layers:
        for synapses in layer.synapses:
            up, down = (synapses.weight > 0).any(axis=1), (synapses.weight < 0).any(axis=1)
            before = signs.get(synapses.source, (False, False))
            signs[synapses.source] = up, down = before[0] | up, before[1] | down
            if (both := np.flatnonzero(up & down)).size:
                raise RuleError(
                    f"rule sign: layer {layer.name!r}: {both.size} of {up.size} axons from "
                    f"{synapses.source!r} have weights of both signs, the first is axon {both[0]}; "
                    f"on {chip.name} an axon has one. Train with signed axons, or compile with "
                    "limits off."
                )


def _check_types(layer: Layer, chip: Chip, most: int) -> None:
    found = axon_types(np.concatenate([s.weight for s in layer.synapses]))
    if found > most:
        raise RuleError(
            f"rule axon-types: layer {layer.name!r}: its weights need {found} types of axons, put "
            f"into the first that fits; {chip.name} has {most}, and each neuron one weight for "
            "each. Train with fewer different weights, or compile with limits off."
        )
