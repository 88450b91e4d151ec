"""Xylo-Audio 3 (SynSense SYNS65302): computes as Xylo-Audio 2, with fewer hidden neurons.

The numbers of neurons and connections are what differs in rockpool's table; the arithmetic of
Xylo-Audio 2 is taken for it, and no trace of this chip was to be had.
"""

from dataclasses import replace

from runtime.chips.xylo_a2 import LIMITS as A2
from runtime.chips.xylo_a2 import ROCKPOOL, XYLO_A2

TAKEN = "taken from Xylo-Audio 2, for want of a trace of this chip"
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

XYLO_A3 = replace(
    XYLO_A2,
    name="xylo-a3",
    summary="Xylo-Audio 3: computes as Xylo-Audio 2; 992 hidden and 32 output neurons",
    limits=LIMITS,
    evidence="the arithmetic of xylo-a2; no traces of its own",
    sources={
        **{field: f"{source}; {TAKEN}" for field, source in XYLO_A2.sources.items()},
        "currents": f"{ROCKPOOL}: two synapses for hidden neurons, one for outputs",
        "shift_max": XYLO_A2.sources["shift_max"],
        "read": f"{ROCKPOOL}: 992 hidden neurons, and 32 outputs of their own",
    },
)
