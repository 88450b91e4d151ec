"""Xylo-IMU (SynSense SYNS63300)."""

from dataclasses import replace

from runtime.chips.xylo_a2 import LIMITS as A2
from runtime.chips.xylo_a2 import ROCKPOOL

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
