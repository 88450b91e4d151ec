"""A NIR file rewritten for another tool's import, or for an earlier release of `nir`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.exporters.check import CheckedFile, MismatchCounter, ParityCheck, random_spikes
from spikedeploy.outputs import check_output
from spikedeploy.runtime.artifact.artifact import Artifact, for_importer, load, save
from spikedeploy.runtime.dialects.rewriting import arguments
from spikedeploy.runtime.errors import ArtifactError, ConfigError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import ports
from spikedeploy.shipping.export_c import nir_file


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
    tool: of runtime.dialects.rewriting.IMPORTERS; None leaves the scaling as it is.
    older: release of `nir` that must be able to open the file.
    timesteps: on which the networks are compared.
    options: of artifact.load, such as written_by.

    The remarks say what the import of the tool must be told.
    """
    if path is None:
        raise ConfigError("--for and --nir-compat write another file: name it, as in -o net.nir")
    file = nir_file(policy, "nir")
    check_output("-o", path, (file, policy), force, _is_ours)
    given = load(file, **(options or {}))
    written = given if tool is None else for_importer(given, tool)
    save(written, path, older)
    told = {} if tool is None else arguments(written.convention, tool)
    checks = [_compared("the file as it states", given, load(path), timesteps)]
    if tool is not None:
        as_read = load(path, like=tool, **told)  # type: ignore[arg-type]
        checks.append(_compared(f"the file as {tool} reads it", given, as_read, timesteps))
    remarks = tuple(f"its import must be told {name} {value}" for name, value in told.items())
    return CheckedFile(path, tuple(checks), remarks)


def _is_ours(path: Path) -> bool:
    """Whether a file is an artifact that this command may write anew."""
    try:
        return load(path).convention.source.startswith("as ")
    except ArtifactError:
        return False


def _compared(name: str, one: Artifact, other: Artifact, timesteps: int) -> ParityCheck:
    """Spikes of every layer, and outputs, of both networks in float64 on the same raster."""
    rng = np.random.default_rng(0)
    raster = {
        port.name: random_spikes(rng, 1, timesteps, *port.shape).astype(np.float64)
        for port in ports(one.graph.inputs)
    }
    found, wanted = _run(other, list(raster.values())), _run(one, list(raster.values()))
    counter = MismatchCounter()
    counter.add(*({f"{k}": each for k, each in enumerate(layers)} for layers in (wanted, found)))
    return ParityCheck(name, not counter.differing and bool(counter.compared), f"spikes: {counter}")


def _run(artifact: Artifact, rasters: list[Any]) -> list[Any]:
    """Spikes of each layer, in the order in which they run."""
    graph = FloatGraph(artifact)
    names = [port.name for port in ports(artifact.graph.inputs)]
    trace = graph.run(dict(zip(names, rasters, strict=True)))
    return [trace[name] for name in graph.timing.names if name in graph.spiking]
