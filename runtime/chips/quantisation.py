"""Choices of quantisation: which neurons share a scale, rounding, tuning."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import get_args

from spikedeploy.runtime import choices
from spikedeploy.runtime.chips.registers import Rounding
from spikedeploy.runtime.errors import ConfigError

Granularity = choices.Granularity


@dataclass(frozen=True)
class Tuning:
    """Factors that calibration found for a layer (runtime.analysis.calibration).

    clip_ratio: below 1, the part of the largest scale that is used, which leaves headroom; above 1,
        the largest weight over what the chip holds: it is clipped, so that the others keep more of
        their bits.
    threshold: the thresholds are multiplied by this before they are rounded.
    """

    clip_ratio: float = 1.0
    threshold: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 < value < float("inf"):
                raise ConfigError(f"tuning: {name} is {value}; it must be above 0 and finite.")


UNTUNED = Tuning()


@dataclass(frozen=True)
class Quantisation:
    """Choices of how a float network is rounded for a chip.

    granularity: "layer", one scale for all neurons of a layer (Tang et al. 2020, PopSAN);
        "channel", one for each neuron.
    rounding: "nearest", half to even; "truncate" drops fractions, as PopSAN's mapping did; None is
        what the chip's own tool does: on Loihi "nearest".
    tuned: layer -> what calibration found.
    weight_shift: [bits] by which a Xylo shifts all weights to the left; thresholds and biases
        follow. States are then finer than weights, and decays lose less to rounding; they also
        saturate sooner.
    """

    granularity: Granularity = "layer"
    rounding: Rounding | None = None
    tuned: Mapping[str, Tuning] = field(default_factory=dict, hash=False)
    weight_shift: int = 0

    def __post_init__(self) -> None:
        for option, allowed in (
            ("granularity", get_args(Granularity)),
            ("rounding", (*get_args(Rounding), None)),
        ):
            if (found := getattr(self, option)) not in allowed:
                choices = " or ".join(repr(each) for each in allowed if each)
                raise ConfigError(f"{option} {found!r} is unknown. Choose {choices}.")

    def tuning_for(self, layer: str) -> Tuning:
        """The tuning of a layer."""
        return self.tuned.get(layer, UNTUNED)

    def describe(self) -> str:
        """The choices in words."""
        tuned = [
            f"; {name!r}: reach {found.clip_ratio:.3g}, thresholds times {found.threshold:.3g}"
            for name, found in self.tuned.items()
            if found != UNTUNED
        ]
        rounding = f"rounding {self.rounding!r}" if self.rounding else "the chip's own rounding"
        shift = f", weights shifted by {self.weight_shift} bits" if self.weight_shift else ""
        return f"a scale for each {self.granularity}, {rounding}{shift}{''.join(tuned)}"


PLAIN = Quantisation()
# what an arithmetic may leave open: Arithmetic.choices
CHOICES = tuple(each.name for each in fields(Quantisation))
