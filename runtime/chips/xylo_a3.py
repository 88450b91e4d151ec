"""Xylo-Audio 3 (SynSense SYNS65302)."""

from dataclasses import replace

from runtime.chips.xylo_a2 import LIMITS as A2
from runtime.chips.xylo_a2 import ROCKPOOL

LIMITS = replace(
    A2,
    neurons=992,
    outputs=32,
    fan_out=1024,
    input_targets=128,
    output_sources=128,
    sources={
        **A2.sources,
        "neurons": ROCKPOOL,
        "outputs": ROCKPOOL,
        "fan_out": ROCKPOOL,
        "input_targets": ROCKPOOL,
        "output_sources": ROCKPOOL,
    },
)
