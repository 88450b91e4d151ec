"""All cases of all files, opened by the tools that are installed, every spike compared.

A case is a file as it is, or rewritten for a tool. What stands in the records is not measured
again.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.interop.tools import PEERS, OtherTool, answers, versions
from spikedeploy import zoo
from spikedeploy.exporters.check import random_spikes
from spikedeploy.files import as_text, write_text
from spikedeploy.runtime.artifact.artifact import Artifact, for_importer, load, save
from spikedeploy.runtime.dialects.rewriting import arguments
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import ports

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
        "file": zoo.called(str(file)),
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
    if not records.is_file():
        return []
    try:
        rows = json.loads(records.read_bytes())
    except (ValueError, RecursionError):
        rows = None
    if not isinstance(rows, list) or not all(map(_is_row, rows)):
        raise ConfigError(
            f"--records {records} does not hold what interop found. Name another, or delete it."
        )
    return rows


def _is_row(row: object) -> bool:
    """Return whether it has the fields that the page is made of."""
    if not isinstance(row, dict) or not all(
        isinstance(row.get(f), str) for f in (*_KEY, "message")
    ):
        return False
    is_importer = row["peer"] in {peer.name for peer in PEERS if peer.importer}
    found = row.get("meant") if row.get("opens") is True and is_importer else None
    return (
        isinstance(row.get("versions"), dict)
        and row.get("opens") in (None, True, False)
        and (found is not None or not (row.get("opens") and is_importer))
        and (found is None or {"compared", "differ", "first", "output"} <= found.keys())
    )
