"""SpiNNaker2 (22 nm, 152 cores): neurons are programs, so their arithmetic is a float's.

Approximate: states are float32 and weights 8 bits as its NIR importer makes them; in which order
the firmware multiplies and adds, and rounds, is not published.
"""

from runtime.chip import Chip
from runtime.float_point import FloatPoint

S2_NIR = "py-spinnaker2, s2_nir (source read)"

SPINNAKER2 = Chip(
    name="spinnaker2",
    summary="SpiNNaker2: 8-bit weights, float32 states; approximate",
    arithmetic=FloatPoint(weight_bits=8),
    resets=("subtract", "zero"),
    delay=1,
    delay_max=1,
    energy_tables=(),  # published figures disagree, and none is primary
    sources={
        "weight_bits": f"{S2_NIR}: 127 / max|w| into a population; rounding to nearest is assumed",
        "resets": f"{S2_NIR}: subtraction is its default",
        "delay": f"{S2_NIR}: conn_delay, 1 unless given; models without delay exist",
        "delay_max": f"{S2_NIR}: longer ones were not found there",
    },
    evidence="approximate: the firmware's order of operations is not published; compared with "
    "nothing",
)
