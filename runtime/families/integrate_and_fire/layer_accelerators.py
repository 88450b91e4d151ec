"""Speck 2f and Spiker+: accelerators that compute a network layer by layer.

Speck 2f (SynSense, DYNAP-CNN family) has integrate-and-fire neurons without a leak. The chip is
asynchronous: it has no timesteps, and processes every event by itself. Emulated is what its tools
do instead, sinabs' IAF layer stepped in time, with the chip's bits: all spikes of a timestep are
one sum, and a neuron spikes as often as the threshold fits into its membrane.

Spiker+ (Politecnico di Torino) generates accelerators for FPGAs, with free widths. A cycle of its
neurons begins with firing: a neuron above its threshold is reset and its spike leaves, every other
leaks; then inputs are added, and neurons' spikes of the cycle before. A timestep here ends where
the threshold is passed, one cycle before the spike leaves and two before it is heard: hence the
delay of 2 between neurons, none from the input, and a reset in place of the next leak.
"""

from spikedeploy.runtime.chips.chip import ALL_AT_ONCE, Chip
from spikedeploy.runtime.chips.limits import ENDS, SPACE, WEIGHTS, Convolutions, LayerCore, Limits
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import (
    WITHOUT_QUEUE,
    IntegrateAndFire,
)

_SINABS = "sinabs, backend/dynapcnn/discretize.py (source read)"
IAF = "sinabs, IAF layer (source read)"
_OVERVIEW = "sinabs' documentation, speck/overview.md (read)"
_TIMELESS = "the chip has no timesteps; as sinabs steps it"
_KI = 1024
_CORES = ((16, 64), (16, 64), (16, 64), (32, 32), (32, 32), (64, 16), (64, 16), (16, 16), (16, 16))

_SPECK2F_LIMITS = Limits(
    primitives=(*ENDS, *WEIGHTS, *SPACE, "IF"),
    inputs=2 * 128 * 128,
    layer_cores=tuple(LayerCore(kernel * _KI, neurons * _KI) for kernel, neurons in _CORES),
    convolutions=Convolutions(kernel=16, strides=(1, 2, 4, 8), channels=1024, extent=64),
    destinations=2,
    weight_max=127,
    threshold_max=(1 << 15) - 1,
    membrane_loss=(0.0, 0.0),
    sources={
        "primitives": f"{_SINABS}: convolution or linear map, IAF neurons, sum pool",
        "inputs": f"{_OVERVIEW}: 128 x 128 pixels; two polarities",
        "layer_cores": f"{_SINABS}: kernel and neuron memory of each core",
        "convolutions": f"{_OVERVIEW}: kernels to 16 x 16, strides 1, 2, 4, 8, 1024 channels, "
        "outputs to 64 x 64",
        "destinations": f"{_OVERVIEW}: fan-out 2",
        "weight_max": f"{_SINABS}: 8 bits with the sign",
        "threshold_max": f"{_SINABS}: 16 bits with the sign",
        "membrane_loss": f"{_SINABS}: no leak that depends on the membrane",
        "alone": "no way to join two is published",
    },
)

