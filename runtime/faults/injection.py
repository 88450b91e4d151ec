"""A program on a faulty chip: broken parts are in its numbers, upsets are left to the machine."""

from dataclasses import replace
from zlib import crc32

import numpy as np

from spikedeploy.runtime.chips.damage import Damage, Upset, Upsets
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults.request import Faults, fault


def injected(program: Program, faults: Faults) -> Program:
    """The program with the faults; its `damage` says what they hit."""
    if not faults:
        return program
    _check_integers(program)
    upsets: list[Upset] = []
    for each in faults.each:
        kind = fault(each.name)
        if kind.hurt is None:
            upsets.append(Upset(each.text, each.name, each.number, kind.what))
            continue
        rng = np.random.default_rng([faults.specimen, crc32(each.name.encode())])
        layers, hit, of = kind.hurt(program, each.number, rng)
        damage = Damage(each.text, each.name, each.number, hit, of, kind.what)
        program = replace(program, layers=tuple(layers), damage=(*program.damage, damage))
    if not upsets:
        return program
    return replace(program, upsets=Upsets(tuple(upsets), faults.specimen))


def _check_integers(program: Program) -> None:
    if any(layer.threshold.dtype.kind == "f" for layer in program.layers):
        raise ConfigError(
            f"--fault: chip {program.chip.name!r} computes in floats, and faults are modelled in "
            "the integers of a chip. Choose another chip, such as loihi1."
        )
