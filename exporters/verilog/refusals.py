"""Programs that the core does not compute, by the name of a rule."""

from collections.abc import Iterator, Mapping

from spikedeploy.exporters.c.refusals import broken_rules
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint

# of a token; half of its numbers are for what is no spike
_AXONS = 1 << 15
# more than the block RAM of the largest ECP5 holds, at 16 bits each
_SYNAPSES = 1 << 18
_WORD = 32


def check_program(program: Program) -> None:
    """Refuse programs that need a feature that the core lacks; RuleError."""
    arithmetic, chip = program.chip.arithmetic, program.chip.name
    if not isinstance(arithmetic, CubaFixedPoint):
        raise RuleError(
            f"rule arithmetic: {chip} computes with {type(arithmetic).__name__}; the core has the "
            "integers of CuBa-LIF neurons. Choose loihi1, loihi1-brian2, loihi1-nengo, loihi2 or "
            "int."
        )
    for rule, text in (*broken_rules(program), *_broken_rules(program, arithmetic)):
        raise RuleError(f"rule {rule}: {text}")


def _broken_rules(program: Program, arithmetic: CubaFixedPoint) -> Iterator[tuple[str, str]]:
    """Rules of the core that a program breaks, and how."""
    if program.convention.reset not in ("zero", "subtract"):
        yield (
            "reset",
            f"reset {program.convention.reset!r}; a spike of the core does 'zero' or 'subtract'. "
            "Train with one of them.",
        )
    for name in ("accumulator", "current", "push", "membrane"):
        between = getattr(arithmetic, name).between
        if between is not None and not between[0] <= 0 <= between[1]:
            yield (
                "register",
                f"{name} is held between {between[0]} and {between[1]}; a register of the core "
                "begins with 0. Choose a range around 0.",
            )
    if program.width > _AXONS:
        yield (
            "axons",
            f"the input has {program.width} channels; a token numbers {_AXONS} at most. Encode "
            "with fewer.",
        )
    if program.input in {term.layer for term in program.output_terms}:
        yield (
            "output",
            "the output receives the input itself, which is no layer of the core. Put a layer "
            "between them.",
        )
    for layer in program.spiking:
        if (least := int(layer.threshold.min(initial=0))) < 0:
            yield (
                "threshold",
                f"layer {layer.name!r}: a threshold of {least}; those of the core are 0 or more. "
                "Train with thresholds above 0.",
            )
    found = sum(int(synapses.fan_out.sum()) for a in program.layers for synapses in a.synapses)
    if found > _SYNAPSES:
        yield (
            "memory",
            f"{found:,} synapses; the core takes {_SYNAPSES:,} at most, more than the block RAM of "
            "the largest ECP5 holds, and uses no memory outside the FPGA. Train a sparse policy "
            "(spikedeploy distill), or a smaller one.",
        )


def check_membranes(bits: Mapping[str, int]) -> None:
    """Refuse membranes that are wider than a word to the host; bits: by layer."""
    for layer, found in bits.items():
        if found > _WORD:
            raise RuleError(
                f"rule word: layer {layer!r}: its membranes have {found} bits; a word to the host "
                f"has {_WORD}. Choose a narrower membrane (membrane={_WORD}-clip)."
            )
