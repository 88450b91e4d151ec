"""The files that are opened, the guard of those that are written, and the command in the page."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from lab.interop.page import TITLE
from spikedeploy import zoo
from spikedeploy.outputs import check_output, marked
from spikedeploy.runtime.errors import ConfigError

# how the records begin
_HEAD = b'[\n  {\n    "file":'


def network_files(names: Sequence[str]) -> list[Path]:
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


def check_written(page: Path, records: Path, files: Sequence[Path], force: bool) -> None:
    """Refuse to replace what this command did not write."""
    check_output("-o", page, files, force, lambda path: marked(path, TITLE))
    if page.resolve() == records.resolve():
        raise ConfigError(f"-o and --records are the same file, {page}. Name another for one.")
    check_output("--records", records, (*files, page), force, _is_ours)


def _is_ours(records: Path) -> bool:
    with records.open("rb") as file:
        return file.read(len(_HEAD)) == _HEAD


def page_command(names: Sequence[str], page: Path, records: Path) -> str:
    """The command that makes the page again."""
    words = ["python", "-m", "lab", "interop", *names, "-o", page.as_posix()]
    if records != page.with_suffix(".json"):
        words += ["--records", records.as_posix()]
    return shlex.join(words)
