"""The folder of a page: report.html for people, report.json for machines."""

import shlex
import sys
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spikedeploy.files import as_text, write_text
from spikedeploy.outputs import marked
from spikedeploy.trainers.versions import own

FILES = ("report.html", "report.json")


def written_by(command: str) -> Callable[[Path], bool]:
    """Whether a folder has the page of an earlier run of this command."""
    return lambda folder: marked(folder / "report.json", f'"report_of": "{command}"')


def command_line() -> str:
    """The command that this process runs, as it can be typed again."""
    return shlex.join(["spikedeploy", *sys.argv[1:]])


def made_by() -> list[tuple[str, str]]:
    """How a page was made: version, time, command line."""
    now = datetime.now(timezone.utc).isoformat(timespec="seconds")
    return [("made by", f"spikedeploy {own()}, {now}"), ("command line", command_line())]


def write_page(command: str, html: str, numbers: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the page of a command and its numbers; return both files."""
    made = {"report_of": command, **dict(made_by()), **numbers}
    return [
        write_text(folder / "report.html", html),
        write_text(folder / "report.json", as_text(made)),
    ]
