"""All cases of all files, with the peers that are installed; resumed where they stopped."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from spikedeploy import zoo
from spikedeploy.files import as_text, write_text
from spikedeploy.interop.cases import FOR, OLDER, PLAIN, SPIKES, Case, as_read, case, meant, raster
from spikedeploy.interop.outcome import compared
from spikedeploy.interop.peers import PEERS, OtherTool, answers, versions

Row = dict[str, Any]
_KEY = ("file", "sha256", "peer", "variant")


def measure(
    files: Sequence[Path],
    places: Mapping[str, Path],
    records: Path,
    say: Callable[[str], None],
) -> list[Row]:
    """Rows of all cases, in the order of files and peers; those of `records` are kept.

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
        due = [(file, head) for file, head in heads if found and not _stands(head, known)]
        if due:
            say(f"{peer.title}: {len(due)} files")
            known |= {_key(row): row for row in _asked(peer, places[peer.name], due)}
            write_text(records, as_text(list(known.values())))
        nothing = {"opens": None, "message": ""}
        rows += [known.get(_key(head), {**head, **nothing}) for _, head in heads]
    return rows


def _stands(head: Row, known: Mapping[str, Row]) -> bool:
    """Whether the same file was opened by the same releases."""
    row = known.get(_key(head), {"opens": None})
    return row["opens"] is not None and bool(row["versions"] == head["versions"])


def _variants(peer: OtherTool) -> tuple[str, ...]:
    if peer.importer:
        return PLAIN, FOR
    return (PLAIN, OLDER) if peer.release else (PLAIN,)


def _head(file: Path, peer: OtherTool, variant: str, found: Mapping[str, str]) -> Row:
    name = zoo.called(str(file))
    return {
        "file": name,
        "sha256": zoo.sha256(file),
        "peer": peer.name,
        "variant": variant,
        "versions": dict(found),
    }


def _key(row: Row) -> str:
    return json.dumps([row[field] for field in _KEY], sort_keys=True)


def _asked(peer: OtherTool, python: Path, due: Sequence[tuple[Path, Row]]) -> Iterator[Row]:
    """Rows of files and variants, which the peer opens one after another."""
    with TemporaryDirectory() as place:
        cases: list[tuple[Row, Case, Path]] = []
        for number, (file, head) in enumerate(due):
            folder = Path(place) / str(number)
            folder.mkdir()
            cases.append((head, case(file, peer, head["variant"], folder), folder))
        open_ = [(found, folder) for _, found, folder in cases if found.path is not None]
        said = answers(peer, python, [found.job(folder) for found, folder in open_])
        for head, found, folder in cases:
            if found.path is None:
                yield {**head, "opens": False, "message": found.refused}
                continue
            answer = next(said)
            spikes = _spikes(found, peer, folder) if answer["opens"] and peer.importer else {}
            yield {**head, **answer, **spikes}


def _spikes(found: Case, peer: OtherTool, folder: Path) -> Row:
    """The peer's spikes beside the file's own, and beside our reading of it for the peer."""
    rows = raster(found.file)
    ours, like = meant(found.file, rows), as_read(found, peer, rows)
    order = list(ours if isinstance(like, str) else like)
    with np.load(folder / SPIKES) as file:
        theirs = {name: file[name] for name in order}
    return {
        "meant": compared(theirs, ours).record(),
        "like": like if isinstance(like, str) else compared(theirs, like).record(),
    }


def _read(records: Path) -> list[Row]:
    if not records.is_file():
        return []
    rows: list[Row] = json.loads(records.read_text("utf-8"))
    return rows
