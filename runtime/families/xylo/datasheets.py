"""The datasheets of three Xylos, in the reading of xylosim.

Xylo-Audio 2 (SynSense SYNS61201), core version 2: equal to xylosim's traces, which SynSense calls
exact; never "equal to the chip".
Xylo-Audio 3 (SynSense SYNS65302): fewer hidden neurons; numbers of neurons and connections are what
differs in rockpool's table.
Xylo-IMU (SynSense SYNS63300): one current for each neuron.

The arithmetic of Xylo-Audio 2 is taken for the other two; there was no trace of either.
"""

from dataclasses import replace

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.limits import ENDS, WEIGHTS, Limits
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.xylo.arithmetic import XyloArithmetic

XYLOSIM = "xylosim 0.1.3, core v2 (run, traces equal)"
ROCKPOOL = "rockpool's table of Xylo's cores"

XYLO_V2 = XyloArithmetic(
    weight_bits=8,
    shift_max=15,
    dash_max=15,
    currents=2,
    state=Register(16, "saturate"),
    leak=Register(16, "wrap"),
    events_max=15,
    spikes_max=31,
    output_spikes_max=1,
)

A2_LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Scale", "LIF", "CubaLIF"),
    inputs=16,
    neurons=1000,
    outputs=8,
    fan_out=64,
    fan_out_mean=64,
    input_targets=1000,
    output_sources=1000,
    weight_max=127,
    threshold_max=(1 << 15) - 1,
    current_loss=(2.0**-15, 1.0),
    membrane_loss=(2.0**-15, 1.0),
    recurrence=True,
    sources={
        "primitives": f"{XYLOSIM}: every state leaks, and no neuron has a state without spikes",
        "inputs": ROCKPOOL,
        "neurons": ROCKPOOL,
        "outputs": ROCKPOOL,
        "fan_out": ROCKPOOL,
        "fan_out_mean": f"{ROCKPOOL}: 32 to each of two synapses; here their sum (derived)",
        "input_targets": ROCKPOOL,
        "output_sources": ROCKPOOL,
        "weight_max": f"{ROCKPOOL}: 8 bits with the sign; its quantiser uses 127",
        "threshold_max": f"{XYLOSIM}: 16 bits with the sign",
        "current_loss": f"{XYLOSIM}: x >> dash, dash 0 to 15",
        "membrane_loss": f"{XYLOSIM}: x >> dash, dash 0 to 15",
        "recurrence": XYLOSIM,
        "alone": "no way to join two is published",
    },
)

XYLO_A2 = Chip(
    name="xylo-a2",
    summary="Xylo-Audio 2: 8-bit weights, 16-bit states that saturate, several spikes a timestep",
    arithmetic=XYLO_V2,
    resets=("subtract",),
    delay=1,
    delay_max=1,
    energy_tables=(),  # published for whole tasks only (docs/xylo.md)
    limits=A2_LIMITS,
    sources={
        "weight_bits": f"{ROCKPOOL}: 8 bits with the sign",
        "shift_max": "by definition: a further shift of any weight saturates 16 bits as well",
        "dash_max": f"{ROCKPOOL}: 4 bits",
        "currents": f"{ROCKPOOL}: two synapses for hidden neurons, one for outputs",
        "state": f"{XYLOSIM}: saturates at every event",
        "leak": f"{XYLOSIM}: a membrane of -32768 with a dash of 0 adds -32768, its own negative",
        "events_max": f"{XYLOSIM}; 4 bits",
        "spikes_max": f"{XYLOSIM}; 5 bits",
        "output_spikes_max": XYLOSIM,
        "read": f"{ROCKPOOL}: outputs are a population of their own",
        "resets": f"{XYLOSIM}: the threshold is taken off once a spike",
        "delay": f"{XYLOSIM}: spikes of hidden neurons arrive one timestep later, input at once",
        "delay_max": XYLOSIM,
    },
    evidence="equal to traces of xylosim 0.1.3, `spikedeploy verify`",
)


TAKEN = "taken from Xylo-Audio 2, for want of a trace of this chip"
A3_LIMITS = replace(
    A2_LIMITS,
    neurons=992,
    outputs=32,
    fan_out=1024,
    input_targets=128,
    output_sources=128,
    sources={
        **A2_LIMITS.sources,
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
    limits=A3_LIMITS,
    evidence="the arithmetic of xylo-a2; no traces of its own",
    sources={
        **{field: f"{source}; {TAKEN}" for field, source in XYLO_A2.sources.items()},
        "currents": f"{ROCKPOOL}: two synapses for hidden neurons, one for outputs",
        "shift_max": XYLO_A2.sources["shift_max"],
        "read": f"{ROCKPOOL}: 992 hidden neurons, and 32 outputs of their own",
    },
)


IMU_LIMITS = replace(
    A2_LIMITS,
    neurons=496,
    outputs=16,
    fan_out=512,
    input_targets=128,
    output_sources=128,
    sources={
        **A2_LIMITS.sources,
        "neurons": ROCKPOOL,
        "outputs": ROCKPOOL,
        "fan_out": ROCKPOOL,
        "input_targets": ROCKPOOL,
        "output_sources": ROCKPOOL,
        "fan_out_mean": f"{ROCKPOOL}: 64, which is 31,744 recurrent weights of 496 neurons",
    },
)

XYLO_IMU = replace(
    XYLO_A2,
    name="xylo-imu",
    summary="Xylo-IMU: computes as Xylo-Audio 2; one synaptic current for each neuron",
    arithmetic=replace(XYLO_V2, currents=1),
    limits=IMU_LIMITS,
    evidence="the arithmetic of xylo-a2; no traces of its own",
    sources={
        **{field: f"{source}; {TAKEN}" for field, source in XYLO_A2.sources.items()},
        "currents": f"{ROCKPOOL}: one synapse for hidden neurons",
        "shift_max": XYLO_A2.sources["shift_max"],
        "read": f"{ROCKPOOL}: 496 hidden neurons, and 16 outputs of their own",
    },
)
