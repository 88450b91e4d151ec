"""The command `interop`: our networks opened by other tools, and the page of what came of it."""

import argparse
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from lab.interop.cases import (
    FOR,
    OLDER,
    PEERS,
    PLAIN,
    TIMESTEPS,
    Row,
    measure,
    pythons,
)
from spikedeploy import zoo
from spikedeploy.console import say
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import write_text

_LONGEST = 110  # characters of a message
_TEMPLATE = Path(__file__).with_name("template.md")


def main() -> None:
    """Open networks in other tools, run them there, compare every spike; write a page."""
    parser = argparse.ArgumentParser(description=main.__doc__, allow_abbrev=False)
    parser.add_argument("files", nargs="*", metavar="FILE", help=".nir, or of shipped policies")
    parser.add_argument("-o", "--output", type=Path, default=Path("interop.md"))
    parser.add_argument("--records", type=Path, help="what stands there is not measured again")
    parser.add_argument(
        "--folder", type=Path, default=Path(".venv-peers"), help="as ./spike test --peers makes it"
    )
    options = parser.parse_args()
    records = options.records or options.output.with_suffix(".json")
    chosen = [file for name in options.files or ["shipped"] for file in _network_files(name)]
    rows = measure(chosen, pythons(options.folder), records, say)
    command = ["python", "-m", "lab", "interop", *options.files, "-o", options.output.as_posix()]
    if records != options.output.with_suffix(".json"):
        command += ["--records", records.as_posix()]
    print(write_text(options.output, page(rows, shlex.join(command))))


def _network_files(name: str) -> list[Path]:
    """Return the .nir file of a name; `shipped` stands for all shipped policies."""
    if name == "shipped":
        return [each for each in zoo.policies() if each.suffix == ".nir"]
    file = zoo.resolve(name)
    if file is None or file.suffix != ".nir" or not file.is_file():
        raise ConfigError(f"{name} is no .nir file and no shipped spiking policy")
    return [file]


def page(rows: Sequence[Row], command: str) -> str:
    """The page of all rows.

    command: that makes it.
    """
    # tool -> file -> variant -> row
    by_tool: dict[str, dict[str, dict[str, Row]]] = {}
    for row in rows:
        by_tool.setdefault(row["peer"], {}).setdefault(row["file"], {})[row["variant"]] = row
    releases: dict[str, str] = {}  # of what read the files
    for row in rows:
        if row["opens"] is not None and not row["peer"].startswith("nir=="):
            releases |= row["versions"]
    template = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
        autoescape=False,
    ).from_string(_TEMPLATE.read_text("utf-8"))  # fmt: skip
    return template.render(
        command=command,
        timesteps=TIMESTEPS,
        releases=", ".join(f"{n} {releases[n].partition('+')[0]}" for n in sorted(releases)),
        rows=by_tool,
        peers=PEERS,
        is_installed=lambda name: all(
            row["opens"] is not None for each in by_tool[name].values() for row in each.values()
        ),
        **{"PLAIN": PLAIN, "FOR": FOR, "OLDER": OLDER, "equal": _equal, "cell": _cell},
        **{"verdict": _verdict, "opened": _opened},
    )


def _equal(rows: Sequence[Row]) -> str:
    """How many files have every spike equal, and which."""
    names = [f"`{row['file']}`" for row in rows if row["opens"] and not row["meant"]["differ"]]
    return f"{len(names)} of {len(rows)}{': ' * bool(names)}{', '.join(names)}"


def _cell(row: Row) -> str:
    """Outcome of a case in words."""
    if not row["opens"]:
        return _verdict(row)
    found, like = row["meant"], row["like"]
    if not found["differ"]:
        output = "" if found["output"] == "equal" else f", output {found['output']}"
        return f"**equal**, {found['compared']:,} compared{output}"
    timestep, layer, neuron = found["first"]
    first = f"first in timestep {timestep}, `{layer}`, neuron {neuron}"
    beside = ""  # how far the tool computes what we say that it does
    if not isinstance(like, str):
        apart = like["differ"]
        beside = f"; from `--like` {apart:,} do" if apart else "; as `--like` says"
    return f"opens, {found['differ']:,} of {found['compared']:,} differ, {first}{beside}"


def _verdict(row: Row) -> str:
    if row["opens"] is None:
        return "not installed"
    return "OK" if row["opens"] else f"refused: {_short(row['message'])}"


def _opened(rows: Sequence[Row]) -> str:
    """How many files open, and the first message of those that do not."""
    if any(row["opens"] is None for row in rows):
        return "not installed"
    bad = [row["message"] for row in rows if not row["opens"]]
    said = f"; {_short(bad[0])}" if bad else ""
    return f"{len(rows) - len(bad)} of {len(rows)} open{said}"


def _short(message: str) -> str:
    """A message on one line of a table."""
    line = re.sub(r"^--for [a-z]+: ", "", message).partition(" Without --for")[0]
    line = line.partition(", only ")[0].replace("|", "\\|").replace("<", "&lt;").rstrip(".")
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST].rstrip()} …"
