"""The integer CuBa-LIF arithmetic of Loihi."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.errors import ChipError

SignMode = Literal["split", "mixed"]
StepRounding = Literal["floor", "zero"]
Exponents = Literal["sum", "weight", "exact"]
CHOICES = {
    "sign_mode": get_args(SignMode),
    "step_rounding": get_args(StepRounding),
    "exponents": get_args(Exponents),
}


@dataclass(frozen=True)
class CubaFixedPoint:
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

    backends: ClassVar[Mapping[str, str]] = {
        "numpy": "spikedeploy.runtime.families.cuba_numpy.pipeline:NumpyPipeline",
        "numba": "spikedeploy.runtime.families.cuba_numba.pipeline:NumbaPipeline",
    }

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
