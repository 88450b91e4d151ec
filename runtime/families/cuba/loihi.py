"""Loihi 1 (Intel, 14 nm, 2018) by three published models that disagree, and Loihi 2.

`loihi1` is lava's model; the others are brian2_loihi's and nengo-loihi's. All agree on decays
rounded toward zero, a strict threshold and reset to zero, and differ in what the fields
step_rounding, exponents, accumulator, current, push, the decays and input_acts say; those were not
settled by anything published. Equal to their traces, that is, not "equal to the chip".

Loihi 2 (Intel 4, 2021) computes with its default neuron as Loihi 1 does. Its neurons are microcode;
this is what the default CuBa-LIF does as far as one public trace of a board shows: a single neuron,
membranes of 0 and above, a current that decays to 0 at once.
"""

from dataclasses import replace

from spikedeploy.runtime.chips.chip import ALL_AT_ONCE, Chip
from spikedeploy.runtime.chips.limits import (
    ENDS,
    READOUTS,
    SPACE,
    WEIGHTS,
    Limits,
    SynapticMemory,
)
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint, CubaGradedSpikes

LAVA = "lava-nc 0.10.0, bit-accurate LIF and Dense models (source read, traces equal)"
NENGO = "nengo-loihi 1.1.0, emulator and discretisation (source read)"
BRIAN2 = "brian2-loihi 0.5.2, neurons and synapses (source read, traces equal)"
_DAVIES = "Davies et al. 2018, IEEE Micro 38(1)"

_LAVA = CubaFixedPoint(
    weight_bits=8,
    weight_bits_allowed=(1, 2, 3, 4, 5, 6, 8),
    sign_mode="split",
    step_rounding="floor",
    exponents="sum",
    mantissa_shift=6,
    threshold_max=(1 << 17) - 1,
    bias_mantissa_max=(1 << 12) - 1,
    bias_exponent_max=7,
    decay_bits=12,
    decay_max=(1 << 12) - 1,
    current_decay_offset=1,
    membrane_decay_offset=0,
    accumulator=Register(22, "none"),
    current=Register(24, "wrap-once"),
    push=Register(24, "none"),
    membrane=Register(24, "clip"),
    refractory=1,
    input_acts="next",
)

_DOSSIER = "Davies et al. 2018, pp. 86-92 (secondary: a public transcription)"
_BLOCK = "nengo-loihi 1.1.0, its block of a core (source read)"

_LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, *SPACE, "Scale", "Delay", "IF", "LIF", "CubaLIF", *READOUTS),
    cores=128,
    neurons_per_core=1024,
    memory=SynapticMemory(size=16384 * 64, cost="words", weight_bits=8),
    axons_in=4096,
    axons_out=4096,
    decays=32,
    thresholds=16,
    weight_max=255,
    threshold_max=(1 << 17) - 1,
    current_loss=(1 / 4096, 1.0),
    membrane_loss=(0.0, 4095 / 4096),
    recurrence=True,
    input_cores=True,
    alone=False,
    sources={
        "primitives": "IF, LIF and CuBa-LIF are one equation with other decays, LI, CubaLI and I "
        "the same without spikes; maps without a state are synapses, delays theirs (derived)",
        "cores": _DOSSIER,
        "neurons_per_core": f"{_DOSSIER}; {_BLOCK}",
        "memory": f"{_DOSSIER}: 16384 words of 64 bits; what a synapse takes: {_BLOCK}",
        "axons_in": f"{_DOSSIER}; {_BLOCK}",
        "axons_out": f"{_DOSSIER}; {_BLOCK}",
        "decays": "nengo-loihi 1.1.0: 32 compartment configurations, with its own 'TODO: check'",
        "thresholds": "nengo-loihi 1.1.0: 16 threshold configurations, with its own 'TODO: check'",
        "weight_max": f"{_DAVIES}, p. 87: 8 bits and the sign of the list",
        "threshold_max": f"{LAVA}: 17 bits unsigned; all emulators agree",
        "current_loss": f"{LAVA} and {NENGO}: a register of 0 to 4095, and 1 that is added",
        "membrane_loss": f"{LAVA} and {NENGO}: a register of 0 to 4095",
        "recurrence": "lava, brian2_loihi and nengo-loihi all have it",
        "input_cores": "PopSAN's placement (repository read): encoders and bias in cores of theirs",
        "alone": "Frady et al. 2020, Pohoiki Springs: many chips as one (secondary)",
    },
)

