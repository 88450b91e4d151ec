"""Xylo-IMU (SynSense SYNS63300): computes as Xylo-Audio 2, with one current for each neuron.

The arithmetic of Xylo-Audio 2 is taken for it, and no trace of this chip was to be had.
"""

from dataclasses import replace

from runtime.chips.xylo_a2 import LIMITS as A2
from runtime.chips.xylo_a2 import ROCKPOOL, XYLO_A2, XYLO_V2
from runtime.chips.xylo_a3 import TAKEN

LIMITS = replace(
    A2,
    neurons=496,
    outputs=16,
    fan_out=512,
    input_targets=128,
    output_sources=128,
    sources={
        **A2.sources,
        "neurons": ROCKPOOL,
        "outputs": ROCKPOOL,
        "fan_out": ROCKPOOL,
        "input_targets": ROCKPOOL,
        "output_sources": ROCKPOOL,
        "fan_out_mean": f"{ROCKPOOL}: 64, which is 31,744 recurrent weights of 496 neurons",
    },
)

XYLO_IMU = replace(
    XYLO_A2,
    name="xylo-imu",
    summary="Xylo-IMU: computes as Xylo-Audio 2; one synaptic current for each neuron",
    arithmetic=replace(XYLO_V2, currents=1),
    limits=LIMITS,
    evidence="the arithmetic of xylo-a2; no traces of its own",
    sources={
        **{field: f"{source}; {TAKEN}" for field, source in XYLO_A2.sources.items()},
        "currents": f"{ROCKPOOL}: one synapse for hidden neurons",
        "shift_max": XYLO_A2.sources["shift_max"],
        "read": f"{ROCKPOOL}: 496 hidden neurons, and 16 outputs of their own",
    },
)
