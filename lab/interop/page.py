"""The command `interop`: our networks opened by other tools, and the page of what came of it."""

import argparse
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from lab.interop.cases import FOR, OLDER, PLAIN, TIMESTEPS, Row, measure
from lab.interop.tools import PEERS, OtherTool, check_given, pythons
from spikedeploy import zoo
from spikedeploy.console import print_json, say
from spikedeploy.files import write_text
from spikedeploy.outputs import check_output, marked
from spikedeploy.reports.table import markdown_text
from spikedeploy.runtime.errors import ConfigError

_LONGEST = 110  # characters of a message
_TEMPLATE = Path(__file__).with_name("template.md")
TITLE = "# Our networks in other tools"
_HEAD = b'[\n  {\n    "file":'  # how the records begin


def main() -> None:
    """Open networks in other tools, run them there, compare every spike; write a page."""
    parser = argparse.ArgumentParser(description=main.__doc__, allow_abbrev=False)
    parser.add_argument("files", nargs="*", metavar="FILE", help=".nir, or of shipped policies")
    parser.add_argument("-o", "--output", type=Path, default=Path("interop.md"))
    parser.add_argument("--records", type=Path, help="what stands there is not measured again")
    parser.add_argument(
        "--folder", type=Path, default=Path(".venv-peers"), help="as ./spike test --peers makes it"
    )
    parser.add_argument(
        "--python", action="append", default=[], metavar="TOOL=PATH", help="in which a tool is"
    )
    parser.add_argument("--force", action="store_true", help="write over what others made")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    given = _pairs(options.python)
    records = options.records or options.output.with_suffix(".json")
    chosen = _network_files(options.files)
    _check_written(options.output, records, chosen, options.force)
    places = pythons(options.folder, given)
    check_given(given)
    rows = measure(chosen, places, records, say)
    write_text(options.output, page(rows, _page_command(options.files, options.output, records)))
    if options.json:
        print_json(rows)
    else:
        print(f"wrote {options.output}")


def _pairs(texts: list[str]) -> dict[str, Path]:
    """TOOL=PATH of each text; a release of nir is TOOL too: nir==1.0.4=PATH."""
    pairs = {text: text.rpartition("=") for text in texts}
    for text, (name, _, _) in pairs.items():
        if not name:
            raise ConfigError(f"--python {text}: give TOOL=PATH")
    return {name: Path(path) for name, _, path in pairs.values()}


def _network_files(names: Sequence[str]) -> list[Path]:
    """The .nir files of these names; `shipped` stands for all shipped policies."""
    found: list[Path] = []
    for name in names or ["shipped"]:
        file = zoo.resolve(name)
        if name == "shipped":
            found += [each for each in zoo.policies() if each.suffix == ".nir"]
        elif file is not None and file.suffix == ".nir" and file.is_file():
            found.append(file)
        else:
            raise ConfigError(f"{name} is no .nir file and no shipped spiking policy")
    return found


def _check_written(page: Path, records: Path, files: Sequence[Path], force: bool) -> None:
    """Refuse to replace what this command did not write."""
    check_output("-o", page, files, force, lambda path: marked(path, TITLE))
    if page.resolve() == records.resolve():
        raise ConfigError(f"-o and --records are the same file, {page}. Name another for one.")
    check_output("--records", records, (*files, page), force, _is_ours)


def _is_ours(records: Path) -> bool:
    with records.open("rb") as file:
        return file.read(len(_HEAD)) == _HEAD


def _page_command(names: Sequence[str], page: Path, records: Path) -> str:
    """The command that makes the page again."""
    words = ["python", "-m", "lab", "interop", *names, "-o", page.as_posix()]
    if records != page.with_suffix(".json"):
        words += ["--records", records.as_posix()]
    return shlex.join(words)


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
    """Outcome of a case in words."""
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
