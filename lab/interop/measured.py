"""All cases of all files, with the peers that are installed; resumed where they stopped."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from lab.interop.cases import FOR, OLDER, PLAIN, SPIKES, Case, as_read, case, meant, raster
from lab.interop.outcome import compared
from lab.interop.peers import PEERS, OtherTool, answers, versions
from spikedeploy import zoo
from spikedeploy.files import as_text, write_text
from spikedeploy.runtime.errors import ConfigError

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
    """The peer's spikes beside the file's own, and beside ours as the peer reads it."""
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
    """Whether it has the fields that the page is made of."""
    if not isinstance(row, dict) or not all(
        isinstance(row.get(f), str) for f in (*_KEY, "message")
    ):
        return False
    releases, opens = row.get("versions"), row.get("opens", "")
    if not isinstance(releases, dict) or not all(isinstance(v, str) for v in releases.values()):
        return False
    importers = {peer.name for peer in PEERS if peer.importer}
    if opens is True and row["peer"] in importers:
        return _is_compared(row.get("meant")) and (
            isinstance(row.get("like"), str) or _is_compared(row.get("like"))
        )
    return opens is None or isinstance(opens, bool)


def _is_compared(found: object) -> bool:
    """Whether it is a record of SpikesCompared."""
    if not isinstance(found, dict) or found.keys() != {"compared", "differ", "first", "output"}:
        return False
    first = found["first"]
    return (
        all(type(found[name]) is int for name in ("compared", "differ"))
        and isinstance(found["output"], str)
        and (isinstance(first, list) and len(first) == 3 if found["differ"] else first is None)
    )
