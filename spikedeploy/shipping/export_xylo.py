"""A network as the specification of a Xylo for Rockpool, compared with the chip's arithmetic."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.exporters.check import CheckedFile, MismatchCounter, ParityCheck, random_spikes
from spikedeploy.exporters.to_xylo import Specification, check_chip, places, specification
from spikedeploy.files import as_text, write_text
from spikedeploy.outputs import check_output, marked
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.xylo_traces import xylo_trace
from spikedeploy.runtime.traces.fields import Fields
from spikedeploy.shipping.export_c import nir_file

_MARK = "spikedeploy export --to xylo"


def export_xylo(
    policy: str,
    chip_name: str | None,
    path: Path | None,
    timesteps: int = 1000,
    options: Mapping[str, Any] | None = None,
    force: bool = False,
) -> CheckedFile:
    """Write a network as a specification.

    policy: .nir file, shipped policy, run folder, its name under runs/, or "last".
    chip_name: a Xylo; None is refused with their names.
    timesteps: on which file and program are compared.
    options: of artifact.load, such as reset.

    The remarks say what of the network the specification does not have, or has otherwise.
    """
    if path is None:
        raise ConfigError("--to xylo writes a file: name it, as in -o xylo.json")
    if path.suffix.lower() != ".json":
        raise ConfigError(
            f"-o {path}: --to xylo writes JSON, and other tools would take the file for something "
            "else. Name one that ends in .json, as in -o xylo.json."
        )
    name = check_chip(chip_name)
    file = nir_file(policy, "xylo")
    check_output("-o", path, (file, policy), force, lambda place: marked(place, _MARK))
    artifact = load(file, **(options or {}))
    program = compile_program(artifact, chip(name))
    found = specification(program)
    write_text(path, as_text(document(program, found)))
    check = compared(program, found, timesteps)
    left = {"codec": artifact.codec, "last affine map": program.readout}
    remarks = [f"the {what} stays with the host" for what, one in left.items() if one is not None]
    return CheckedFile(path, (check,), (*program.remarks, *remarks))


def document(program: Program, found: Specification) -> dict[str, Any]:
    """What is written: the specification, and how to read its populations and its time."""
    wait, output = _wait(program), program.layer(program.output)
    return {
        "made_by": _MARK,
        "chip": program.chip.name,
        "dt": program.convention.dt,
        "hidden_layers": places(program.layers[:-1]),
        "output_layer": output.name,
        # of the output for an input timestep, behind that input
        "late": output.start - wait,
        "remarks": list(program.remarks),
        "specification": found,
    }


def compared(program: Program, found: Specification, timesteps: int) -> ParityCheck:
    """Spikes of every layer by the specification, read as a trace's, beside the program's."""
    raster = random_spikes(np.random.default_rng(0), 1, timesteps, program.width)
    wait, steps = _wait(program), program.steps(program.rows(timesteps))
    played = np.zeros((steps, program.width), np.uint8)
    played[wait : wait + timesteps] = raster[0, : steps - wait]
    renamed = {("bias" if name == "bias_hidden" else name): rows for name, rows in found.items()}
    silent = [[0] * len(found["threshold_out"])] * steps
    record = {**renamed, "input_counts": played.tolist(), "out_spikes": silent}
    read = xylo_trace(Fields({"params": record}, "the specification"), program.chip.name)
    ran, wanted = trace(read.program, read.raster), trace(program, raster)
    first = {**places(program.layers[:-1]), program.output: 0}
    counter = MismatchCounter()
    for layer in program.layers:
        rows = ran["output" if layer.name == program.output else "hidden"].spikes[0]
        seen = rows[layer.start : layer.start + timesteps, first[layer.name] :][:, : layer.size]
        counter.add({"": wanted[layer.name].spikes[0]}, {"": seen})
    name = f"the specification, as {program.chip.name} reads it"
    return ParityCheck(name, not counter.differing, f"spikes: {counter}")


def _wait(program: Program) -> int:
    """Timesteps that an input waits, so that layers start together."""
    return next(
        synapses.delay
        for layer in program.layers
        for synapses in layer.synapses
        if synapses.source == program.input
    )
