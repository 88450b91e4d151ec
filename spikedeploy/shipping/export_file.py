"""A policy as one file, compared with what was given: NIR, ONNX."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spikedeploy.exporters.check import ExportResult, ParityCheck, compare_integers, random_spikes
from spikedeploy.outputs import check_output, has_text
from spikedeploy.runtime.artifact.artifact import Artifact, for_importer, load, save
from spikedeploy.runtime.dialects.rewriting import arguments
from spikedeploy.runtime.errors import ArtifactError, ConfigError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import ports
from spikedeploy.shipping.sources import (
    SpikingSource,
    is_nir_file,
    nir_file,
    require_output,
)

if TYPE_CHECKING:
    from spikedeploy.runtime.convention import Reset, State


def export_nir(
    policy: str,
    path: Path | None,
    *,
    observations: int = 1000,
    state: "State | None" = None,
    checkpoint: str | None = None,
    tool: str | None = None,
    nir_compat: str | None = None,
    written_by: str | None = None,
    dt: float | None = None,
    reset: "Reset | None" = None,
    force: bool = False,
) -> ExportResult:
    """Write a run's policy as NIR; or a file anew, as a tool's import or an earlier nir takes it.

    observations: observations of episodes, or random timesteps of a file, on which both are
        compared.
    tool: key of runtime.dialects.tools.IMPORTERS; None leaves the scaling unchanged.
    nir_compat: release of `nir` that must be able to open the file.
    written_by, dt, reset, state: as of artifact.load, for a file.

    The remarks say what the import of the tool must be told.
    """
    reading = {"written_by": written_by, "dt": dt, "reset": reset}
    if not (tool or nir_compat or is_nir_file(policy)):
        from spikedeploy.shipping.export_run import export_run

        if any(value is not None for value in reading.values()):
            raise ConfigError("--from, --dt and --reset read a file, and a run has no such choice")
        return export_run(
            policy, "nir", path, observations, state=state, checkpoint=checkpoint, force=force
        )
    _refuse(checkpoint=checkpoint)
    path = require_output(path, "a .nir file", "net.nir")
    file = nir_file(policy, "nir")
    check_output("-o", path, (file, policy), force, _is_rewritten)
    given = load(file, **reading, state=state)  # type: ignore[arg-type]
    written = given if tool is None else for_importer(given, tool)
    save(written, path, nir_compat)
    checks = [_compare_float("the file as it states", given, load(path), observations)]
    remarks: list[str] = []
    if tool is not None:
        told = arguments(written.convention, tool)
        as_read = load(path, like=tool, **told)  # type: ignore[arg-type]
        checks.append(_compare_float(f"the file as {tool} reads it", given, as_read, observations))
        remarks = [f"its import must be told {name} {value}" for name, value in told.items()]
    return _checked(path, checks, remarks)


def export_onnx(
    policy: str,
    path: Path | None,
    *,
    observations: int = 1000,
    env: str | None = None,
    checkpoint: str | None = None,
    state: "State | None" = None,
    force: bool = False,
) -> ExportResult:
    """Write a run's policy as ONNX, or one control step of a `.nir` file.

    observations: most of an episode, on which file and policy, or float twin, are compared.
    env: environment of the episode of a file; None is what it names, of ours.
    """
    if not is_nir_file(policy):
        from spikedeploy.shipping.export_run import export_run

        if env is not None:
            raise ConfigError("a run is played in the environment of its training: no --env")
        return export_run(
            policy, "onnx", path, observations, state=state, checkpoint=checkpoint, force=force
        )
    from spikedeploy.exporters.spiking_onnx import KIND, checks, spiking_to_onnx

    _refuse(checkpoint=checkpoint, state=state)
    path, source = require_output(path, "a file", "step.onnx"), SpikingSource.read(policy, "onnx")
    check_output("-o", path, (source.file,), force, lambda found: has_text(found, KIND))
    seen, _ = source.episode(None, observations, env)
    path.parent.mkdir(parents=True, exist_ok=True)
    spiking_to_onnx(source.artifact, path)
    return _checked(path, checks(source.artifact, path, seen))


def _refuse(**of_runs: str | None) -> None:
    """Refuse options that a run alone has."""
    if given := [name for name, value in of_runs.items() if value is not None]:
        raise ConfigError(
            f"--{given[0]} is for a run that is exported as it was trained: leave it out"
        )


def _checked(
    path: Path, checks: Sequence[ParityCheck], remarks: Sequence[str] = ()
) -> ExportResult:
    facts = {"remarks": list(remarks)}
    return ExportResult(path, (), tuple(checks), facts, (f"wrote {path}",), tuple(remarks))


def _is_rewritten(path: Path) -> bool:
    """True where a file is an artifact that this command may write anew."""
    try:
        return load(path).convention.source.startswith("as ")
    except ArtifactError:
        return False


def _compare_float(name: str, one: Artifact, other: Artifact, timesteps: int) -> ParityCheck:
    """Compare the spikes of every layer of two networks in float64 on one random raster."""
    rng = np.random.default_rng(0)
    rasters = [
        random_spikes(rng, 1, timesteps, *port.shape).astype(np.float64)
        for port in ports(one.graph.inputs)
    ]
    spikes: list[dict[str, Any]] = []
    for artifact in (one, other):  # by the number of the layer, in the order in which they run
        graph = FloatGraph(artifact)
        inputs = (port.name for port in ports(artifact.graph.inputs))
        trace = graph.run(dict(zip(inputs, rasters, strict=True)))
        layers = [each for each in graph.timing.names if each in graph.spiking]
        spikes.append({f"{k}": trace[each] for k, each in enumerate(layers)})
    check = compare_integers(name, spikes[0], spikes[1])
    return replace(check, detail=f"spikes: {check.detail}")
