"""SpiNNaker2 (22 nm, 152 cores): neurons are programs, so their arithmetic is a float's.

Approximate: states are float32 and weights 8 bits as its NIR importer makes them; in which order
the firmware multiplies and adds, and rounds, is not published.
"""

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.limits import ENDS, WEIGHTS, Limits, SynapticMemory
from spikedeploy.runtime.families.cuba.floating_point import CubaFloat32

S2_NIR = "py-spinnaker2, s2_nir (source read)"
PY = "py-spinnaker2's reading of NIR (source read)"
SURVEY = "secondary: surveys of the chip"

LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Conv2d", "Flatten", "SumPool2d", "Scale", "IF", "LIF", "CubaLIF"),
    cores=152,
    memory=SynapticMemory(size=128 * 1024 * 8, cost="bits", weight_bits=8),
    recurrence=True,
    alone=False,
    sources={
        "primitives": f"{PY}: models lif, lif_curr_exp and lif_conv2d; IF is a lif "
        "without a leak (derived)",
        "cores": SURVEY,
        "memory": f"{SURVEY}: 128 KB of SRAM; program and states lie there too, so the number of "
        "cores is the least that it can be (derived)",
        "recurrence": f"{PY}: a population can hear itself",
        "alone": f"{SURVEY}: chips are joined on boards",
    },
)

SPINNAKER2 = Chip(
    name="spinnaker2",
    summary="SpiNNaker2: 8-bit weights, float32 states; approximate",
    arithmetic=CubaFloat32(weight_bits=8),
    resets=("subtract", "zero"),
    delay=1,
    delay_max=1,
    energy_tables=("spinnaker2",),  # two secondary sources that disagree: an interval
    limits=LIMITS,
    sources={
        "weight_bits": f"{S2_NIR}: 127 / max|w| into a population; rounding to nearest is assumed",
        "resets": f"{S2_NIR}: subtraction is its default",
        "delay": f"{S2_NIR}: conn_delay, 1 unless given; models without delay exist",
        "delay_max": f"{S2_NIR}: longer ones were not found there",
    },
    evidence="approximate: the firmware's order of operations is not published; compared with "
    "nothing",
)
