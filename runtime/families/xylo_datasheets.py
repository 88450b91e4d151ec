"""The datasheets of three Xylos, as xylosim models them.

Xylo-Audio 2 (SynSense SYNS61201), core version 2: equal to xylosim's traces, which SynSense calls
exact; never "equal to the chip".
Xylo-Audio 3 (SynSense SYNS65302): fewer hidden neurons; numbers of neurons and connections are what
differs in rockpool's table.
Xylo-IMU (SynSense SYNS63300): one current for each neuron.

The arithmetic of Xylo-Audio 2 is taken for the other two; there was no trace of either.
"""

from dataclasses import replace

from spikedeploy.runtime.chips.chip import ALL_AT_ONCE, Chip
from spikedeploy.runtime.chips.limits import ENDS, WEIGHTS, Limits
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.xylo import XyloArithmetic

_XYLOSIM = "xylosim 0.1.3, core v2 (run, traces equal)"
_ROCKPOOL = "rockpool's table of Xylo's cores"

_XYLO_V2 = XyloArithmetic(
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

_A2_LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, "Scale", "LIF", "CubaLIF", "LI", "CubaLI"),
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
        "primitives": f"{_XYLOSIM}: every state leaks; LI and CubaLI are outputs whose membranes "
        "are read (derived)",
        "inputs": _ROCKPOOL,
        "neurons": _ROCKPOOL,
        "outputs": _ROCKPOOL,
        "fan_out": _ROCKPOOL,
        "fan_out_mean": f"{_ROCKPOOL}: 32 to each of two synapses; here their sum (derived)",
        "input_targets": _ROCKPOOL,
        "output_sources": _ROCKPOOL,
        "weight_max": f"{_ROCKPOOL}: 8 bits with the sign; its quantiser uses 127",
        "threshold_max": f"{_XYLOSIM}: 16 bits with the sign",
        "current_loss": f"{_XYLOSIM}: x >> dash, dash 0 to 15",
        "membrane_loss": f"{_XYLOSIM}: x >> dash, dash 0 to 15",
        "recurrence": _XYLOSIM,
        "alone": "no way to join two is published",
    },
)

XYLO_A2 = Chip(
    name="xylo-a2",
    summary="Xylo-Audio 2: 8-bit weights, 16-bit states that saturate, several spikes a timestep",
    arithmetic=_XYLO_V2,
    resets=("subtract",),
    delay=1,
    delay_max=1,
    energy_tables=(),  # published for whole tasks only (docs/xylo.md)
    limits=_A2_LIMITS,
    membrane_output="probe",
    clocks=ALL_AT_ONCE,
    sources={
        "clocks": "a global timestep dt in which all neurons update (rockpool.ai, overview of the "
        "Xylo family); xylosim 0.1.3 does so",
        "membrane_output": "rockpool's XyloMonitor: output_mode 'Vmem'; its XyloSamna records "
        "the membranes of outputs in each timestep (source read)",
        "weight_bits": f"{_ROCKPOOL}: 8 bits with the sign",
        "shift_max": "by definition: a further shift of any weight saturates 16 bits as well",
        "dash_max": f"{_ROCKPOOL}: 4 bits",
        "currents": f"{_ROCKPOOL}: two synapses for hidden neurons, one for outputs",
        "state": f"{_XYLOSIM}: saturates at every event",
        "leak": f"{_XYLOSIM}: a membrane of -32768 with a dash of 0 adds -32768, its own negative",
        "events_max": f"{_XYLOSIM}; 4 bits",
        "spikes_max": f"{_XYLOSIM}; 5 bits",
        "output_spikes_max": _XYLOSIM,
        "read": f"{_ROCKPOOL}: outputs are a population of their own",
        "resets": f"{_XYLOSIM}: the threshold is taken off once a spike",
        "delay": f"{_XYLOSIM}: spikes of hidden neurons arrive one timestep later, input at once",
        "delay_max": _XYLOSIM,
    },
    evidence="equal to traces of xylosim 0.1.3, `spikedeploy verify`",
)


_TAKEN = "taken from Xylo-Audio 2, for want of a trace of this chip"
_A3_LIMITS = replace(
    _A2_LIMITS,
    neurons=992,
    outputs=32,
    fan_out=1024,
    input_targets=128,
    output_sources=128,
    sources={
        **_A2_LIMITS.sources,
        "neurons": _ROCKPOOL,
        "outputs": _ROCKPOOL,
        "fan_out": _ROCKPOOL,
        "input_targets": _ROCKPOOL,
        "output_sources": _ROCKPOOL,
    },
)

XYLO_A3 = replace(
    XYLO_A2,
    name="xylo-a3",
    summary="Xylo-Audio 3: computes as Xylo-Audio 2; 992 hidden and 32 output neurons",
    limits=_A3_LIMITS,
    evidence="the arithmetic of xylo-a2; no traces of its own",
    sources={
        **{field: f"{source}; {_TAKEN}" for field, source in XYLO_A2.sources.items()},
        "currents": f"{_ROCKPOOL}: two synapses for hidden neurons, one for outputs",
        "shift_max": XYLO_A2.sources["shift_max"],
        "read": f"{_ROCKPOOL}: 992 hidden neurons, and 32 outputs of their own",
    },
)


_IMU_LIMITS = replace(
    _A2_LIMITS,
    neurons=496,
    outputs=16,
    fan_out=512,
    input_targets=128,
    output_sources=128,
    sources={
        **_A2_LIMITS.sources,
        "neurons": _ROCKPOOL,
        "outputs": _ROCKPOOL,
        "fan_out": _ROCKPOOL,
        "input_targets": _ROCKPOOL,
        "output_sources": _ROCKPOOL,
        "fan_out_mean": f"{_ROCKPOOL}: 64, which is 31,744 recurrent weights of 496 neurons",
    },
)

XYLO_IMU = replace(
    XYLO_A2,
    name="xylo-imu",
    summary="Xylo-IMU: computes as Xylo-Audio 2; one synaptic current for each neuron",
    arithmetic=replace(_XYLO_V2, currents=1),
    limits=_IMU_LIMITS,
    evidence="the arithmetic of xylo-a2; no traces of its own",
    sources={
        **{field: f"{source}; {_TAKEN}" for field, source in XYLO_A2.sources.items()},
        "currents": f"{_ROCKPOOL}: one synapse for hidden neurons",
        "shift_max": XYLO_A2.sources["shift_max"],
        "read": f"{_ROCKPOOL}: 496 hidden neurons, and 16 outputs of their own",
    },
)
