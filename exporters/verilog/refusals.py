"""Refusals: programs that the core does not compute, by the name of a rule."""

from collections.abc import Mapping

from spikedeploy.exporters.c.refusals import unusual_synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint

# of a token; half of its numbers are for what is no spike
_AXONS = 1 << 15
# more than the block RAM of the largest ECP5 holds, at 16 bits each
_SYNAPSES = 1 << 18
_WORD = 32
_DECAY_BITS = 24


def check_program(program: Program) -> None:
    """Refuse programs that need what the core has not; RuleError."""
    arithmetic, chip = program.chip.arithmetic, program.chip.name
    if not isinstance(arithmetic, CubaFixedPoint):
        raise RuleError(
            f"rule arithmetic: {chip} computes with {type(arithmetic).__name__}; the "
            "core has the integers of CuBa-LIF neurons. Choose loihi1, loihi1-brian2, "
            "loihi1-nengo, loihi2 or int."
        )
    if program.graded:
        raise RuleError(
            f"rule graded: layer {min(program.graded)!r}: sigma-delta neurons send "
            "graded spikes, and the core has spikes without a number. Train neurons that spike."
        )
    if program.convention.reset not in ("zero", "subtract"):
        raise RuleError(
            f"rule reset: reset {program.convention.reset!r}; a spike of the core "
            "does 'zero' or 'subtract'. Train with one of them."
        )
    if arithmetic.decay_bits > _DECAY_BITS:
        raise RuleError(
            f"rule decay: decay_bits is {arithmetic.decay_bits}; the core has "
            f"{_DECAY_BITS} at most. Choose fewer."
        )
    for name in ("accumulator", "current", "push", "membrane"):
        between = getattr(arithmetic, name).between
        if between is not None and not between[0] <= 0 <= between[1]:
            raise RuleError(
                f"rule register: {name} is held between {between[0]} and {between[1]}; a register "
                "of the core holds 0, which it begins with. Choose a range around 0."
            )
    if program.clock == "free":
        raise RuleError(
            "rule clock: clock 'free': layers run on between their windows, and the "
            "core computes a timestep when it is told to. Compile with clock='gated' or "
            "'pipelined'."
        )
    if program.host:
        raise RuleError(
            f"rule readout: {program.host[0].name!r} is integrated by the host in "
            f"float, because membranes do not leave {chip}; what leaves the core then is not the "
            "output. Choose a chip that gives membranes out, such as loihi1."
        )
    if program.damage or program.upsets is not None:
        raise RuleError("rule faults: a chip with faults; the core has none. Leave --faults out.")
    _check_wires(program)


def _check_wires(program: Program) -> None:
    """Refuse connections that the core has not."""
    if program.width > _AXONS:
        raise RuleError(
            f"rule axons: the input has {program.width} channels; a token numbers "
            f"{_AXONS} at most. Encode with fewer."
        )
    if program.input in {tap.layer for tap in program.taps}:
        raise RuleError(
            "rule output: the output receives the input itself, which is no layer "
            "of the core. Put a layer between them."
        )
    for layer in program.spiking:
        if (least := int(layer.threshold.min(initial=0))) < 0:
            raise RuleError(
                f"rule threshold: layer {layer.name!r}: a threshold of {least}; those of the core "
                "are 0 or more. Train with thresholds above 0."
            )
    for layer, synapses, lag in unusual_synapses(program):
        raise RuleError(
            f"rule synapses: layer {layer.name!r}: the synapses from "
            f"{synapses.source!r} have shift {synapses.shift}, current "
            f"{synapses.current} and lag {lag}; the core has shift 0, one current, and a "
            "lag of 0 only behind a source that is computed before. Give the loop a delay."
        )
    found = sum(int(synapses.fan_out.sum()) for a in program.layers for synapses in a.synapses)
    if found > _SYNAPSES:
        raise RuleError(
            f"rule memory: {found:,} synapses; the core takes {_SYNAPSES:,} at most, more than "
            "the block RAM of the largest ECP5 holds, and uses no memory outside the FPGA. Train "
            "a sparse policy (spikedeploy distill), or a smaller one."
        )


def check_membranes(bits: Mapping[str, int]) -> None:
    """Refuse membranes that are wider than a word to the host; bits: by layer."""
    for layer, found in bits.items():
        if found > _WORD:
            raise RuleError(
                f"rule word: layer {layer!r}: its membranes have {found} bits; a word to the host "
                f"has {_WORD}. Choose a narrower membrane (membrane={_WORD}-clip)."
            )
