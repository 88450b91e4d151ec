"""TrueNorth, ODIN and tinyODIN: crossbars of synapses between axons and neurons.

TrueNorth (IBM, 28 nm, 2014) has binary crossbars, four types of axons and timesteps of 1 ms. The
order within a timestep and the modes are published; of the widths no primary source could be read
(Cassidy et al. 2013, Merolla et al. 2014, Akopyan et al. 2015: abstracts only), so they are
assumptions that can be set. Stochastic modes and resets of negative thresholds are not emulated.

ODIN (Frenkel et al. 2019, 28 nm) has 256 neurons with 8-bit membranes, updated event after event.
Its neurons are emulated as the LIF block of its Verilog computes. The sender of the time reference
decides what a timestep is: here one begins with it, and then events come in the order of axons.
tinyODIN (the same authors) is ODIN without learning, with weights that have signs and membranes of
12 bits.
"""

from dataclasses import replace

from spikedeploy.runtime.chips.chip import ALL_AT_ONCE, Chip
from spikedeploy.runtime.chips.limits import ENDS, WEIGHTS, Limits
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import (
    WITHOUT_QUEUE,
    IntegrateAndFire,
)

_CASSIDY = "Cassidy et al. 2013, IJCNN"
_CORE = "the order of a tick as published: synapses, leak, threshold, reset"
_SANAFE = "SANA-FE, models.cpp (source read)"
_REVIEW = "IEEE Circuits and Systems Magazine 22(2), 2022, Table II, secondary"
_ASSUMED = "assumed, not confirmed by any source that was read; an option"
_MEROLLA = "Merolla et al. 2014, Science 345:668, abstract (read)"
_NEMO = "NeMo, a simulator of TrueNorth, tn_neuron.h (source read; secondary)"

_TRUENORTH_LIMITS = Limits(
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
        "primitives": f"{_CASSIDY}: its leak is a constant, so no LIF, and no synaptic current",
        "fan_in": f"{_REVIEW}: a neuron hears the 256 axons of its core alone",
        "cores": f"{_MEROLLA}: 4,096",
        "neurons_per_core": f"{_MEROLLA}: one million neurons in 4,096 cores; {_REVIEW}: 256",
        "axons_in": f"{_MEROLLA}: 256 million synapses are 256 x 256 a core (derived); {_REVIEW}",
        "weight_values": f"{_CASSIDY}: four types of axons, a weight of each neuron for each",
        "membrane_loss": f"{_CASSIDY}: its leak is a constant",
        "recurrence": f"{_MEROLLA}: a network on the chip joins the cores, so that a spike can go "
        "to any axon (derived)",
        "alone": f"{_MEROLLA}: chips are tiled in two dimensions",
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
    limits=_TRUENORTH_LIMITS,
    clocks=ALL_AT_ONCE,
    sources={
        "clocks": "a global tick, nominally 1 ms, starts every core's pass over its neurons "
        "(Merolla et al. 2014, Science 345:668; Akopyan et al. 2015, IEEE TCAD 34(10):1537)",
        "membrane_output": "no way for a membrane was found in any source that was read",
        "weight_bits": f"{_ASSUMED}; a review says 8 ({_REVIEW})",
        "signs": f"{_CASSIDY}, secondary: a signed weight for each type",
        "axon_types": f"{_CASSIDY}, secondary: types 0 to 3",
        "bias_bits": f"{_ASSUMED}: the leak, used as a constant that is added",
        "leak": f"{_CASSIDY}, abstract: four leak modes; toward 0, and over it: {_SANAFE}",
        "leak_bits": _ASSUMED,
        "leak_order": f"{_CORE}; {_SANAFE} has the leak first",
        "membrane": f"{_ASSUMED}, and so is that it saturates",
        "floor": "the negative threshold; none unless given",
        "floors": f"{_CASSIDY}, secondary: a negative threshold at which membranes may stop",
        "adds": f"{_CORE}; saturation within a tick is assumed to wait for its end",
        "checks": _CORE,
        "fires": f"{_SANAFE}: at or above the threshold",
        "threshold_bits": _ASSUMED,
        "spikes_max": _CORE,
        "scaling": "by definition: TrueNorth's tools train with its weights and scale nothing",
        "rounding": "by definition",
        "reset_at": _CORE,
        **WITHOUT_QUEUE,
        "resets": f"{_SANAFE}: hard, linear (subtract), none; none is not emulated",
        "delay": "2.2.9 of SANA-FE (run): a spike is delivered in the next tick",
        "delay_max": f"{_NEMO}: 1 to 15",
    },
    evidence="equal to neurons of SANA-FE 2.2.9, but for the order of the leak; widths assumed",
)


