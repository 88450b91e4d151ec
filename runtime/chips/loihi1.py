"""Loihi 1 (Intel, 14 nm, 2018) in the reading of lava's bit-accurate models.

Three emulators agree on decays rounded toward zero, a strict threshold and reset to zero, and
differ in what the fields step_rounding, accumulator, current, membrane, the decay offsets and
refractory say; those were not settled by anything published. Equal to lava's traces, that is, not
"equal to the chip".
"""

from runtime.chip import Chip, FixedPoint
from runtime.fixed import Register

LAVA = "lava-nc 0.10.0, bit-accurate LIF and Dense models (source read, traces equal)"
NENGO = "nengo-loihi 1.1.0, emulator and discretisation (source read)"
DAVIES = "Davies et al. 2018, IEEE Micro 38(1)"

LOIHI1 = Chip(
    name="loihi1",
    summary="Loihi 1: 8-bit weights, 12-bit decays, 24-bit states, in lava's reading",
    fixed=FixedPoint(
        weight_bits=8,
        weight_bits_allowed=(1, 2, 3, 4, 5, 6, 8),
        sign_mode="split",
        step_rounding="floor",
        mantissa_shift=6,
        threshold_max=(1 << 17) - 1,
        bias_mantissa_max=(1 << 12) - 1,
        bias_exponent_max=7,
        decay_bits=12,
        current_decay_offset=1,
        membrane_decay_offset=0,
        accumulator=Register(22, "none"),
        current=Register(24, "wrap-once"),
        membrane=Register(24, "clip"),
        refractory=1,
    ),
    resets=("zero",),
    delay=1,
    delay_max=62,
    energy_tables=("davies2018", "sanafe"),
    sources={
        "weight_bits": f"{DAVIES}, p. 87: 1 to 9 bits with the sign",
        "weight_bits_allowed": f"{NENGO}: 7 is not encodable",
        "sign_mode": f"{DAVIES}, p. 87; split as PopSAN was mapped (Tang et al. 2020)",
        "step_rounding": f"{LAVA}; brian2_loihi 0.5.2 rounds toward zero",
        "mantissa_shift": f"{LAVA}; all emulators agree",
        "threshold_max": f"{LAVA}: 17 bits unsigned; all emulators agree",
        "bias_mantissa_max": f"{NENGO}: 13 bits signed, -4096 unused",
        "bias_exponent_max": f"{LAVA}: 3 bits",
        "decay_bits": f"{LAVA}; all emulators agree",
        "current_decay_offset": f"{LAVA} and {NENGO}; brian2_loihi takes the effective decay",
        "membrane_decay_offset": f"{LAVA} and {NENGO}",
        "accumulator": f"{NENGO}: 21 bits and sign, wraps; lava does not model its overflow",
        "current": f"{LAVA}: 24 bits, one wrap; nengo-loihi wraps in two's complement",
        "membrane": f"{LAVA}: 24 bits, clips; nengo-loihi too",
        "refractory": "none in lava's bit-accurate model; 1 to 64 on the chip (nengo-loihi)",
        "resets": "all emulators agree: to zero, the current stays",
        "delay": f"{LAVA}: a spike arrives one timestep after it was emitted",
        "delay_max": f"{DAVIES}, p. 92: 6 bits",
    },
)
