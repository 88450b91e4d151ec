"""Programs, codes and names that are not written in C, and the rules that Verilog shares."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.population import MAX_TABLE_TIMESTEPS, PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.files import read_toml

_PREFIX = re.compile(r"[a-z][a-z0-9_]{0,30}")
_DECAY_BITS = 24


def check_program(program: Program) -> None:
    """Refuse programs whose arithmetic is not written in C; ConfigError with the rule."""
    arithmetic, chip = program.chip.arithmetic, program.chip.name
    if not isinstance(arithmetic, CubaFixedPoint | IntegrateAndFire):
        raise ConfigError(
            f"--to c: rule arithmetic: {chip} computes with {type(arithmetic).__name__}; C has the "
            "integers of CuBa-LIF and of integrate-and-fire neurons. Choose loihi1, int, "
            "truenorth, odin, tinyodin, speck2f or spiker."
        )
    if arithmetic.all_at_once:
        raise ConfigError(
            f"--to c: rule queue: the queue of {chip} is on. Choose queue=off, where the program "
            "relays the spikes."
        )
    for rule, text in broken_rules(program):
        raise ConfigError(f"--to c: rule {rule}: {text}")


def broken_rules(program: Program) -> Iterator[tuple[str, str]]:
    """Rules that a program breaks, and how, of those that C and the core of an FPGA share."""
    arithmetic = program.chip.arithmetic
    if isinstance(arithmetic, CubaFixedPoint) and arithmetic.decay_bits > _DECAY_BITS:
        yield "decay", f"decay_bits is {arithmetic.decay_bits}; at most {_DECAY_BITS} are written."
    if program.graded:
        name = min(program.graded)
        yield "graded", f"sigma-delta layer {name!r} sends graded spikes. Train neurons that spike."
    if program.clock == "free":
        yield (
            "clock",
            "clock 'free': layers run on between their windows, and an export computes a timestep "
            "when it is told to. Compile with clock='gated' or 'pipelined'.",
        )
    if program.host:
        yield (
            "readout",
            f"the host integrates {program.host[0].name!r} in float, because membranes do not "
            f"leave {program.chip.name}. Choose a chip that gives membranes out, such as loihi1.",
        )
    if program.damage or program.upsets is not None:
        yield "faults", "a chip with faults. Leave --faults out."
    for layer, synapses, lag in _unusual_synapses(program):
        yield (
            "synapses",
            f"layer {layer.name!r}: the synapses from {synapses.source!r} have shift "
            f"{synapses.shift}, current {synapses.current} and lag {lag}; written are 0, 0 and a "
            "source that is computed before. Give the loop a delay.",
        )


def _unusual_synapses(program: Program) -> Iterator[tuple[Layer, Synapses, int]]:
    """Layer, synapses and lag of those with a shift, a second current, or a source that is late.

    One is late that is computed behind the layer, and whose spikes arrive without a lag.
    """
    seen = {program.input}
    for layer, lags in zip(program.layers, program.lags, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            is_late = lag <= 0 and synapses.source not in seen
            if synapses.shift or synapses.current or is_late:
                yield layer, synapses, lag
        seen.add(layer.name)


def check_codec(codec: Codec) -> None:
    """Refuse codes that are not written in C."""
    encoder = codec.encoder
    if not isinstance(encoder, DeltaEncoder | RateEncoder | PopulationEncoder):
        raise ConfigError(
            f"--to c: encoder {encoder.kind!r} is not written in C. Train with delta, rate or "
            "population."
        )
    if isinstance(encoder, PopulationEncoder) and codec.timesteps > MAX_TABLE_TIMESTEPS:
        raise ConfigError(
            f"--to c: a population code over {codec.timesteps} timesteps; its table has at most "
            f"{MAX_TABLE_TIMESTEPS}. Train with fewer."
        )


def check_prefix(prefix: str) -> None:
    """Refuse what cannot begin the names of C."""
    if not _PREFIX.fullmatch(prefix):
        raise ConfigError(
            f"--prefix {prefix[:40]!r}: names of C begin with it; choose a small letter, then "
            "small letters, digits and '_', 31 at most."
        )
    if "__" in f"{prefix}_":
        raise ConfigError(
            f"--prefix {prefix!r}: C++ reserves names with two underscores in a row, and one "
            "follows the prefix; choose another, without '__' and without '_' at its end."
        )
    if what := _reserved().get(prefix):
        raise ConfigError(
            f"--prefix {prefix!r} is the name of {what}; {prefix}.h, {prefix}.c and "
            f"lib{prefix}.so would stand in its place or be taken for it. Choose another, such "
            f"as {prefix}_policy."
        )


@cache
def _reserved() -> dict[str, str]:
    """Map reserved names to their meaning."""
    table = read_toml(Path(__file__).with_name("reserved.toml"))
    return {name: what for what, names in table.items() for name in names.split()}
