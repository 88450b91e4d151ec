"""A network as one file for another tool, compared with the network that was given.

NIR for a tool's import or an earlier `nir`, one step in ONNX, the specification of a Xylo.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spikedeploy import zoo
from spikedeploy.exporters.check import CheckedFile, MismatchCounter, ParityCheck, random_spikes
from spikedeploy.exporters.to_xylo import Specification, check_chip, places, specification
from spikedeploy.outputs import check_output, has_text
from spikedeploy.runtime.artifact.artifact import Artifact, for_importer, load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.dialects.rewriting import arguments
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import ArtifactError, ConfigError
from spikedeploy.runtime.families.xylo_traces import xylo_trace
from spikedeploy.runtime.files import suffix, write_json
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import ports
from spikedeploy.runtime.traces.fields import Fields
from spikedeploy.shipping.sources import episode_of, nir_file, world_of

if TYPE_CHECKING:
    from spikedeploy.shipping.export_run import ExportedPolicy

_XYLO = "spikedeploy export --to xylo"


def export_nir(
    policy: str,
    path: Path | None,
    tool: str | None,
    older: str | None = None,
    timesteps: int = 1000,
    options: Mapping[str, Any] | None = None,
    force: bool = False,
) -> CheckedFile:
    """Write a policy's network for a tool, and compare it with the policy on random spikes.

    policy: .nir file, shipped policy, run folder, its name under runs/, or "last".
    tool: of runtime.dialects.tools.IMPORTERS; None leaves the scaling as it is.
    older: release of `nir` that must be able to open the file.
    timesteps: on which the networks are compared.
    options: of artifact.load, such as written_by.

    The remarks say what the import of the tool must be told.
    """
    if path is None:
        raise ConfigError("--for and --nir-compat write another file: name it, as in -o net.nir")
    file = nir_file(policy, "nir")
    check_output("-o", path, (file, policy), force, _is_rewritten)
    given = load(file, **(options or {}))
    written = given if tool is None else for_importer(given, tool)
    save(written, path, older)
    told = {} if tool is None else arguments(written.convention, tool)
    checks = [_compare_float("the file as it states", given, load(path), timesteps)]
    if tool is not None:
        as_read = load(path, like=tool, **told)  # type: ignore[arg-type]
        checks.append(_compare_float(f"the file as {tool} reads it", given, as_read, timesteps))
    remarks = tuple(f"its import must be told {name} {value}" for name, value in told.items())
    return CheckedFile(path, tuple(checks), remarks)


def _is_rewritten(path: Path) -> bool:
    """True where a file is an artifact that this command may write anew."""
    try:
        return load(path).convention.source.startswith("as ")
    except ArtifactError:
        return False


def _compare_float(name: str, one: Artifact, other: Artifact, timesteps: int) -> ParityCheck:
    """Spikes of every layer, and outputs, of both networks in float64 on the same raster."""
    rng = np.random.default_rng(0)
    raster = {
        port.name: random_spikes(rng, 1, timesteps, *port.shape).astype(np.float64)
        for port in ports(one.graph.inputs)
    }
    spikes: list[dict[str, Any]] = []
    for artifact in (one, other):  # by the number of the layer, in the order in which they run
        graph = FloatGraph(artifact)
        inputs = (port.name for port in ports(artifact.graph.inputs))
        trace = graph.run(dict(zip(inputs, raster.values(), strict=True)))
        layers = [each for each in graph.timing.names if each in graph.spiking]
        spikes.append({f"{k}": trace[each] for k, each in enumerate(layers)})
    counter = MismatchCounter()
    counter.add(spikes[0], spikes[1])
    return ParityCheck(name, not counter.differing and bool(counter.compared), f"spikes: {counter}")


def is_nir_file(reference: str) -> bool:
    """True where a reference is a `.nir` file or a shipped policy in one."""
    file = zoo.resolve(reference)
    return file is not None and file.is_file() and suffix(file) == ".nir"


def export_onnx(
    policy: str,
    path: Path | None,
    observations: int = 1000,
    force: bool = False,
    env: str | None = None,
) -> "ExportedPolicy":
    """Write a policy as one step in ONNX.

    policy        .nir file or shipped policy
    path          to write to
    observations  most of an episode, on which file and float twin are compared
    force         whether a file that no export wrote is replaced
    env           of the episode; None is what the policy names, of ours
    """
    from spikedeploy.exporters.spiking_onnx import KIND, checks, spiking_to_onnx
    from spikedeploy.shipping.export_run import ExportedPolicy

    if path is None:
        raise ConfigError("--to onnx of a file: name the one to write, as in -o step.onnx")
    file = zoo.resolve(policy)
    if file is None:
        raise ConfigError(f"there is no file {policy}")
    check_output("-o", path, (file,), force, lambda found: has_text(found, KIND))
    artifact = load(file)
    seen, _ = episode_of(artifact, None, observations, world_of(policy, artifact), env)
    path.parent.mkdir(parents=True, exist_ok=True)
    spiking_to_onnx(artifact, path)
    return ExportedPolicy(path, checks(artifact, path, seen), kind="snn")


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
    if suffix(path) != ".json":
        raise ConfigError(
            f"-o {path}: --to xylo writes JSON, and other tools would take the file for something "
            "else. Name one that ends in .json, as in -o xylo.json."
        )
    name = check_chip(chip_name)
    file = nir_file(policy, "xylo")
    check_output("-o", path, (file, policy), force, lambda place: has_text(place, _XYLO))
    artifact = load(file, **(options or {}))
    program = compile_program(artifact, chip(name))
    found = specification(program)
    write_json(path, document(program, found))
    check = compare_spikes(program, found, timesteps)
    left = {"codec": artifact.codec, "last affine map": program.readout}
    remarks = [f"the {what} stays with the host" for what, one in left.items() if one is not None]
    return CheckedFile(path, (check,), (*program.remarks, *remarks))


def document(program: Program, found: Specification) -> dict[str, Any]:
    """The content of the file: the specification, and how to read its populations and time."""
    wait, output = _wait(program), program.layer(program.output)
    return {
        "made_by": _XYLO,
        "chip": program.chip.name,
        "dt": program.convention.dt,
        "hidden_layers": places(program.layers[:-1]),
        "output_layer": output.name,
        # of the output for an input timestep, behind that input
        "late": output.start - wait,
        "remarks": list(program.remarks),
        "specification": found,
    }


def compare_spikes(program: Program, found: Specification, timesteps: int) -> ParityCheck:
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
