"""A folder that `export --to verilog` wrote: its record, how it is written, and its simulation."""

import hashlib
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Annotated

from pydantic import AfterValidator, BaseModel, Field, ValidationError

from spikedeploy import zoo
from spikedeploy.console import say
from spikedeploy.exporters.c.packaging import MAKEFILE, write_texts
from spikedeploy.exporters.verilog.board_files import MARK
from spikedeploy.exporters.verilog.image import core_image
from spikedeploy.exporters.verilog.simulation import PROGRAM, RtlProcess
from spikedeploy.exporters.verilog.tools import make_variables, require_tool
from spikedeploy.outputs import has_text
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text, read_json

RECORD = "export.json"
COSTS = "costs.json"  # to which make adds what it built
_REMEDY = "export the policy again"
# what makes another program of a core, where Verilog makes another core, which is compared anyway
_OF_THE_PROGRAM = (".hex", ".vh")


def _inside(name: str) -> str:
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        raise ValueError(f"{name} is elsewhere")
    return name


class VerilogFolder(BaseModel, frozen=True):
    """An export, all of which but the folder is in RECORD.

    folder: with the files.
    policy: what was exported, in words.
    sha256: of its file.
    chip: whose integers the core computes, with the clock in the name where it is not the chip's.
    board: board that the top module is for.
    files: name -> sha256 of what was written.
    quantise: granularity of its scales; absent from folders of earlier versions.
    """

    folder: Path = Field(exclude=True)
    policy: str
    sha256: str
    chip: str
    board: str
    files: dict[Annotated[str, AfterValidator(_inside)], str]
    quantise: Granularity = PLAIN.granularity

    def changed(self) -> tuple[str, ...]:
        """Names of files that are there, and not as they were written."""
        there = {
            name: path
            for name in self.files
            if name != COSTS and (path := self.folder / name).is_file()
        }
        return tuple(name for name, path in there.items() if _sum(path) != self.files[name])

    def missing(self) -> tuple[str, ...]:
        """Names of files that are not there."""
        return tuple(name for name in self.files if not (self.folder / name).is_file())


def is_export(folder: Path) -> bool:
    """True where the folder has an earlier export, or what one left that was killed."""
    return has_text(folder / RECORD, MARK)


def check_unchanged(option: str, folder: Path, force: bool) -> None:
    """Refuse to replace files of an earlier export that were changed since."""
    # of an export that was killed there is no Makefile, and its files are of two exports
    if force or not is_export(folder) or not (folder / MAKEFILE).is_file():
        return
    if changed := read_folder(folder).changed():
        raise ConfigError(
            f"{option} {folder}: {_listed(changed)} changed since the export. Name another folder, "
            "or replace it with --force."
        )


def write_folder(texts: Mapping[str, str], written: VerilogFolder) -> None:
    """Write all files or none; those of an earlier export that this one has not are removed.

    They are of another policy or board. What is not as it was written stays.
    """
    folder = written.folder
    earlier = read_folder(folder) if is_export(folder) else None
    stale = set(earlier.files) - set(texts) - set(earlier.changed()) if earlier else set()
    write_texts(
        {**texts, RECORD: as_text({"format": MARK, **written.model_dump()})}, folder, RECORD
    )
    for name in stale:
        if not (path := folder / name).is_symlink():
            path.unlink(missing_ok=True)


def sums_of(texts: Mapping[str, str]) -> dict[str, str]:
    """Name -> sha256 of each text."""
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}


def read_folder(folder: Path) -> VerilogFolder:
    """The export in a folder; ConfigError where there is none, or its record is damaged."""
    if not is_export(folder):
        raise ConfigError(
            f"{folder} is no folder that `spikedeploy export --to verilog` wrote: it has no "
            f"{RECORD} with its mark"
        )
    try:
        return VerilogFolder(**{**read_json(folder / RECORD, _REMEDY), "folder": folder})
    except ValidationError as error:
        fields = ", ".join(str(each["loc"][0]) for each in error.errors())
        raise ConfigError(f"{folder / RECORD} is damaged ({fields}): {_REMEDY}") from error


def folder_of(policy: Path, folder: Path) -> VerilogFolder:
    """The export of this policy's file; ConfigError where it is another's, or damaged."""
    found = read_folder(folder)
    if found.sha256 != zoo.sha256(policy):
        raise ConfigError(
            f"--via {folder} was exported from {found.policy}, and {policy} is another file: "
            f"{_REMEDY}, or run that one"
        )
    if missing := found.missing():
        raise ConfigError(f"--via {folder} is damaged, {_listed(missing)} missing: {_REMEDY}")
    damaged = [name for name in found.changed() if name.endswith(_OF_THE_PROGRAM)]
    if damaged:
        raise ConfigError(
            f"--via {folder}: {_listed(damaged)} not as exported, so that it is another program: "
            f"{_REMEDY}"
        )
    return found


def _listed(names: "tuple[str, ...] | list[str]") -> str:
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"{names[0]}{more} {'are' if more else 'is'}"


def _sum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def build_simulation(found: VerilogFolder) -> Path:
    """The program that simulates the core, built where it is missing or older than its sources.

    Raises ConfigError with what make said where it cannot be built.
    """
    make = require_tool("make")
    target = found.folder / PROGRAM
    if not target.exists():
        say(f"building {target} with Verilator")
    words = [make, "-s", "-C", str(found.folder), "-f", MAKEFILE, *make_variables(), PROGRAM]
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode or not target.is_file():
        lines = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        why = next((line for line in lines if not line.startswith("make")), "make failed")
        raise ConfigError(f"--via {found.folder}: the simulation cannot be built: {why}")
    return target


@contextmanager
def open_hardware(found: VerilogFolder, policy: Path) -> Iterator[RtlProcess]:
    """The core of a folder in simulation, with its probe; policy: the file that it was made of."""
    artifact = load(policy)
    program = compile_program(artifact, chip(found.chip), Quantisation(found.quantise))
    image = core_image(program, artifact.codec)
    with RtlProcess(build_simulation(found), image) as process:
        yield process
