"""Loihi 2 (Intel 4, 2021) with the default neuron, which computes as Loihi 1's does.

Neurons of Loihi 2 are microcode; this is what the default CuBa-LIF does as far as one public trace
of a board shows: a single neuron, membranes of 0 and above, a current that forgets at once.
"""

from dataclasses import replace

from spikedeploy.runtime.chips.limits import SynapticMemory
from spikedeploy.runtime.families.cuba.loihi1 import LAVA, LIMITS, LOIHI1

BOARD = (
    "one LIF neuron on a board, NIR paper 01_lif: the rule gives its spikes in 1000 timesteps and "
    "all membranes but those at 4 spikes, where the probe reads 128"
)
GUESS = "taken from Loihi 1; no public source for Loihi 2"

AGGREGATORS = "secondary: sites that collect datasheets; not verified in Intel's own"

LIMITS2 = replace(
    LIMITS,
    cores=120,
    neurons_per_core=8192,
    memory=SynapticMemory(size=192 * 1024 * 8, cost="words", weight_bits=8),
    decays=None,
    thresholds=None,
    sources={
        **{field: f"{source}; {GUESS}" for field, source in LIMITS.sources.items()},
        "cores": f"120 or 128, sources differ ({AGGREGATORS})",
        "neurons_per_core": f"at most, with the smallest neurons ({AGGREGATORS})",
        "memory": f"about 192 KB a core, neurons included ({AGGREGATORS}); the words of Loihi 1",
        "axons_in": "a user's report in a public issue (secondary)",
        "axons_out": "a user's report in a public issue (secondary)",
        "input_cores": f"as PopSAN's on Loihi 1; {GUESS}",
    },
)

LOIHI2 = replace(
    LOIHI1,
    name="loihi2",
    summary="Loihi 2 with its default neuron, which computes as Loihi 1's does",
    energy_tables=(),  # no public energy per operation
    limits=LIMITS2,
    sources={
        **{field: f"{LAVA}, as on Loihi 1; {GUESS}" for field in LOIHI1.sources},
        "mantissa_shift": BOARD,
        "decay_bits": BOARD,
        "membrane_decay_offset": BOARD,
        "resets": f"{BOARD}; microcode could do others",
        "delay": BOARD,
        "delay_max": f"lava-nc 0.10.0, DelayDense: 6 bits; {GUESS}",
    },
    evidence="spikes of one neuron on a board, 1000 timesteps, `spikedeploy verify`",
)
