"""All cases of all files, opened by the tools that are installed, every spike compared.

A case is a file as it is, or rewritten for a tool. What stands in the records is not measured
again.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy import zoo
from spikedeploy.exporters.check import random_spikes
from spikedeploy.runtime.artifact.artifact import Artifact, for_importer, load, save
from spikedeploy.runtime.dialects.rewriting import arguments
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.files import as_text, write_text
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import ports

_SCRIPT = Path(__file__).with_name("peer_process.py")
_SECONDS = 600  # for all jobs of one call
_RELEASES = ("1.0.1", "1.0.4", "1.0.5", "1.0.6", "1.0.7", "1.0.8")


@dataclass(frozen=True)
class OtherTool:
    """A tool.

    name      of its environment
    title     in words
    importer  whether it computes spikes, and `export --for` knows it
    missing   why it is never run; empty where it is
    """

    name: str
    title: str
    importer: bool = False
    missing: str = ""

    @property
    def release(self) -> str:
        """The release of nir that it is; empty for other tools."""
        return self.name.removeprefix("nir==") if self.name.startswith("nir==") else ""


PEERS = (
    OtherTool("norse", "Norse", importer=True),
    OtherTool("snntorch", "snnTorch", importer=True),
    OtherTool("spikingjelly", "SpikingJelly", importer=True),
    OtherTool("rockpool", "Rockpool", importer=True),
    OtherTool(
        "sinabs", "sinabs", missing="not opened here: it asks for an older `nir`, and for samna"
    ),
    OtherTool("snn-mlir", "snn-mlir check"),
    *(OtherTool(f"nir=={release}", f"nir {release}") for release in _RELEASES),
)


def pythons(folder: Path) -> dict[str, Path]:
    """Return the Python of each tool that has one, FOLDER/NAME/bin/python."""
    names = [peer.name for peer in PEERS]
    own = f"nir=={version('nir')}"
    usual = {own: Path(sys.executable)} if own in names else {}
    places = {name: (folder / name / "bin" / "python").absolute() for name in names}
    return usual | {name: place for name, place in places.items() if place.exists()}


def versions(peer: OtherTool, python: Path) -> dict[str, str]:
    """Releases of the packages that a tool reads files with; empty where it is not installed."""
    try:
        found = json.loads(_ask([str(python), str(_SCRIPT), peer.name, "versions"], "", 60))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def answers(peer: OtherTool, python: Path, jobs: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """The tool's answer to each job, in their order."""
    command = [str(python), str(_SCRIPT), peer.name]
    lines = _ask(command, json.dumps(jobs), _SECONDS).splitlines()
    yield from map(json.loads, lines)
    for _ in jobs[len(lines) :]:
        yield {"opens": False, "message": "its process ended, or took too long"}


def _ask(command: list[str], given: str, seconds: float) -> str:
    """The stdout of a process until it ended, or until its time was over."""
    try:
        done = subprocess.run(
            command, input=given, capture_output=True, text=True, check=False, timeout=seconds
        )
    except subprocess.TimeoutExpired as error:
        written = error.stdout or ""
        return written.decode() if isinstance(written, bytes) else written
    return done.stdout


# cases

TIMESTEPS = 400
PLAIN, FOR, OLDER = "as it is", "--for", "--nir-compat"
_SPIKES = "spikes.npz"  # of a tool, in the folder of its case
_KEY = ("file", "sha256", "peer", "variant")
_OUTPUT = 1e-4  # of the largest output: what float32 may round

Row = dict[str, Any]
Layers = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Case:
    """A file that a tool is given.

    file     from which it was made
    path     that the tool opens; None where it cannot be written
    refused  why not
    options  arguments of the importer
    """

    file: Path
    path: Path | None
    refused: str = ""
    options: tuple[tuple[str, str], ...] = ()

    def job(self, folder: Path) -> dict[str, str]:
        """The job for peer_process; the input spikes are written into the folder."""
        rows, out = folder / "raster.npy", folder / _SPIKES
        np.save(rows, raster(self.file))
        return {"file": str(self.path), "raster": str(rows), "out": str(out), **dict(self.options)}


def case(file: Path, peer: OtherTool, variant: str, folder: Path) -> Case:
    """The case of a file; what is rewritten lies in the folder."""
    if variant == PLAIN:
        return Case(file, file)
    path = folder / f"{variant.strip('-')}.nir"
    try:
        artifact = load(file)
        if variant == OLDER:
            save(artifact, path, peer.release)
            return Case(file, path)
        written = for_importer(artifact, peer.name)
        save(written, path)
        options = arguments(written.convention, peer.name)
        return Case(file, path, options=tuple(options.items()))
    except SpikedeployError as error:
        return Case(file, None, refused=str(error))


def raster(file: Path) -> NDArray[np.uint8]:
    """Input spikes (T, M), the same for all tools."""
    (port,) = ports(load(file).graph.inputs)
    return random_spikes(np.random.default_rng(0), TIMESTEPS, *port.shape)


def intended(file: Path, rows: NDArray[np.uint8]) -> Layers:
    """Spikes (T, N) of each layer and "output", as the file states its network."""
    return _run(load(file), rows)


def _as_read(found: Case, peer: OtherTool, rows: NDArray[np.uint8]) -> Layers | str:
    """Spikes of a case as we read it for the tool; or why we do not."""
    try:
        return _run(load(found.path or "", like=peer.name, **dict(found.options)), rows)  # type: ignore[arg-type]
    except SpikedeployError as error:
        return str(error).partition(": ")[2]


