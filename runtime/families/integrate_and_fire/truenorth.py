"""TrueNorth (IBM, 28 nm, 2014): binary crossbars, four types of axons, ticks of 1 ms.

The order within a tick and the modes are published; of the widths no source was read, so they are
assumptions that can be set. Stochastic modes, and resets of negative thresholds, are not emulated.
"""

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.limits import ENDS, WEIGHTS, Limits
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire

CASSIDY = "Cassidy et al. 2013, IJCNN"
CORE = "the order of a tick as published: synapses, leak, threshold, reset"
SANAFE = "SANA-FE, models.cpp (source read)"
REVIEW = "IEEE Circuits and Systems Magazine 22(2), 2022, Table II, secondary"
ASSUMED = "assumed, not confirmed by any source that was read; an option"
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

TRUENORTH = Chip(
    name="truenorth",
    summary="TrueNorth: four weights a neuron, one for each type of axon; linear leak",
    arithmetic=IntegrateAndFire(
        weight_bits=9,
        signs="weight",
        axon_types=4,
        bias_bits=9,
        leak="crossing",
        leak_bits=8,
        leak_order="last",
        membrane=Register(20, "saturate"),
        floor=None,
        floors=("none", "zero", "threshold"),
        adds="step",
        checks="step",
        fires="reached",
        threshold_bits=18,
        spikes_max=1,
        scaling="full",
        rounding="nearest",
    ),
    resets=("zero", "subtract"),
    delay=1,
    delay_max=15,
    energy_tables=("truenorth",),  # all-in: energy of the whole chip per synaptic event
    limits=LIMITS,
    sources={
        "weight_bits": f"{ASSUMED}; a review says 8 ({REVIEW})",
        "signs": f"{CASSIDY}, secondary: a signed weight for each type",
        "axon_types": f"{CASSIDY}, secondary: types 0 to 3",
        "bias_bits": f"{ASSUMED}: the leak, used as a constant that is added",
        "leak": f"{CASSIDY}, abstract: four leak modes; toward 0, and over it: {SANAFE}",
        "leak_bits": ASSUMED,
        "leak_order": f"{CORE}; {SANAFE} has the leak first",
        "membrane": f"{ASSUMED}, and so is that it saturates",
        "floor": "the negative threshold; none unless given",
        "floors": f"{CASSIDY}, secondary: a negative threshold at which membranes may stop",
        "adds": f"{CORE}; saturation within a tick is assumed to wait for its end",
        "checks": CORE,
        "fires": f"{SANAFE}: at or above the threshold",
        "threshold_bits": ASSUMED,
        "spikes_max": CORE,
        "scaling": "by definition: TrueNorth's tools train with its weights and scale nothing",
        "rounding": "by definition",
        "resets": f"{SANAFE}: hard, linear (subtract), none; none is not emulated",
        "delay": "2.2.9 of SANA-FE (run): a spike is delivered in the next tick",
        "delay_max": ASSUMED,
    },
    evidence="equal to neurons of SANA-FE 2.2.9, but for the order of the leak; widths assumed",
)
