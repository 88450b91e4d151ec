"""What cannot become C, and what to do instead."""

import re

from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.population import MAX_TABLE_TIMESTEPS, PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire

_PREFIX = re.compile(r"[a-z][a-z0-9_]{0,30}")
_KEYWORDS = {"auto", "double", "int", "struct", "break", "else", "long", "switch", "case", "enum"}
_FILES = {"codec", "selftest", "vectors"}  # written beside PREFIX.c
_DECAY_BITS = 24


def check_program(program: Program) -> None:
    """Refuse programs whose arithmetic is not written in C."""
    arithmetic, chip = program.chip.arithmetic, program.chip.name
    if not isinstance(arithmetic, (CubaFixedPoint, IntegrateAndFire)):
        raise ConfigError(
            f"--to c: chip {chip!r} computes with {type(arithmetic).__name__}; C is written for "
            "integers of Loihi's kind and of integrate-and-fire neurons. Choose loihi1, int, "
            "truenorth, odin, tinyodin, speck2f or spiker."
        )
    if isinstance(arithmetic, CubaFixedPoint) and arithmetic.decay_bits > _DECAY_BITS:
        raise ConfigError(f"--to c: decay_bits is {arithmetic.decay_bits}; at most {_DECAY_BITS}.")
    if arithmetic.together:
        raise ConfigError(
            f"--to c: the queue of {chip!r} is on, and is not written in C. Choose queue=off, "
            "where the program relays the spikes."
        )
    if program.graded:
        raise ConfigError(
            f"--to c: layer {min(program.graded)!r}: sigma-delta neurons send graded spikes, which "
            "is not written in C. Train neurons that spike."
        )
    if program.host:
        raise ConfigError(
            f"--to c: readout {program.host[0].name!r}: its membranes do not leave {chip}, so that "
            "the host integrates it in float, which is not written in C. Choose a chip that gives "
            "membranes out, such as loihi1."
        )
    if program.damage or program.upsets is not None:
        raise ConfigError("--to c: a chip with faults is not written in C. Leave --faults out.")
    _check_synapses(program)


def _check_synapses(program: Program) -> None:
    seen = {program.input}
    for layer, lags in zip(program.layers, program.lags, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            late = lag > 0 or synapses.source in seen
            if synapses.shift or synapses.current or not late:
                raise ConfigError(
                    f"--to c: layer {layer.name!r}: the synapses from {synapses.source!r} have "
                    f"shift {synapses.shift}, current {synapses.current} and lag {lag}; C is "
                    "written for 0, 0 and a source that comes first."
                )
        seen.add(layer.name)


def check_codec(codec: Codec) -> None:
    """Refuse codes that are not written in C."""
    encoder = codec.encoder
    if not isinstance(encoder, (DeltaEncoder, RateEncoder, PopulationEncoder)):
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
    if not _PREFIX.fullmatch(prefix) or prefix in _KEYWORDS | _FILES:
        raise ConfigError(
            f"--prefix {prefix[:40]!r}: names of C begin with it; choose a small letter, then "
            "letters, digits and '_', 31 at most."
        )