def _run(artifact: Artifact, rows: NDArray[np.uint8]) -> Layers:
    graph = FloatGraph(artifact)
    trace = graph.run(rows[None].astype(np.float64))
    names = [*(name for name in graph.timing.names if name in graph.spiking), "output"]
    return {name: trace[name][0].reshape(len(rows), -1) for name in names}


def compare(theirs: Layers, ours: Layers) -> Row:
    """Compare layers (T, N) in their order; the last is the output.

    compared  spikes and absences of them, over all layers and timesteps
    differ    of them
    first     timestep, layer and neuron of the first difference; None where there is none
    output    "equal", "differs" or "another shape"

    Names need not agree: what is written for Norse may have others.
    """
    total, differ = 0, 0
    first: list[Any] | None = None
    *layers, (_, output) = zip(theirs.values(), ours.items(), strict=True)
    for found, (name, wanted) in layers:
        unequal = found != wanted
        total, differ = total + unequal.size, differ + int(np.count_nonzero(unequal))
        if unequal.any():
            timestep, neuron = (int(each) for each in np.argwhere(unequal)[0])
            if first is None or timestep < first[0]:
                first = [timestep, name, neuron]
    verdict = _output(theirs["output"], output[1])
    return {"compared": total, "differ": differ, "first": first, "output": verdict}


def _output(found: NDArray[Any], wanted: NDArray[Any]) -> str:
    if found.shape != wanted.shape:
        return "another shape"
    limit = _OUTPUT * max(float(np.abs(wanted).max()), 1e-12)
    return "equal" if np.abs(found - wanted).max() <= limit else "differs"


def measure(
    files: Sequence[Path], places: Mapping[str, Path], records: Path, say: Callable[[str], None]
) -> list[Row]:
    """Rows of all cases, in the order of files and tools; those of `records` are kept.

    A row has `file`, `sha256`, `peer`, `variant`, `versions`; `opens` and `message`; of importers
    `meant` and `like`, which compare with the network as its file states it, and as we read the
    file for the tool.
    """
    known = {_key(row): row for row in _read(records)}
    rows: list[Row] = []
    for peer in PEERS:
        found = {} if peer.missing or peer.name not in places else versions(peer, places[peer.name])
        heads = [
            (file, _head(file, peer, variant, found))
            for file in files
            for variant in _variants(peer)
        ]
        due = [(file, head) for file, head in heads if found and not _is_known(head, known)]
        if due:
            say(f"{peer.title}: {len(due)} files")
            known |= {_key(row): row for row in _rows(peer, places[peer.name], due)}
            write_text(records, as_text(list(known.values())))
        nothing = {"opens": None, "message": ""}
        rows += [known.get(_key(head), {**head, **nothing}) for _, head in heads]
    return rows


def _is_known(head: Row, known: Mapping[str, Row]) -> bool:
    """Return whether the same file was opened by the same releases."""
    row = known.get(_key(head), {"opens": None})
    return row["opens"] is not None and bool(row["versions"] == head["versions"])


def _variants(peer: OtherTool) -> tuple[str, ...]:
    if peer.importer:
        return PLAIN, FOR
    return (PLAIN, OLDER) if peer.release else (PLAIN,)


def _head(file: Path, peer: OtherTool, variant: str, found: Mapping[str, str]) -> Row:
    return {
        "file": zoo.name_in_reports(str(file)),
        "sha256": zoo.sha256(file),
        "peer": peer.name,
        "variant": variant,
        "versions": dict(found),
    }


def _key(row: Row) -> str:
    return json.dumps([row[field] for field in _KEY], sort_keys=True)


def _rows(peer: OtherTool, python: Path, due: Sequence[tuple[Path, Row]]) -> Iterator[Row]:
    """Rows of files and variants, which the tool opens one after another."""
    with TemporaryDirectory() as place:
        cases: list[tuple[Row, Case, Path]] = []
        for number, (file, head) in enumerate(due):
            folder = Path(place) / str(number)
            folder.mkdir()
            cases.append((head, case(file, peer, head["variant"], folder), folder))
        jobs = [found.job(folder) for _, found, folder in cases if found.path is not None]
        answered = answers(peer, python, jobs)
        for head, found, folder in cases:
            if found.path is None:
                yield {**head, "opens": False, "message": found.refused}
                continue
            answer = next(answered)
            spikes = _spikes(found, peer, folder) if answer["opens"] and peer.importer else {}
            yield {**head, **answer, **spikes}


def _spikes(found: Case, peer: OtherTool, folder: Path) -> Row:
    """The tool's spikes beside the file's own, and beside ours as the tool reads it."""
    rows = raster(found.file)
    ours, like = intended(found.file, rows), _as_read(found, peer, rows)
    with np.load(folder / _SPIKES) as file:
        theirs = {name: file[name] for name in (ours if isinstance(like, str) else like)}
    return {
        "meant": compare(theirs, ours),
        "like": like if isinstance(like, str) else compare(theirs, like),
    }


def _read(records: Path) -> list[Row]:
    try:
        rows: list[Row] = json.loads(records.read_bytes()) if records.is_file() else []
        if all({*_KEY, "message", "versions", "opens"} <= row.keys() for row in rows):
            return rows
    except (ValueError, RecursionError, AttributeError, TypeError):
        pass
    raise ConfigError(f"--records {records} does not hold what interop found: name another")
