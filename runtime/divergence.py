"""The first spike in which a chip differs from the float twin."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from runtime.activity import Activity


@dataclass(frozen=True)
class Divergence:
    """Where a neuron's spikes differ, and its membranes before any reset [float units].

    inference, timestep, neuron: counted from 0.
    layer: name of the node.
    float_spikes, chip_spikes: of the neuron in the timestep.
    float_membrane, chip_membrane: NaN where a recording cannot tell.
    float_threshold, chip_threshold: above which the neuron spikes.
    """

    inference: int
    timestep: int
    layer: str
    neuron: int
    float_spikes: int
    chip_spikes: int
    float_membrane: float
    chip_membrane: float
    float_threshold: float
    chip_threshold: float

    def as_json(self) -> dict[str, Any]:
        """The fields."""
        return asdict(self)

    def describe(self) -> str:
        """The same in words."""
        return (
            f"inference {self.inference}, timestep {self.timestep}, layer {self.layer!r}, neuron "
            f"{self.neuron}; spikes on the chip: {self.chip_spikes} (membrane "
            f"{_shown(self.chip_membrane)}, threshold {self.chip_threshold:.6g}), in float: "
            f"{self.float_spikes} ({_shown(self.float_membrane)}, {self.float_threshold:.6g})"
        )


def _shown(membrane: float) -> str:
    return "not known before its reset" if np.isnan(membrane) else f"{membrane:.6g}"


def first(twin: Activity, seen: Activity, layers: Iterable[str]) -> Divergence | None:
    """The earliest of the first inference that differs; of one timestep the first layer's.

    twin, seen: of the float twin and of the chip.
    layers: in the order in which they hear each other.
    """
    found = [
        (inference, timestep, place, neuron, name)
        for place, name in enumerate(layers)
        for inference, timestep, neuron in _first(twin, seen, name)
    ]
    if not found:
        return None
    inference, timestep, _, neuron, name = min(found)
    here = (inference, timestep, neuron)
    return Divergence(
        inference=inference,
        timestep=timestep,
        layer=name,
        neuron=neuron,
        float_spikes=int(twin.spikes[name][here]),
        chip_spikes=int(seen.spikes[name][here]),
        float_membrane=float(twin.reached[name][here]),
        chip_membrane=float(seen.reached[name][here]),
        float_threshold=float(twin.thresholds[name][neuron]),
        chip_threshold=float(seen.thresholds[name][neuron]),
    )


def _first(twin: Activity, seen: Activity, name: str) -> list[tuple[int, int, int]]:
    """(inference, timestep, neuron) of a layer's first difference, if there is one."""
    different = np.argwhere(twin.spikes[name] != seen.spikes[name])[:1]
    return [(int(b), int(t), int(n)) for b, t, n in different]
