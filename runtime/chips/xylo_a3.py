"""Xylo-Audio 3 (SynSense SYNS65302)."""

from dataclasses import replace

from runtime.chips.xylo_a2 import LIMITS as A2
from runtime.chips.xylo_a2 import ROCKPOOL

LIMITS = replace(
    A2,
    neurons=992,
    outputs=32,
    fan_out=1024,
    sources={
        **A2.sources,
        "neurons": ROCKPOOL,
        "outputs": ROCKPOOL,
        "fan_out": f"{ROCKPOOL}; it also says that 128 neurons hear inputs or reach outputs, which "
        "is not checked here",
    },
)
