"""ODIN (Frenkel et al. 2019, 28 nm): 256 neurons, 8-bit membranes, event after event.

Its neurons are emulated as the LIF block of its Verilog computes. What a timestep is, is up to who
sends the time reference: here one begins with it, and then events come in the order of axons.
"""

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.limits import ENDS, WEIGHTS, Limits
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire

VERILOG = "ODIN's Verilog, commit 17819318 (source read)"
ORDER = "by definition: the chip takes events in the order in which they are sent"
LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Scale", "IF"),
    inputs=256,
    neurons=256,
    fan_in=256,
    fan_out=256,
    axon_signs=True,
    weight_max=7,
    threshold_max=255,
    membrane_loss=(0.0, 0.0),
    recurrence=True,
    sources={
        "primitives": f"{VERILOG}: its leak is a constant, so no LIF, and no synaptic current",
        "inputs": f"{VERILOG}: events name one of 256 rows of the crossbar",
        "neurons": VERILOG,
        "fan_in": f"{VERILOG}: 256 x 256 synapses",
        "fan_out": f"{VERILOG}: 256 x 256 synapses",
        "axon_signs": f"{VERILOG}: one sign for each neuron that sends",
        "weight_max": f"{VERILOG}: 3 bits",
        "threshold_max": f"{VERILOG}: 8 bits unsigned",
        "membrane_loss": f"{VERILOG}: its leak is a constant",
        "recurrence": f"{VERILOG}: spikes go back into the crossbar",
        "alone": "no way to join two is published",
    },
)

ODIN = Chip(
    name="odin",
    summary="ODIN: 3-bit weights, signs of axons, 8-bit membranes that look at every event",
    arithmetic=IntegrateAndFire(
        weight_bits=3,
        signs="axon",
        axon_types=0,
        bias_bits=0,
        leak="linear",
        leak_bits=7,
        leak_order="first",
        membrane=Register(9, "saturate"),
        floor=0,
        floors=("none", "zero"),
        adds="event",
        checks="event",
        fires="reached",
        threshold_bits=8,
        spikes_max=255,
        scaling="full",
        rounding="nearest",
    ),
    resets=("zero",),
    delay=0,
    delay_max=1,
    energy_tables=("odin",),  # one number for everything, at one voltage
    limits=LIMITS,
    sources={
        "weight_bits": f"{VERILOG}: magnitude",
        "signs": f"{VERILOG}: one sign for each neuron that sends",
        "axon_types": f"{VERILOG}: every synapse has a weight",
        "bias_bits": f"{VERILOG}: none; an axon that is sent an event in every timestep",
        "leak": f"{VERILOG}: at the time reference, not below 0",
        "leak_bits": VERILOG,
        "leak_order": "by definition: a timestep begins with the time reference",
        "membrane": f"{VERILOG}: 8 bits unsigned, which are 9 with a floor of 0; saturates",
        "floor": f"{VERILOG}: unsigned",
        "floors": f"{VERILOG}: always 0",
        "adds": f"{VERILOG}; {ORDER}",
        "checks": f"{VERILOG}: after every synaptic event, and after the time reference",
        "fires": f"{VERILOG}: at or above the threshold",
        "threshold_bits": VERILOG,
        "spikes_max": "by definition: a count of the emulator",
        "scaling": "by definition: ODIN's tools scale nothing",
        "rounding": "by definition",
        "resets": f"{VERILOG}: to 0",
        "delay": "by definition: a layer's spikes are taken in before the next time reference",
        "delay_max": "by definition: recurrent connections take one timestep",
    },
    evidence="a trace worked out by hand from the Verilog's rule; not run against the Verilog",
)
