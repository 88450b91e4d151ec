"""Each mutant of the core's Verilog computes something else than the emulator in the bench."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from spikedeploy.exporters.verilog.bench import record
from spikedeploy.exporters.verilog.image import core_image
from spikedeploy.exporters.verilog.to_verilog import CORE, PARAMETERS
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import NEVER, Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from tests.rtl_builds import benched, edges, needs_icarus, passes, recorded, written


@dataclass(frozen=True)
class Mutant:
    """A change of the core.

    what: it computes.
    old, new: text; in the core, or of a parameter.
    seen: vectors in which it shows.
    file: that is changed.
    """

    what: str
    old: str
    new: str
    seen: str
    file: str = CORE


# of facts/fpga.md: rounding, no wrap, no clip, the threshold, the edge of the wrap
MUTANTS = [
    Mutant("rounds down", "(fraction && kept[STATE_BITS-1])", "1'b0", "decays"),
    Mutant("rounds up", "(fraction && kept[STATE_BITS-1])", "fraction", "decays"),
    Mutant("never wraps", "KIND == 0 ||", "KIND == 1 || KIND == 0 ||", "current wrap"),
    Mutant("never wraps once", "KIND == 0 ||", "KIND == 2 || KIND == 0 ||", "current wrap-once"),
    Mutant("never clips", "KIND == 0 ||", "KIND == 3 || KIND == 0 ||", "membrane clip"),
    Mutant("never saturates", "KIND == 0 ||", "KIND == 4 || KIND == 0 ||", "membrane saturate"),
    Mutant("spikes at the threshold", "== ADD ? (", "== FIRE || state == ADD ? 1'b1 || (", "net"),
    Mutant("spikes at v = threshold", ": state == SUBTRACT;", ": state != PUSH;", "net"),
    Mutant("wraps at +half", "!fits && !at_edge", "!fits", "current wrap-once"),
    Mutant(
        "wraps below -half",
        "negative && !(fits && rest);\n        wire [IN",
        "negative && !fits;\n        wire [IN",
        "current wrap-once",
    ),
    Mutant("clips at -half", "KIND == 3 ? !(fits && rest) : !fits", "!fits", "membrane clip"),
    Mutant(
        "saturates at -half + 1",
        "{(BITS - 2) {1'b0}}, KIND == 3}",
        "{(BITS - 2) {1'b0}}, 1'b1}",
        "membrane saturate",
    ),
    Mutant(
        "clips to one less", "{(BITS - 1) {1'b1}}", "{(BITS - 1) {1'b1}} - 1'b1", "membrane clip"
    ),
    Mutant("has no range", "if (!RANGED)", "if (1)", "membrane range"),
    Mutant("wraps up by one too little", "top + 1'b1", "top", "push wrap-once"),
    Mutant("never resets", "(above && !RESET_SUBTRACTS)", "(0)", "net"),
    Mutant("subtracts one more", ": state == SUBTRACT;", ": 1'b0;", "loop"),
    Mutant("never rests", "assign resting = |rest;", "assign resting = 0;", "loop"),
    Mutant("rests for ever", "rest - 1'b1 : rest", "rest : rest", "loop"),
    Mutant("rests one timestep more", "spiked ? RESTS", "spiked ? RESTS + 1'b1", "loop"),
    Mutant("forgets the bias", "!adding ? bias", "!adding ? {SUM_BITS{1'b0}}", "loop"),
    Mutant(
        "has one slot",
        "slot <= (slot + 1'b1) & SLOT_MASK;\n      end",
        "slot <= slot;\n      end",
        "loop",
    ),
    Mutant(
        "forgets delays",
        "wire [SLOT_BITS-1:0] next_slot = (slot + next",
        "wire [SLOT_BITS-1:0] next_slot = (slot + 1'b1 + 0 * next",
        "loop",
    ),
    Mutant("has no negative rows", "negate ? sum - wide_weight : sum", "sum", "net"),
    Mutant("has gaps from the first", "target <= next_target;", "", "net"),
    Mutant(
        "skips the last synapse",
        "adding <= state == DELIVER;",
        "adding <= state == DELIVER && !synapse_last;",
        "net",
    ),
    Mutant(
        "adds to the neuron before",
        "sum_address <= sum_read_address;",
        "sum_address <= {slot, target[NEURON_BITS-1:0]};",
        "net",
    ),
    Mutant("keeps states of an episode", "state <= CLEAR;\n        end else", "end else", "net"),
    Mutant(
        "keeps the slot of an episode",
        "slot  <= 0;\n          state <= CLEAR",
        "state <= CLEAR",
        "loop",
    ),
    Mutant(
        "clears no membranes",
        "state == CLEAR || state == PUSH",
        "(state == CLEAR && !pass) || state == PUSH",
        "net",
    ),
    Mutant("clears no sums", "(state == CLEAR && pass);", "1'b0;", "loop"),
    Mutant("ends words too early", "neuron == LAST_HEARD", "neuron == LAST_HEARD - 1'b1", "net"),
    Mutant("aligns no spikes", "? ALIGN : EMIT", "? EMIT : EMIT", "spikes"),
    Mutant(
        "numbers spikes from the top",
        "spiked, shifted[31:1]}",
        "spiked, shifted[31:1]} >> 1",
        "spikes",
    ),
    Mutant("has no voltage bias", "PUSH: left = voltage_bias;", "PUSH: left = 0;", "net"),
    Mutant(
        "shifts all layers alike",
        "shifted = wide <<< SHIFT_OF[8*k+:8];",
        "shifted = shifted;",
        "net",
    ),
    Mutant("takes all for layer 0", "chosen = OF_LAYER[k*BITS+:BITS];", "chosen = chosen;", "net"),
    Mutant("keeps the last lost bit alone", "fraction | partial[0]", "partial[0]", "decays"),
    Mutant("decays a bit too little", "count == LAST_BIT", "count == LAST_BIT - 1'b1", "decays"),
    Mutant(
        "never keeps all",
        "wire keeps_all = DECAY_FIELD > DECAY_BITS &&",
        "wire keeps_all = 0 &&",
        "decays",
    ),
    Mutant(
        "never keeps nothing",
        "if (keeps_all) product <= kept;\n        else if (!keeps_nothing)",
        "if (keeps_all || keeps_nothing) product <= kept;\n        else",
        "decays",
    ),
    Mutant(
        "decays the membrane as the current",
        "pass ? membrane_decay : current_decay",
        "current_decay",
        "decays",
    ),
    Mutant(
        "holds membranes as currents",
        "pass ? fit_membrane : fit_current",
        "fit_current",
        "membrane clip",
    ),
    Mutant(
        "holds no sums",
        "accumulator (shifted, drive)",
        "accumulator (shifted >>> 1, drive)",
        "accumulator clip",
    ),
    Mutant(
        "reads axons behind the last", "s_axis_tdata < AXON_COUNT", "!s_axis_tdata[15]", "foreign"
    ),
    *(
        Mutant(
            f"has {name} one bit too narrow",
            f"localparam {name} =",
            f"localparam {name} = -1 +",
            seen,
            PARAMETERS,
        )
        for name, seen in [
            ("SUM_BITS", "wide"),
            ("STATE_BITS", "wide"),
            ("VALUE_BITS", "wide"),
            ("ADDER_BITS", "wide"),
            ("DRIVE_BITS", "wide"),
        ]
    ),
]


def layer(name, synapses, size, rng, **fields):
    """A layer of small numbers."""
    made = {
        "bias": np.zeros(size, np.int64),
        "voltage_bias": rng.integers(-500, 500, size),
        "threshold": np.full(size, 4096 if fields.get("spiking", True) else NEVER),
        "current_decay": np.full(size, 4000),
        "membrane_decay": np.full(size, 3000),
        **fields,
    }
    return Layer(name=name, synapses=synapses, scale=1.0, start=0, **made)


def weights(rng, axons, neurons, most=9, unit=1):
    """Pairs of axons of opposite weights, some 0."""
    half = rng.integers(-most, most + 1, (axons // 2, neurons)) * unit
    half *= rng.random(half.shape) < 0.7
    return np.stack([half, -half], axis=1).reshape(axons, neurons).astype(np.int16)


def net():
    """A hidden layer and a silent one, as of a policy: pairs of axons, two units, kept states."""
    rng = np.random.default_rng(3)
    hidden = layer("hidden", (Synapses("input", weights(rng, 8, 6), 1),), 6, rng)
    # a membrane that is the threshold after the first timestep, and nothing more
    hidden.voltage_bias[0], hidden.threshold[:] = 640, 640
    wires = (
        Synapses("input", weights(rng, 8, 5, 9, 4), 1),
        Synapses("hidden", weights(rng, 6, 5, 9, 4), 1),
    )
    out = layer("out", wires, 5, rng, spiking=False, current_decay=np.zeros(5, np.int64))
    convention = Convention(1e-3, state="kept")
    rules = chip("loihi1")
    return Program(rules, convention, "input", 8, (hidden, out), "out", None, clock="pipelined")


def loop():
    """A recurrent layer with delays, biases and rests, whose spikes subtract; 40 spikes leave."""
    rng = np.random.default_rng(4)
    wires = (Synapses("input", weights(rng, 6, 40), 1), Synapses("a", weights(rng, 40, 40), 3))
    a = layer("a", wires, 40, rng, bias=rng.integers(-9, 10, 40))
    convention = Convention(1e-3, state="kept", reset="subtract")
    rules = chip("loihi1", refractory=3)
    return Program(rules, convention, "input", 6, (a,), "a", None, clock="pipelined")


def decays():
    """Decays of all kinds, of currents and membranes of both signs."""
    rng = np.random.default_rng(5)
    factors = np.array([0, 1, 2, 2048, 2049, 4094, 4095, 4096])
    fields = {"current_decay": factors.repeat(8), "membrane_decay": np.tile(factors, 8)}
    wires = (Synapses("input", weights(rng, 6, 64, 200), 1),)
    out = layer("out", wires, 64, rng, spiking=False, **fields)
    rules = chip("loihi1")
    convention = Convention(1e-3, state="kept")
    return Program(rules, convention, "input", 6, (out,), "out", None, clock="pipelined")


def wide():
    """All sums as large as they get, of either sign."""
    rng = np.random.default_rng(6)
    weight = np.array([[255, -255], [255, -255], [1, -1]], np.int16)
    fields = {name: np.full(2, 4096) for name in ("current_decay", "membrane_decay")}
    fields["voltage_bias"] = np.zeros(2, np.int64)
    rules = chip(
        "loihi1", current=Register(17, "clip"), membrane=Register(17, "clip"), mantissa_shift=6
    )
    out = layer("out", (Synapses("input", weight, 1),), 2, rng, spiking=False, **fields)
    convention = Convention(1e-3, state="kept")
    return Program(rules, convention, "input", 3, (out,), "out", None, clock="pipelined")


@cache
def vectors(name):
    """An image, and what the emulator makes of input that shows mutants."""
    if name == "wide":
        image = core_image(wide())
        return image, record(image, np.ones((6, 1, 3), np.uint8))
    if name == "decays":
        return recorded(decays(), 1, 12, 0.4)
    if name == "spikes":
        return vectors("loop")
    if name == "foreign":
        image, found = vectors("net")
        return image, replace(found, tokens=[[11, *each] for each in found.tokens])
    if name in ("net", "loop"):
        return recorded(net() if name == "net" else loop(), 5, 4, 0.4, seed=2)
    register, kind = name.split()
    held = Register(14, "clip", (0, 1 << 11)) if kind == "range" else Register(12, kind)
    program, raster = edges(register, held)
    image = core_image(program)
    return image, record(image, raster)


@needs_icarus
@pytest.mark.parametrize("name", sorted({mutant.seen for mutant in MUTANTS}))
def test_the_core_itself_passes(tmp_path, name):
    assert passes(benched(written(*vectors(name), tmp_path)))


@needs_icarus
@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.what.replace(" ", "-"))
def test_a_mutant_dies(tmp_path, mutant):
    def changed(name, text):
        if name != mutant.file:
            return text
        assert mutant.old in text
        return text.replace(mutant.old, mutant.new)

    written(*vectors(mutant.seen), tmp_path, changed)
    assert not passes(benched(tmp_path, warnings=False))
