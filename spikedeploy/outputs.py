"""Checks of every file that a command writes: no input, run or foreign file is overwritten.

Refused are inputs of the command, by whatever name; what is no plain file; and what belongs to a
run. A file that exists needs --force, unless the same command wrote it, which MARK in it tells. A
link is followed: the file that it names is written, and the link stays.
"""

import mmap
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import NamedTemporaryFile

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix

_MARK = "written by spikedeploy "
_PART = f".{'0' * 16}"  # as long as what files.replacing adds to a name
_MAY_STAND_IN_RUNS = (".nir", ".onnx", ".png", ".mp4", ".gif")  # exports and pictures


def mark(command: str) -> str:
    """The mark in a file that this command wrote."""
    return f"{_MARK}{command}"


def has_text(path: Path, *texts: str) -> bool:
    """True where there is a file that holds one of these texts, such as the mark of a command."""
    if not path.is_file() or not path.stat().st_size:
        return False
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        head = content[:12]
        return any(
            content.find(text.encode()) >= 0 and (not text.startswith(_MARK) or _takes_marks(head))
            for text in texts
        )


def _takes_marks(head: bytes) -> bool:
    """True where a file that begins so is npz, png, gif, HDF5 or mp4, which commands mark."""
    return head.startswith((b"PK", b"\x89PNG", b"GIF8", b"\x89HDF")) or head[4:8] == b"ftyp"


def check_folder(option: str, path: Path) -> None:
    """Refuse a folder to write to that is a file, or would be inside one."""
    for part in (path, *path.parents):
        if part.exists():
            if not part.is_dir():
                raise ConfigError(f"{option} {path}: {part} is a file. Name a folder.")
            return


def check_output(
    option: str,
    path: Path,
    inputs: Iterable[str | Path | None] = (),
    force: bool = False,
    ours: Callable[[Path], bool] | None = None,
) -> None:
    """Refuse to write to `path` where that would destroy something.

    option: option of the command, for messages
    inputs: files and folders that the command reads; names of anything else are passed over
    force: whether a file that exists may be replaced
    ours: whether an existing file is an earlier output of the command
    """
    if os.path.isdir(path):
        raise ConfigError(f"{option} {path} is a folder. Name a file in it.")
    if os.path.lexists(path) and not os.path.isfile(path):
        raise ConfigError(f"{option} {path} is a device, a pipe or a link to nothing. Name a file.")
    check_folder(option, path.parent)
    _check_writable(option, path)
    for each in inputs:
        if each is not None and _same(path, Path(each)):
            raise ConfigError(
                f"{option} {path} is the input {each}, which would be lost. Name another file."
            )
    whole = path.resolve()
    run = next((folder for folder in whole.parents if _is_run(folder)), None)
    free = whole.parent == run and suffix(whole) in _MAY_STAND_IN_RUNS
    if run is not None and not free:
        raise ConfigError(
            f"{option} {path} is inside the run folder {run}, whose own files are there. Name a "
            "file elsewhere; exports and pictures may stand in the run folder itself."
        )
    if path.exists() and not force and not (ours is not None and ours(path)):
        raise ConfigError(
            f"{option} {path}: the file exists, and not from an earlier run of this command. Name "
            "another file, or replace it with --force."
        )


def no_link(path: Path) -> Path:
    """Return a path that is written without --force; refuse a link."""
    if path.is_symlink():
        raise ConfigError(f"{path} is a link, through which nothing is written. Remove it.")
    return path


def check_output_folder(
    option: str,
    folder: Path,
    names: Iterable[str],
    inputs: Iterable[str | Path | None] = (),
    force: bool = False,
    ours: Callable[[Path], bool] | None = None,
) -> None:
    """Refuse to write files of these names into `folder` where something would be destroyed.

    ours: whether the folder has an earlier output of the command
    """
    check_folder(option, folder)
    if _is_run(folder):
        raise ConfigError(f"{option} {folder} is the folder of a training run. Name another.")
    known = list(inputs)
    earlier = ours is not None and folder.is_dir() and ours(folder)
    for name in names:
        path = folder / name  # a mark in one file does not vouch for what another leads to
        check_output(option, path, known, force or (earlier and not path.is_symlink()))


def _check_writable(option: str, path: Path) -> None:
    """Refuse a folder that takes no file of this name, before the work and not after it."""
    folder = next(each for each in Path(os.path.realpath(path)).parents if each.is_dir())
    try:
        NamedTemporaryFile(dir=folder, prefix=f".{path.name}", suffix=_PART).close()
    except OSError as error:
        raise ConfigError(
            f"{option} {path}: {folder} takes no file of this name: {error.strerror}"
        ) from error


def _same(path: Path, other: Path) -> bool:
    """True where both are one file, by links of any kind too."""
    if path.exists() and other.exists():
        return path.samefile(other)
    return other.exists() and path.resolve() == other.resolve()


def _is_run(folder: Path) -> bool:
    return (folder / "config.json").is_file() and (folder / "checkpoints").is_dir()
