"""No chip that exists: a family with free bit widths, to find out what one would need.

    chip("int", weight_bits=4, decay_bits=6, membrane=Register(12, "saturate"))
    --chip int:weight_bits=4,decay_bits=6,membrane=12-wrap

Neurons are those of Loihi 1 without what is peculiar to it: registers end at the largest magnitude,
decays are stored without offsets, weights use all their bits, and a spike may reset to zero or
subtract.
"""

from runtime.chip import Chip
from runtime.fixed import Register
from runtime.int_point import IntPoint

DEFINED = "by definition"
FREE = f"{DEFINED}; free"
FOLLOWS = f"{DEFINED}; follows from the others"

INT = Chip(
    name="int",
    summary="no chip: free bit widths for weights, decays, thresholds and states",
    arithmetic=IntPoint(
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
        threshold_bits=17,
    ),
    resets=("zero", "subtract"),
    delay=0,
    delay_max=63,
    energy_tables=(),
    sources={
        "weight_bits": f"{FREE}, 1 to 16",
        "weight_bits_allowed": DEFINED,
        "sign_mode": FREE,
        "step_rounding": f"{DEFINED}: weights have a step of 1, so nothing is rounded",
        "exponents": f"{DEFINED}: there are none",
        "mantissa_shift": f"{FREE}, 0 to 16: fraction bits of the states",
        "threshold_max": FOLLOWS,
        "threshold_bits": FREE,
        "bias_mantissa_max": FREE,
        "bias_exponent_max": FREE,
        "decay_bits": f"{FREE}, 1 to 16",
        "decay_max": FOLLOWS,
        "current_decay_offset": FREE,
        "membrane_decay_offset": FREE,
        "accumulator": f"{FREE}, 2 to 36 bits",
        "current": f"{FREE}, 2 to 36 bits",
        "push": f"{FREE}; {DEFINED} it is no register: the membrane takes it in at once",
        "membrane": f"{FREE}, 2 to 36 bits",
        "refractory": FREE,
        "resets": f"{DEFINED}: both that a convention can name",
        "delay": f"{FREE}; 0 leaves it to the convention",
        "delay_max": FREE,
    },
    evidence="nothing to compare with: a definition",
)
