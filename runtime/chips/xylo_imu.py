"""Xylo-IMU (SynSense SYNS63300)."""

from dataclasses import replace

from runtime.chips.xylo_a2 import LIMITS as A2
from runtime.chips.xylo_a2 import ROCKPOOL

LIMITS = replace(
    A2,
    neurons=496,
    outputs=16,
    fan_out=512,
    sources={
        **A2.sources,
        "neurons": ROCKPOOL,
        "outputs": ROCKPOOL,
        "fan_out": f"{ROCKPOOL}; it also says that 128 neurons hear inputs or reach outputs, which "
        "is not checked here",
        "fan_out_mean": f"{ROCKPOOL}: 64, which is 31,744 recurrent weights of 496 neurons",
    },
)