LOIHI1 = Chip(
    name="loihi1",
    summary="Loihi 1: 8-bit weights, 12-bit decays, 24-bit states, as lava models it",
    arithmetic=_LAVA,
    resets=("zero",),
    delay=1,
    delay_max=63,
    energy_tables=("davies2018", "sanafe"),
    membrane_output="probe",
    clocks=ALL_AT_ONCE,
    sources={
        "clocks": "all cores advance together, timestep by timestep, by a barrier across the mesh "
        f"({_DAVIES}); no way to hold a layer is published",
        "membrane_output": "nengo-loihi 1.1.0 probes the voltage of compartments; NxSDK has a "
        "threshold mode NO_SPIKE (secondary: public scripts)",
        "weight_bits": f"{_DAVIES}, p. 87: 1 to 9 bits with the sign",
        "weight_bits_allowed": f"{NENGO}: 7 is not encodable",
        "sign_mode": f"{_DAVIES}, p. 87; split as PopSAN was mapped (Tang et al. 2020)",
        "step_rounding": f"{LAVA}; brian2_loihi 0.5.2 rounds toward zero",
        "exponents": f"{LAVA}: its Dense shifts the sum; brian2_loihi each weight",
        "mantissa_shift": f"{LAVA}; all emulators agree",
        "threshold_max": f"{LAVA}: 17 bits unsigned; all emulators agree",
        "bias_mantissa_max": f"{NENGO}: 13 bits signed, -4096 unused",
        "bias_exponent_max": f"{LAVA}: 3 bits",
        "decay_bits": f"{LAVA}; all emulators agree",
        "decay_max": f"{LAVA}: 12 bits",
        "current_decay_offset": f"{LAVA} and {NENGO}; brian2_loihi takes the effective decay",
        "membrane_decay_offset": f"{LAVA} and {NENGO}",
        "accumulator": f"{NENGO}: 21 bits and sign, wraps; lava does not model its overflow",
        "current": f"{LAVA}: 24 bits, one wrap; nengo-loihi wraps in two's complement",
        "push": f"{LAVA}: not modelled; nengo-loihi wraps it in two's complement",
        "membrane": f"{LAVA}: 24 bits, clips; nengo-loihi too",
        "refractory": "none in lava's bit-accurate model; 1 to 64 on the chip (nengo-loihi)",
        "resets": "all emulators agree: to zero, the current stays",
        "delay": f"{LAVA}: a Dense sends what it accumulated in the timestep before",
        "input_acts": f"{LAVA}: a source's spikes pass a Dense as those of neurons do",
        "delay_max": f"the timestep of delivery and a register of 0 to 62 ({_DAVIES}, p. 92, "
        "secondary; brian2-loihi 0.5.2 checks it). A core with 1024 neurons has 3 of its 6 bits "
        "(nengo-loihi 1.1.0, hardware/builder.py)",
    },
    limits=_LIMITS,
    evidence=f"equal to traces of {LAVA.partition(',')[0]}, `spikedeploy verify`",
)

LOIHI1_BRIAN2 = replace(
    LOIHI1,
    name="loihi1-brian2",
    summary="Loihi 1 as brian2_loihi models it: nothing overflows, inputs act at once",
    arithmetic=replace(
        _LAVA,
        step_rounding="zero",
        exponents="weight",
        bias_mantissa_max=0,
        bias_exponent_max=0,
        decay_max=1 << 12,
        current_decay_offset=0,
        accumulator=Register(22, "none"),
        current=Register(24, "none"),
        membrane=Register(24, "none"),
        input_acts="same",
    ),
    limits=replace(_LIMITS, current_loss=(0.0, 1.0), membrane_loss=(0.0, 1.0)),
    sources={
        **LOIHI1.sources,
        "clocks": "brian2-loihi 0.5.2: one schedule updates every group in each timestep",
        "step_rounding": f"{BRIAN2}: odd mixed weights go toward zero",
        "exponents": f"{BRIAN2}: each weight is rounded down and clipped at 21 bits less 64",
        "bias_mantissa_max": f"{BRIAN2}: its neurons have no bias",
        "bias_exponent_max": f"{BRIAN2}: its neurons have no bias",
        "decay_max": f"{BRIAN2}: effective decays of 0 to 4096",
        "current_decay_offset": f"{BRIAN2}: takes the effective decay",
        "membrane_decay_offset": f"{BRIAN2}: takes the effective decay",
        "accumulator": f"{BRIAN2}: overflow is not modelled",
        "current": f"{BRIAN2}: overflow is not modelled",
        "push": f"{BRIAN2}: overflow is not modelled",
        "membrane": f"{BRIAN2}: overflow is not modelled",
        "refractory": f"{BRIAN2}: 1 to 64, as on the chip",
        "delay": f"{BRIAN2}: its schedule has synapses before thresholds, so a spike acts in the "
        "timestep after the one in which it was emitted",
        "input_acts": f"{BRIAN2}: its spike generators run at the start, before the synapses",
    },
    evidence=f"equal to traces of {BRIAN2.partition(',')[0]}, `spikedeploy verify`",
)

