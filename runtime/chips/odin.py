"""ODIN (Frenkel et al. 2019, 28 nm): one crossbar of 256 neurons."""

from runtime.limits import ENDS, WEIGHTS, Limits

VERILOG = "ODIN's Verilog (source read)"

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
