"""Spiker+ (Politecnico di Torino): a generator of accelerators for FPGAs, with free widths.

A cycle of its neurons fires and resets, leaks, takes in excitation, then inhibition. Seen from leak
to fire that is the same, only that a spike leaves one cycle later: hence the delay of 1.
"""

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.limits import ENDS, WEIGHTS, Limits
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire

VHDL = "Spiker's VHDL and generator, commit e61e5b06 (source read)"
DATAPATH = "a parameter; the default of neuron_datapath.vhd"
LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Scale", "LIF"),
    sources={
        "primitives": f"{VHDL}: a leak by a shift; its other neurons were not read",
        "alone": "one FPGA is synthesised at a time",
    },
)

SPIKER = Chip(
    name="spiker",
    summary="Spiker+ on an FPGA: leaks by shifts, sums that saturate, strict threshold",
    arithmetic=IntegrateAndFire(
        weight_bits=5,
        signs="weight",
        axon_types=0,
        bias_bits=0,
        leak="shift",
        leak_bits=4,
        leak_order="first",
        membrane=Register(16, "saturate"),
        floor=None,
        floors=("none",),
        adds="event",
        checks="step",
        fires="above",
        threshold_bits=15,
        spikes_max=1,
        scaling="binary",
        rounding="truncate",
    ),
    resets=("zero", "subtract"),
    delay=1,
    delay_max=1,
    energy_tables=(),  # published for whole tasks only
    limits=LIMITS,
    sources={
        "weight_bits": f"{VHDL}: {DATAPATH}; 5 to 8 are used",
        "signs": f"{VHDL}: two's complement",
        "axon_types": f"{VHDL}: every synapse has a weight",
        "bias_bits": "none was found; emulated as an axon that spikes in every timestep",
        "leak": f"{VHDL}: v - (v >>> shift), an arithmetic shift, which rounds down",
        "leak_bits": "by definition: the largest shift that a membrane of 16 bits can tell",
        "leak_order": f"{VHDL}: fire and reset, leak, excite, inhibit",
        "membrane": f"{VHDL}: saturates; width: {DATAPATH}",
        "floor": f"{VHDL}: none but the register's",
        "floors": f"{VHDL}: none but the register's",
        "adds": f"{VHDL}: one active input after another; that this is by index is assumed",
        "checks": f"{VHDL}: once a cycle",
        "fires": f"{VHDL}: strictly above",
        "threshold_bits": f"{VHDL}: as wide as the membrane, here without its sign",
        "spikes_max": f"{VHDL}: once a cycle",
        "scaling": f"{VHDL}: fraction bits",
        "rounding": f"{VHDL}: int(), toward zero",
        "resets": f"{VHDL}: fixed or subtractive",
        "delay": "derived: a cycle begins with firing, so what was reached acts in the next",
        "delay_max": "by definition: recurrent connections take one timestep",
    },
    evidence="a trace worked out by hand from the VHDL's rule; not run against the VHDL",
)