LOIHI1_NENGO = replace(
    LOIHI1,
    name="loihi1-nengo",
    summary="Loihi 1 as nengo-loihi models it: sums wrap in two's complement",
    arithmetic=replace(
        _LAVA,
        step_rounding="zero",
        exponents="exact",
        accumulator=Register(22, "wrap"),
        current=Register(24, "wrap"),
        push=Register(24, "wrap"),
    ),
    sources={
        **LOIHI1.sources,
        "clocks": "nengo-loihi 1.1.0: EmulatorInterface.step updates all compartments",
        "step_rounding": f"{NENGO}: rounded when the network is built, the same way for both signs",
        "exponents": f"{NENGO}: weights are shifted by 6 and the exponent together",
        "accumulator": f"{NENGO}: 21 bits and sign, wraps in two's complement",
        "current": f"{NENGO}: 23 bits and sign, wraps in two's complement",
        "push": f"{NENGO}: current and bias wrap once more, 23 bits and sign",
        "membrane": f"{NENGO}: clips to vmin and vmax, here the widest",
        "refractory": f"{NENGO}: 1 to 64",
        "delay": f"{NENGO}: EmulatorInterface.step injects the spikes of the timestep before",
        "input_acts": f"{NENGO}: SynapseState.inject_current: inputs take one timestep to arrive",
    },
    evidence=f"equal to traces of {NENGO.partition(',')[0]}, `spikedeploy verify`",
)


_BOARD = (
    "one LIF neuron on a board, NIR paper 01_lif: the rule gives its spikes in 1000 timesteps and "
    "all membranes but those at 4 spikes, where the probe reads 128"
)
_GUESS = "assumed: taken from Loihi 1; no public source for Loihi 2 was found"
# Intel's technology brief of 2021 and Orchard et al. 2021 (IEEE SiPS) could be read in parts only
_NOT_READ = "no primary source was read"

_LIMITS2 = replace(
    _LIMITS,
    cores=120,
    neurons_per_core=8192,
    memory=SynapticMemory(size=192 * 1024 * 8, cost="words", weight_bits=8),
    decays=None,
    thresholds=None,
    sources={
        **{field: f"{source}; {_GUESS}" for field, source in _LIMITS.sources.items()},
        "cores": f"assumed: the lesser of 120 and 128, which secondary pages give; {_NOT_READ}",
        "neurons_per_core": "1 million neurons a chip (Intel's announcement of 2021, in the press) "
        "over 128 cores (derived); at most, with the smallest neurons",
        "memory": "assumed: about 192 KB a core, neurons included, as secondary pages have it; "
        f"{_NOT_READ}; the words are Loihi 1's",
        "axons_in": f"{_GUESS}; a user's report in a public issue agrees (secondary)",
        "axons_out": f"{_GUESS}; a user's report in a public issue agrees (secondary)",
        "input_cores": f"as PopSAN's on Loihi 1; {_GUESS}",
    },
)

LOIHI2 = replace(
    LOIHI1,
    name="loihi2",
    summary="Loihi 2 with its default neuron, which computes as Loihi 1's does",
    delay_max=64,
    # sigma-delta neurons besides
    arithmetic=CubaGradedSpikes(**vars(_LAVA)),
    energy_tables=(),  # no public energy per operation
    limits=_LIMITS2,
    membrane_output="graded",
    sources={
        **{field: f"{LAVA}, as on Loihi 1; {_GUESS}" for field in LOIHI1.sources},
        "clocks": "as Loihi 1 (assumed); lava-nc 0.10.0, LoihiProtocol: all processes take part in "
        "each timestep. A spike acts one timestep later: board, NIR paper, 01_lif",
        "membrane_output": "graded spikes of up to 32 bits (secondary pages; lava-nc 0.10.0 has a "
        "field of 5 bits for their width); that a membrane of 24 bits goes into one is derived",
        "mantissa_shift": _BOARD,
        "decay_bits": _BOARD,
        "membrane_decay_offset": _BOARD,
        "resets": f"{_BOARD}; microcode could do others",
        "delay": _BOARD,
        "delay_max": "lava-nc 0.10.0, PyDelayDenseModelBitAcc: 0 to 63 for Loihi 2, beside the "
        "timestep of a Dense",
    },
    evidence="equal to one neuron on a board in its spikes of 1000 timesteps (NIR paper, 01_lif), "
    "`spikedeploy verify`; the rest is Loihi 1's",
)
