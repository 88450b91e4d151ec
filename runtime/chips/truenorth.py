"""TrueNorth (IBM, 28 nm, 2014): cores of 256 axons that cross 256 neurons."""

from runtime.limits import ENDS, WEIGHTS, Limits

CASSIDY = "Cassidy et al. 2013 and SANA-FE's model of it (source read)"
MEROLLA = "Merolla et al. 2014 (secondary)"

LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Scale", "IF"),
    fan_in=256,
    cores=4096,
    neurons_per_core=256,
    axons_in=256,
    weight_values=4,
    membrane_loss=(0.0, 0.0),
    recurrence=True,
    alone=False,
    sources={
        "primitives": f"{CASSIDY}: its leak is a constant, so no LIF, and no synaptic current",
        "fan_in": f"{MEROLLA}: a neuron hears the axons of its core alone",
        "cores": MEROLLA,
        "neurons_per_core": MEROLLA,
        "axons_in": MEROLLA,
        "weight_values": f"{CASSIDY}: four types of axons, a weight of each neuron for each",
        "membrane_loss": f"{CASSIDY}: its leak is a constant",
        "recurrence": f"{MEROLLA}: a spike can go to any axon",
        "alone": f"{MEROLLA}: chips tile",
    },
)
