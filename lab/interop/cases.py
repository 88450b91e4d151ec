"""A file as it is, and as it is rewritten for a tool, with the spikes that it should have."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.interop.peers import OtherTool
from spikedeploy.exporters.check import random_spikes
from spikedeploy.exporters.importers.rewritten import arguments, for_importer
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.errors import SpikedeployError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import ports

TIMESTEPS = 400
SPIKES = "spikes.npz"  # of a peer, in the folder of its case
PLAIN, FOR, OLDER = "as it is", "--for", "--nir-compat"

Layers = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Case:
    """A file that a peer is asked to open.

    file: that was given.
    variant: PLAIN, FOR or OLDER.
    path: of the file that the peer opens; None where it cannot be written.
    refused: why not.
    told: arguments of the importer.
    """

    file: Path
    variant: str
    path: Path | None
    refused: str = ""
    told: tuple[tuple[str, str], ...] = ()

    def job(self, folder: Path) -> dict[str, str]:
        """What peer_process is told; the input spikes are written into the folder."""
        rows, out = folder / "raster.npy", folder / SPIKES
        np.save(rows, raster(self.file))
        return {"file": str(self.path), "raster": str(rows), "out": str(out), **dict(self.told)}


def case(file: Path, peer: OtherTool, variant: str, folder: Path) -> Case:
    """The case of a file; what is rewritten lies in the folder."""
    if variant == PLAIN:
        return Case(file, variant, file)
    path = folder / f"{variant.strip('-')}.nir"
    try:
        artifact = load(file)
        if variant == OLDER:
            save(artifact, path, peer.release)
            return Case(file, variant, path)
        written = for_importer(artifact, peer.name)
        save(written, path)
        return Case(
            file, variant, path, told=tuple(arguments(written.convention, peer.name).items())
        )
    except SpikedeployError as error:
        return Case(file, variant, None, refused=str(error))


def raster(file: Path) -> NDArray[np.uint8]:
    """Input spikes (T, M), the same for all peers."""
    (port,) = ports(load(file).graph.inputs)
    return random_spikes(np.random.default_rng(0), TIMESTEPS, *port.shape)


def meant(file: Path, rows: NDArray[np.uint8]) -> Layers:
    """Spikes (T, N) of each layer and "output", as the file states its network."""
    return _run(load(file), rows)


def as_read(found: Case, peer: OtherTool, rows: NDArray[np.uint8]) -> Layers | str:
    """Spikes of a case as we read it for the peer; or why we do not."""
    if found.path is None:
        return found.refused
    try:
        return _run(load(found.path, like=peer.name, **dict(found.told)), rows)  # type: ignore[arg-type]
    except SpikedeployError as error:
        return str(error).partition(": ")[2]


def _run(artifact: Artifact, rows: NDArray[np.uint8]) -> Layers:
    graph = FloatGraph(artifact)
    trace = graph.run(rows[None].astype(np.float64))
    names = [*(name for name in graph.timing.names if name in graph.spiking), "output"]
    return {name: trace[name][0].reshape(len(rows), -1) for name in names}
