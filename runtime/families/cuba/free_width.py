"""Loihi's arithmetic with free bit widths: no chip that exists, to find out what one would need.

    chip("int", weight_bits=4, decay_bits=6, membrane=Register(12, "saturate"))
    --chip int:weight_bits=4,decay_bits=6,membrane=12-wrap

Neurons are those of Loihi 1 without what is peculiar to it: registers end at the largest magnitude,
decays are stored without offsets, weights use all their bits, and a spike may reset to zero or
subtract.
"""

from dataclasses import dataclass, field

from spikedeploy.runtime.chips.arithmetic import Description
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.errors import ChipError
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint

# float64, which the kernels compute in, holds every product of such a state and such a decay
_WIDEST_STATE = 36
_WIDEST_DECAY = 16
# what a synapse is stored in
_WIDEST_WEIGHT = 16


@dataclass(frozen=True)
class CubaFreeWidth(CubaFixedPoint):
    """The integer CuBa-LIF neurons of CubaFixedPoint; fields that follow from others are not given.

    weight_bits: where sign_mode is "mixed", with the sign: -(2**(n - 1) - 1) to 2**(n - 1) - 1;
        where it is "split", of the magnitude. Weights have no bits that are dropped: a narrow
        weight is a small number, and the threshold follows it.
    threshold_bits: of a threshold's mantissa, unsigned; fewer where a membrane could not be above.
    """

    weight_bits_allowed: tuple[int, ...] = field(init=False)
    threshold_max: int = field(init=False)
    decay_max: int = field(init=False)
    threshold_bits: int

    def __post_init__(self) -> None:
        mixed = self.sign_mode == "mixed"
        widths = range(2, _WIDEST_WEIGHT + 1) if mixed else range(1, _WIDEST_WEIGHT)
        largest = (self.membrane.limit - 1) >> self.mantissa_shift
        # a frozen dataclass is written on in no other way
        object.__setattr__(self, "weight_bits_allowed", tuple(widths))
        object.__setattr__(self, "threshold_max", min((1 << self.threshold_bits) - 1, largest))
        object.__setattr__(self, "decay_max", self.decay_one)
        super().__post_init__()
        self._check_widths()

    @property
    def weight_exponent_max(self) -> int:
        """None: fraction bits of the states are free."""
        return 0

    @property
    def weight_step(self) -> int:
        """Distance between two neighbouring weights."""
        return 1

    @property
    def weight_max(self) -> int:
        """Largest weight of either sign."""
        return (1 << (self.weight_bits - (self.sign_mode == "mixed"))) - 1

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""
        _, weights, membrane = super().describe()
        return Description("CuBa-LIF, free widths", f"{weights}, free", f"{membrane}, free")

    def _check_widths(self) -> None:
        if not 1 <= self.decay_bits <= _WIDEST_DECAY:
            raise ChipError(f"decay_bits is {self.decay_bits}; choose 1 to {_WIDEST_DECAY}.")
        if not 0 <= self.mantissa_shift <= _WIDEST_DECAY:
            raise ChipError(
                f"mantissa_shift is {self.mantissa_shift}; choose 0 to {_WIDEST_DECAY}."
            )
        for name in ("accumulator", "current", "push", "membrane"):
            register = getattr(self, name)
            if register.bits > _WIDEST_STATE:
                raise ChipError(f"{name} has {register.bits} bits; choose at most {_WIDEST_STATE}.")
            if register.overflow == "none" and name in ("current", "membrane"):
                raise ChipError(f"{name} must end somewhere. Choose what an overflow does.")
        if self.threshold_max < 1:
            raise ChipError(
                f"threshold_bits is {self.threshold_bits}, membrane has {self.membrane.bits} bits "
                f"and mantissa_shift is {self.mantissa_shift}: no threshold above 0 is left. "
                "Choose a wider membrane, or a smaller mantissa_shift."
            )


_DEFINED = "by definition"
_FREE = f"{_DEFINED}; free"
_FOLLOWS = f"{_DEFINED}; follows from the others"

INT = Chip(
    name="int",
    summary="no chip: free bit widths for weights, decays, thresholds and states",
    arithmetic=CubaFreeWidth(
        weight_bits=8,
        sign_mode="mixed",
        step_rounding="zero",
        exponents="exact",
        mantissa_shift=6,
        bias_mantissa_max=(1 << 15) - 1,
        bias_exponent_max=0,
        decay_bits=12,
        current_decay_offset=0,
        membrane_decay_offset=0,
        accumulator=Register(24, "clip"),
        current=Register(24, "clip"),
        push=Register(24, "none"),
        membrane=Register(24, "clip"),
        refractory=1,
        input_acts="next",
        threshold_bits=17,
    ),
    resets=("zero", "subtract"),
    delay=0,
    delay_max=63,
    energy_tables=(),
    membrane_output="probe",
    sources={
        "clocks": "by definition",
        "membrane_output": _DEFINED,
        "weight_bits": f"{_FREE}, 1 to 16",
        "weight_bits_allowed": _DEFINED,
        "sign_mode": _FREE,
        "step_rounding": f"{_DEFINED}: weights have a step of 1, so nothing is rounded",
        "exponents": f"{_DEFINED}: there are none",
        "mantissa_shift": f"{_FREE}, 0 to 16: fraction bits of the states",
        "threshold_max": _FOLLOWS,
        "threshold_bits": _FREE,
        "bias_mantissa_max": _FREE,
        "input_acts": f"{_DEFINED}: an input waits as a spike does",
        "bias_exponent_max": _FREE,
        "decay_bits": f"{_FREE}, 1 to 16",
        "decay_max": _FOLLOWS,
        "current_decay_offset": _FREE,
        "membrane_decay_offset": _FREE,
        "accumulator": f"{_FREE}, 2 to 36 bits",
        "current": f"{_FREE}, 2 to 36 bits",
        "push": f"{_FREE}; {_DEFINED} it is no register: the membrane takes it in at once",
        "membrane": f"{_FREE}, 2 to 36 bits",
        "refractory": _FREE,
        "resets": f"{_DEFINED}: both that a convention can name",
        "delay": f"{_FREE}; 0 leaves it to the convention",
        "delay_max": _FREE,
    },
    evidence="nothing to compare with: a definition",
)
