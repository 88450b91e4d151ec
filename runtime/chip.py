"""The datasheet of a chip: widths, rounding, overflow, limits, delays."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal, get_args

from runtime.chip_options import like, overridden, spelled
from runtime.chips import CHIPS
from runtime.errors import ChipError
from runtime.event_point import EventPoint
from runtime.fixed import Register
from runtime.float_point import FloatPoint
from runtime.limits import Limits
from runtime.step_point import StepPoint

__all__ = ["CHIPS", "Chip", "FixedPoint", "chip"]

SignMode = Literal["split", "mixed"]
StepRounding = Literal["floor", "zero"]
Exponents = Literal["sum", "weight", "exact"]
CHOICES = {
    "sign_mode": get_args(SignMode),
    "step_rounding": get_args(StepRounding),
    "exponents": get_args(Exponents),
}


@dataclass(frozen=True)
class FixedPoint:
    """The integer CuBa-LIF arithmetic of a chip.

    weight_bits: stored bits of a weight's magnitude; fewer than the widest drop low bits.
    weight_bits_allowed: what may be chosen.
    sign_mode: "split" keeps excitatory and inhibitory weights in lists of their own, all bits
        magnitude; "mixed" spends one bit on the sign, so the weight's step doubles.
    step_rounding: where a mixed weight goes that is no multiple of the step; the emulators
        differ for negative ones. Split weights go toward zero in all of them.
    exponents: what a negative weight exponent rounds down: "sum", that of the weights of a list
        that arrive together; "weight", each weight by itself; "exact", nothing.
    mantissa_shift: weights and thresholds are multiplied by 2**this to meet the states.
    threshold_max: largest threshold mantissa.
    bias_mantissa_max, bias_exponent_max: a voltage bias is mantissa * 2**exponent.
    decay_bits: a decay is a fraction of 2**this.
    decay_max: largest number in a decay's register.
    current_decay_offset: added to the current's decay register by the hardware.
    membrane_decay_offset: likewise for the membrane.
    accumulator: sum of the weights that arrive in a timestep, after the shift.
    current, membrane: the two states.
    push: the current and the voltage bias, on their way to the membrane.
    refractory: timesteps from a spike to the next possible one; 1 is none.
    """

    weight_bits: int
    weight_bits_allowed: tuple[int, ...]
    sign_mode: SignMode
    step_rounding: StepRounding
    exponents: Exponents
    mantissa_shift: int
    threshold_max: int
    bias_mantissa_max: int
    bias_exponent_max: int
    decay_bits: int
    decay_max: int
    current_decay_offset: int
    membrane_decay_offset: int
    accumulator: Register
    current: Register
    push: Register
    membrane: Register
    refractory: int

    def __post_init__(self) -> None:
        if self.weight_bits not in self.weight_bits_allowed:
            raise ChipError(
                f"weight_bits is {self.weight_bits}; the chip stores one of "
                f"{', '.join(map(str, self.weight_bits_allowed))}."
            )
        for option, allowed in CHOICES.items():
            if (found := getattr(self, option)) not in allowed:
                choices = " or ".join(map(repr, allowed))
                raise ChipError(f"{option} {found!r} is unknown. Choose {choices}.")
        if not self.weight_max:
            raise ChipError(
                "weight_bits is 1 and sign_mode 'mixed': the bit is the sign, and nothing is left "
                "for the weight. Choose more bits, or 'split'."
            )
        if self.refractory < 1:
            raise ChipError(f"refractory is {self.refractory}; the least is 1, which is none.")

    @property
    def weight_step(self) -> int:
        """Distance between two neighbouring weights, a power of two."""
        dropped = max(self.weight_bits_allowed) - self.weight_bits
        return 1 << (dropped + (self.sign_mode == "mixed"))

    @property
    def weight_max(self) -> int:
        """Largest weight of either sign."""
        widest = 1 << max(self.weight_bits_allowed)
        return int((widest - 1) // self.weight_step * self.weight_step)

    @property
    def decay_one(self) -> int:
        """The decay that leaves nothing."""
        return 1 << self.decay_bits

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]."""
        return self.current.bits, self.membrane.bits


@dataclass(frozen=True)
class Chip:
    """Everything about a chip that decides what a network does on it.

    name: as in the table CHIPS.
    summary: one line.
    arithmetic: what its numbers are and how they are added up; None computes in float64.
    resets: what a spike may do to the membrane, as in Convention.
    delay: [timesteps] from a spike to its arrival in the next layer; 0 leaves it to the
        convention.
    delay_max: [timesteps] longest delay that a synapse can add up to.
    energy_tables: names of the tables in runtime.energy that price its events.
    sources: field name to where its value comes from and how sure it is.
    evidence: what its emulation was compared with, and what came out.
    limits: what fits on it, with sources of their own; None where nothing limits it.
    """

    name: str
    summary: str
    arithmetic: FixedPoint | EventPoint | StepPoint | FloatPoint | None
    resets: tuple[str, ...]
    delay: int
    delay_max: int
    energy_tables: tuple[str, ...]
    sources: Mapping[str, str] = field(compare=False)
    evidence: str = field(default="compared with nothing", compare=False)
    limits: Limits | None = None

    @property
    def fixed(self) -> FixedPoint | None:
        """Its arithmetic, if it is that of Loihi."""
        return self.arithmetic if isinstance(self.arithmetic, FixedPoint) else None

    @property
    def events(self) -> EventPoint | None:
        """Its arithmetic, if it is that of Xylo."""
        return self.arithmetic if isinstance(self.arithmetic, EventPoint) else None

    @property
    def steps(self) -> StepPoint | None:
        """Its arithmetic, if it is that of neurons without a synaptic current."""
        return self.arithmetic if isinstance(self.arithmetic, StepPoint) else None

    @property
    def spikes_max(self) -> int:
        """Spikes of a neuron in a timestep."""
        numbers = self.events or self.steps
        return numbers.spikes_max if numbers else 1

    @property
    def input_spikes_max(self) -> int:
        """Spikes of an input channel in a timestep."""
        return self.events.events_max if self.events else 1


def chip(name: str, **overrides: Any) -> Chip:  # noqa: ANN401
    """The chip called `name`, with some fields of it or of its arithmetic replaced.

    They may also stand in the name, as on a command line: "int:weight_bits=4,membrane=12". Where a
    register is given as a number, that is its bits; "12-wrap" says what overflows do too.
    """
    name, _, options = name.partition(":")
    if name not in CHIPS:
        raise ChipError(f"there is no chip {name!r}{like(name, CHIPS)}. Known: {', '.join(CHIPS)}.")
    module, attribute = CHIPS[name].split(":")
    datasheet: Chip = getattr(import_module(module), attribute)
    return overridden(datasheet, {**spelled(datasheet, options), **overrides})
