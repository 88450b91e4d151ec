"""A NIR file rewritten for another tool's import, or for an earlier release of `nir`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.exporters.check import MismatchCounter, ParityCheck
from spikedeploy.exporters.importers.rewritten import arguments, for_importer
from spikedeploy.outputs import check_output
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.errors import ArtifactError, ConfigError
from spikedeploy.runtime.float_model.graph import FloatGraph
from spikedeploy.runtime.graph.ports import ports
from spikedeploy.shipping.export_c import nir_file

_RATE = 0.3  # spikes of an input in a timestep


@dataclass(frozen=True)
class RewrittenNir:
    """A written file.

    path: of it.
    checks: that it is the network that was given, as it stands and as the tool reads it.
    remarks: what its import must be told.
    """

    path: Path
    checks: tuple[ParityCheck, ...]
    remarks: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every check did."""
        return all(each.passed for each in self.checks)


def export_nir(
    policy: str,
    path: Path | None,
    tool: str | None,
    older: str | None = None,
    timesteps: int = 1000,
    options: Mapping[str, Any] | None = None,
    force: bool = False,
) -> RewrittenNir:
    """Write a policy's network for a tool, and compare it with the policy on random spikes.

    policy: .nir file, shipped policy, run folder, its name under runs/, or "last".
    tool: of exporters.importers.rewritten.IMPORTERS; None leaves the scaling as it is.
    older: release of `nir` that must be able to open the file.
    timesteps: on which the networks are compared.
    options: of artifact.load, such as written_by.
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
    return RewrittenNir(path, tuple(checks), remarks)


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
        port.name: (rng.random((1, timesteps, *port.shape)) < _RATE).astype(np.float64)
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
