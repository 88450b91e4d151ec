"""Choices of quantisation: which neurons share a scale, rounding, and the shift of weights."""

from dataclasses import dataclass, fields
from typing import get_args

from spikedeploy.runtime import choices
from spikedeploy.runtime.chips.registers import Rounding
from spikedeploy.runtime.errors import ConfigError

Granularity = choices.Granularity


@dataclass(frozen=True)
class Quantisation:
    """Choices of how a float network is rounded for a chip.

    granularity: "layer", one scale for all neurons of a layer (Tang et al. 2020, PopSAN);
        "channel", one for each neuron.
    rounding: "nearest", half to even; "truncate" drops fractions, as PopSAN's mapping did; None is
        what the chip's own tool does: on Loihi "nearest".
    weight_shift: [bits] by which a Xylo shifts all weights to the left; thresholds and biases
        follow. States are then finer than weights, and decays lose less to rounding; they also
        saturate sooner.
    """

    granularity: Granularity = "layer"
    rounding: Rounding | None = None
    weight_shift: int = 0

    def __post_init__(self) -> None:
        for option, allowed in (
            ("granularity", get_args(Granularity)),
            ("rounding", (*get_args(Rounding), None)),
        ):
            if (found := getattr(self, option)) not in allowed:
                choices = " or ".join(repr(each) for each in allowed if each)
                raise ConfigError(f"{option} {found!r} is unknown. Choose {choices}.")

    def describe(self) -> str:
        """The choices in words."""
        rounding = f"rounding {self.rounding!r}" if self.rounding else "the chip's own rounding"
        shift = f", weights shifted by {self.weight_shift} bits" if self.weight_shift else ""
        return f"a scale for each {self.granularity}, {rounding}{shift}"


PLAIN = Quantisation()
# what an arithmetic may leave open: Arithmetic.choices
CHOICES = tuple(each.name for each in fields(Quantisation))