SPECK2F = Chip(
    name="speck2f",
    summary="Speck 2f: 8-bit weights, 16-bit membranes without leak, several spikes a timestep",
    arithmetic=IntegrateAndFire(
        weight_bits=8,
        signs="weight",
        axon_types=0,
        bias_bits=8,
        leak="none",
        leak_bits=0,
        leak_order="first",
        membrane=Register(16, "saturate"),
        floor=None,
        floors=("none", "zero", "threshold"),
        adds="step",
        checks="step",
        fires="reached",
        threshold_bits=16,
        spikes_max=255,
        scaling="full",
        rounding="nearest",
    ),
    resets=("subtract", "zero"),
    delay=0,
    delay_max=1,
    energy_tables=(),  # published for whole tasks only
    limits=_SPECK2F_LIMITS,
    clocks=("gated",),
    sources={
        "clocks": "asynchronous: a layer does nothing unless an event arrives; no timesteps: "
        "they are those of sinabs, layer by layer (sinabs, docs/speck/overview.md)",
        "membrane_output": "no way for a membrane was found in any source that was read",
        "weight_bits": f"{_SINABS}: DYNAPCNN_WEIGHT_PRECISION_BITS",
        "signs": f"{_SINABS}: two's complement",
        "axon_types": f"{_SINABS}: every synapse of a kernel has a weight",
        "bias_bits": f"{_SINABS}: biases are quantised as weights are",
        "leak": f"{_OVERVIEW}: what the chip calls leak is a constant (sinabs' bias) that a layer "
        "adds to its neurons on a slow clock",
        "leak_bits": "there is no leak",
        "leak_order": "there is no leak",
        "membrane": f"{_SINABS}: DYNAPCNN_STATE_PRECISION_BITS, and {_OVERVIEW}: 16 bits; that it "
        "saturates is assumed",
        "floor": f"{_SINABS}: lower threshold, -2**15 unless given",
        "floors": f"{_SINABS}: the lower threshold is free",
        "adds": f"{IAF}; {_TIMELESS}",
        "checks": f"{IAF}; {_TIMELESS}",
        "fires": f"{IAF}: membrane at or above the threshold",
        "threshold_bits": f"{_SINABS}: signed 16 bits, so that 15 are used",
        "spikes_max": f"by definition: a count of the emulator; {_TIMELESS}",
        "scaling": f"{_SINABS}: the smallest of the scales that fit weights, biases, threshold",
        "rounding": f"{_SINABS}: torch.round, half to even",
        "reset_at": f"{IAF}; {_TIMELESS}",
        **WITHOUT_QUEUE,
        "resets": f"{_SINABS}: subtracts the threshold, or return_to_zero",
        "delay": f"a spike is passed on at once; {_TIMELESS}",
        "delay_max": "by definition: recurrent connections take one timestep",
    },
    evidence="equal to sinabs' layers, `./spike test --peers sinabs`; not run against a board; "
    "that membranes saturate is assumed",
)


VHDL = "Spiker's VHDL and generator, commit e61e5b06 (source read)"
_DATAPATH = "a parameter; the default of neuron_datapath.vhd"
_SPIKER_LIMITS = Limits(
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
        reset_at="leak",
    ),
    resets=("zero", "subtract"),
    delay=2,
    delay_max=2,
    energy_tables=(),  # published for whole tasks only
    limits=_SPIKER_LIMITS,
    clocks=ALL_AT_ONCE,
    sources={
        "clocks": "one start signal runs a cycle of every layer (VHDL of commit e61e5b06, in RTL "
        "simulation)",
        "membrane_output": "no way for a membrane was found in any source that was read",
        "weight_bits": f"{VHDL}: {_DATAPATH}; 5 to 8 are used",
        "signs": f"{VHDL}: two's complement",
        "axon_types": f"{VHDL}: every synapse has a weight",
        "bias_bits": "none was found; emulated as an axon that spikes in every timestep",
        "leak": f"{VHDL}: v - (v >>> shift), an arithmetic shift, which rounds down",
        "leak_bits": "by definition: the largest shift that a membrane of 16 bits can tell",
        "leak_order": f"{VHDL}: fire and reset or leak, then what arrives",
        "membrane": f"{VHDL}: saturates; width: {_DATAPATH}",
        "floor": f"{VHDL}: none but the register's",
        "floors": f"{VHDL}: none but the register's",
        "adds": f"{VHDL}: one active input after another by index, then neurons",
        "checks": f"{VHDL}: once a cycle",
        "fires": f"{VHDL}: strictly above",
        "threshold_bits": f"{VHDL}: as wide as the membrane, here without its sign",
        "spikes_max": f"{VHDL}: once a cycle",
        "scaling": f"{VHDL}: fraction bits",
        "rounding": f"{VHDL}: int(), toward zero",
        "reset_at": f"{VHDL}: a neuron that fires does not leak in that cycle (RTL simulation)",
        **WITHOUT_QUEUE,
        "resets": f"{VHDL}: fixed or subtractive",
        "delay": "RTL simulation: a spike leaves one cycle after the threshold was passed, and is "
        "heard one later; inputs are heard at once",
        "delay_max": "RTL simulation: layers hear the one before, and recurrent neurons themselves",
    },
    evidence="equal to its RTL in simulation (GHDL 2.0.0, commit e61e5b06), `spikedeploy verify`",
)