_VERILOG = "ODIN's Verilog, commit 17819318 (source read)"
_RTL = "equal to its RTL in simulation (Verilator 5.006, commit {}), `spikedeploy verify`"
_HOST = "by definition: with the queue on, the host waits until the chip is idle"
_ORDER = "by definition: the chip takes events in the order in which they are sent"
_ODIN_LIMITS = Limits(
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
        "primitives": f"{_VERILOG}: its leak is a constant, so no LIF, and no synaptic current",
        "inputs": f"{_VERILOG}: events name one of 256 rows of the crossbar",
        "neurons": _VERILOG,
        "fan_in": f"{_VERILOG}: 256 x 256 synapses",
        "fan_out": f"{_VERILOG}: 256 x 256 synapses",
        "axon_signs": f"{_VERILOG}: one sign for each neuron that sends",
        "weight_max": f"{_VERILOG}: 3 bits",
        "threshold_max": f"{_VERILOG}: 8 bits unsigned",
        "membrane_loss": f"{_VERILOG}: its leak is a constant",
        "recurrence": f"{_VERILOG}: spikes go back into the crossbar",
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
        queue_entries=32,
    ),
    resets=("zero",),
    delay=0,
    delay_max=1,
    energy_tables=("odin",),  # one number for everything, at one voltage
    limits=_ODIN_LIMITS,
    sources={
        "clocks": "no timestep of its own: the host sends time references, to all neurons or to "
        f"one, and decides when spikes are relayed ({_VERILOG}, doc/README.md, 2.2.1)",
        "membrane_output": "no way for a membrane was found in any source that was read",
        "weight_bits": f"{_VERILOG}: magnitude",
        "signs": f"{_VERILOG}: one sign for each neuron that sends",
        "axon_types": f"{_VERILOG}: every synapse has a weight",
        "bias_bits": f"{_VERILOG}: none; an axon that is sent an event in every timestep",
        "leak": f"{_VERILOG}: at the time reference, not below 0",
        "leak_bits": _VERILOG,
        "leak_order": "by definition: a timestep begins with the time reference",
        "membrane": f"{_VERILOG}: 8 bits unsigned, which are 9 with a floor of 0; saturates",
        "floor": f"{_VERILOG}: unsigned",
        "floors": f"{_VERILOG}: always 0",
        "adds": f"{_VERILOG}; {_ORDER}",
        "checks": f"{_VERILOG}: after every synaptic event, and after the time reference",
        "fires": f"{_VERILOG}: at or above the threshold",
        "threshold_bits": _VERILOG,
        "spikes_max": "by definition: a count of the emulator",
        "scaling": "by definition: ODIN's tools scale nothing",
        "rounding": "by definition",
        "reset_at": f"{_VERILOG}: with the spike",
        "queue": f"{_VERILOG}: its scheduler, in a closed loop; off is an open loop in which the "
        "host relays spikes",
        "queue_entries": f"{_VERILOG}: the scheduler's main FIFO, the event in work included",
        "host": _HOST,
        "resets": f"{_VERILOG}: to 0",
        "delay": "by definition: a layer's spikes are taken in before the next time reference",
        "delay_max": "by definition: recurrent connections that the host relays take one timestep",
    },
    evidence=_RTL.format("17819318"),
)

_TINY = "tinyODIN's Verilog, commit 18656534 (source read)"
_OF_ODIN = {name: source.replace(_VERILOG, _TINY) for name, source in ODIN.sources.items()}
_LIMITS_OF_ODIN = {name: s.replace(_VERILOG, _TINY) for name, s in _ODIN_LIMITS.sources.items()}

TINYODIN = replace(
    ODIN,
    name="tinyodin",
    summary="tinyODIN: 4-bit weights with signs, 12-bit membranes that look at every event",
    arithmetic=replace(
        ODIN.arithmetic,
        weight_bits=4,
        signs="weight",
        membrane=Register(12, "saturate"),
        floor=None,
        floors=("none",),
        threshold_bits=11,
        queue_entries=128,
    ),
    energy_tables=(),  # no energy of it was published
    limits=replace(
        _ODIN_LIMITS,
        axon_signs=False,
        threshold_max=(1 << 11) - 1,
        sources={
            **{k: s for k, s in _LIMITS_OF_ODIN.items() if k != "axon_signs"},
            "weight_max": f"{_TINY}: 4 bits with the sign",
            "threshold_max": f"{_TINY}: 12 bits unsigned, of which a membrane reaches 11",
        },
    ),
    sources={
        **_OF_ODIN,
        "weight_bits": f"{_TINY}: 4 bits",
        "signs": f"{_TINY}: two's complement",
        "leak": f"{_TINY}: at the time reference, toward 0",
        "membrane": f"{_TINY}: 12 bits in two's complement; saturates",
        "floor": f"{_TINY}: none but the register's",
        "floors": f"{_TINY}: none but the register's",
        "threshold_bits": f"{_TINY}: 12 bits unsigned; a membrane never reaches 2048 to 4095",
        "scaling": "by definition: tinyODIN's tools scale nothing",
    },
    evidence=_RTL.format("18656534"),
)
