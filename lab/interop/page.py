"""What came of all cases as a page in Markdown."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from lab.interop.cases import FOR, OLDER, PLAIN, TIMESTEPS
from lab.interop.measured import Row
from lab.interop.peers import PEERS, OtherTool
from spikedeploy.reports.table import markdown_text

_LONGEST = 110  # characters of a message

_TEMPLATE = Path(__file__).with_name("template.md")
TITLE = "# Our networks in other tools"


def page(rows: Sequence[Row], command: str) -> str:
    """The page of all rows.

    command: that makes it.
    """
    tools = [
        f"## {peer.title}\n\n{_table(peer, rows)}\n"
        for peer in PEERS
        if peer.importer or peer.missing
    ]
    return _TEMPLATE.read_text("utf-8").format(
        command=command,
        timesteps=TIMESTEPS,
        packages=_packages(rows),
        summary=_summary(rows),
        tools="\n".join(tools),
        checked=_checked(rows),
        releases=_releases(rows),
    )


def _packages(rows: Sequence[Row]) -> str:
    """Releases of what read the files."""
    found: dict[str, str] = {}
    for row in rows:
        if row["opens"] is not None and not row["peer"].startswith("nir=="):
            found |= row["versions"]
    said = ", ".join(f"{name} {found[name].partition('+')[0]}" for name in sorted(found))
    return f"Releases: {said}." if said else "No tool is installed."


def _summary(rows: Sequence[Row]) -> str:
    """How many files each tool opens, and in which of them every spike is the same."""
    body = []
    for peer in PEERS:
        files = list(_of(peer.name, rows).values())
        if not peer.importer or any(
            row["opens"] is None for each in files for row in each.values()
        ):
            continue
        plain, written = ([each[variant] for each in files] for variant in (PLAIN, FOR))
        body.append(
            [
                peer.title,
                f"{sum(bool(row['opens']) for row in plain)} of {len(plain)}",
                _equal(plain),
                _equal(written),
            ]
        )
    return markdown_text([["tool", "opens as it is", "equal as it is", "equal by `--for`"], *body])


def _equal(rows: Sequence[Row]) -> str:
    """How many files have every spike equal, and which."""
    names = [f"`{row['file']}`" for row in rows if row["opens"] and not row["meant"]["differ"]]
    return f"{len(names)} of {len(rows)}{': ' * bool(names)}{', '.join(names)}"


def _of(peer: str, rows: Sequence[Row]) -> dict[str, dict[str, Row]]:
    """File -> variant -> row."""
    found: dict[str, dict[str, Row]] = {}
    for row in rows:
        if row["peer"] == peer:
            found.setdefault(row["file"], {})[row["variant"]] = row
    return found


def _table(peer: OtherTool, rows: Sequence[Row]) -> str:
    if peer.missing:
        return f"{peer.missing[0].upper()}{peer.missing[1:]}."
    body = [
        [f"`{file}`", _cell(each[PLAIN]), _cell(each[FOR])]
        for file, each in _of(peer.name, rows).items()
    ]
    return markdown_text([["file", "as it is", f"`--for {peer.name}`"], *body])


def _cell(row: Row) -> str:
    """What came of a case in words."""
    if row["opens"] is None:
        return "not installed"
    if not row["opens"]:
        return f"refused: {_short(row['message'])}"
    found = row["meant"]
    if found["differ"]:
        timestep, layer, neuron = found["first"]
        first = f"first in timestep {timestep}, `{layer}`, neuron {neuron}"
        return f"opens, {found['differ']:,} of {found['compared']:,} differ, {first}{_like(row)}"
    output = "" if found["output"] == "equal" else f", output {found['output']}"
    return f"**equal**, {found['compared']:,} compared{output}"


def _like(row: Row) -> str:
    """How far the tool computes what we say that it does."""
    if isinstance(row["like"], str):
        return ""
    apart = row["like"]["differ"]
    return f"; from `--like` {apart:,} do" if apart else "; as `--like` says"


def _checked(rows: Sequence[Row]) -> str:
    body = [[f"`{file}`", _verdict(each[PLAIN])] for file, each in _of("snn-mlir", rows).items()]
    return markdown_text([["file", "check"], *body])


def _verdict(row: Row) -> str:
    if row["opens"] is None:
        return "not installed"
    return "OK" if row["opens"] else f"refused: {_short(row['message'])}"


def _releases(rows: Sequence[Row]) -> str:
    body = [
        [peer.release, *_counts(_of(peer.name, rows))] for peer in reversed(PEERS) if peer.release
    ]
    return markdown_text([["nir", "as it is", "`--nir-compat`"], *body])


def _counts(files: dict[str, dict[str, Row]]) -> Iterator[str]:
    """Files that open, and the first message of those that do not, for both variants."""
    for variant in (PLAIN, OLDER):
        found = [each[variant] for each in files.values()]
        if any(row["opens"] is None for row in found):
            yield "not installed"
            continue
        bad = [row["message"] for row in found if not row["opens"]]
        said = f"; {_short(bad[0])}" if bad else ""
        yield f"{len(found) - len(bad)} of {len(found)} open{said}"


def _short(message: str) -> str:
    """A message on one line of a table."""
    line = re.sub(r"^--for [a-z]+: ", "", message).partition(" Without --for")[0]
    line = line.partition(", only ")[0].replace("|", "\\|").replace("<", "&lt;").rstrip(".")
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST].rstrip()} …"
