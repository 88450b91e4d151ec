"""Files that are complete or do not exist: atomic writes, JSON, locks; for every package."""

import errno
import hashlib
import itertools
import json
import math
import os
import re
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]

MOST_TOML = 1 << 15  # bytes: the time that a key with many dots takes grows with their square


def suffix(path: Path | str) -> str:
    """The suffix of a file's name in lower case, ".nir" of NET.NIR; "" where there is none."""
    return Path(path).suffix.lower()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, which replaces it at the end of the block.

    Its folder is created. A link is followed, and stays. Anything but a plain file is refused: a
    device would be replaced. Temporary files that killed processes of this machine left of it are
    deleted.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise FileExistsError(errno.EEXIST, "is no plain file, and is not replaced", str(path))
    target.parent.mkdir(parents=True, exist_ok=True)
    _sweep(target)
    prefix = f"{_prefix(target)}{os.getpid()}"
    names = (f"{prefix}{f'-{k}' if k else ''}.part" for k in itertools.count())
    # this process may be writing the file already
    temporary = next(path for name in names if not (path := target.with_name(name)).exists())
    try:
        yield temporary
        flush(temporary)
        os.replace(temporary, target)
        flush(target.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _sweep(target: Path) -> None:
    """Delete temporary files of a target whose processes on this machine have ended."""
    form = re.compile(re.escape(_prefix(target)) + r"([0-9]+)(-[0-9]+)?\.part")
    with suppress(OSError):  # of a folder that cannot be listed
        for name in os.listdir(target.parent):
            found = form.fullmatch(name)
            if found and _has_ended(int(found[1])):
                (target.parent / name).unlink(missing_ok=True)


def _prefix(target: Path) -> str:
    """Return the prefix of temporary files of a target that processes of this machine write.

    Processes of other machines cannot be checked.
    """
    machine = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:6]
    return f".{target.name}.{machine}-"


def _has_ended(process: int) -> bool:
    """True where there is no process of this number; False on Windows, which would signal it."""
    if sys.platform == "win32":
        return False
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return True
    except PermissionError:  # it is somebody else's
        return False
    return False


def flush(path: Path) -> None:
    """Put a file, or the names in a folder, onto the disk, so that a power cut leaves them."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:  # some file systems have no fsync of folders
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> Path:
    """Write the text; return the path."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")
    return path


def write_json(path: Path, data: object) -> Path:
    """Write `data` as `as_text` does; return the path."""
    return write_text(path, as_text(data))


def as_text(data: object) -> str:
    """`data` as JSON; numbers that JSON lacks (NaN, infinity) become null."""
    return json.dumps(_finite(data), indent=2, allow_nan=False) + "\n"


def _finite(data: object) -> object:
    if isinstance(data, dict):
        return {str(key): _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data


def read_json(path: Path, remedy: str = "put it back, or move it away") -> dict[str, Any]:
    """The object in a JSON file that a command wrote; ConfigError where it is damaged."""
    try:
        found = json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is damaged ({error}): {remedy}") from error
    if not isinstance(found, dict):
        raise ConfigError(f"{path} is damaged, it holds no JSON object: {remedy}")
    return found


def read_text(path: Path, encoding: str = "utf-8") -> str:
    """The text of a file; OSError for devices and pipes, which may never end."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is no plain file", str(path))
    return path.read_text(encoding)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file, such as those that belong to a module; ValueError, OSError."""
    if (size := path.stat().st_size) > MOST_TOML:
        raise ValueError(f"it has {size:,} bytes; at most {MOST_TOML:,} are read")
    tables: dict[str, Any] = tomllib.loads(read_text(path))
    return tables


@contextmanager
def locked(path: Path, busy: str = "") -> Iterator[None]:
    """Hold the lock of a file within the block; the kernel releases it when its process ends.

    busy: message of the ConfigError where another process holds it, which is named; "" waits
    """
    from filelock import FileLock, Timeout  # lazily: most commands lock nothing

    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(path, timeout=0.2 if busy else -1).acquire()
    except Timeout:
        holder = path.read_text(encoding="utf-8", errors="replace").strip()
        raise ConfigError(f"{busy} (process {holder or 'unknown'})") from None
    with lock:
        path.write_text(f"{os.getpid()} on {socket.gethostname()}\n", encoding="utf-8")
        try:
            yield
        finally:
            path.unlink(missing_ok=True)  # before the release: FileLock takes no unlinked file


def is_locked(path: Path) -> bool:
    """True where another process holds the lock of this file."""
    from filelock import FileLock, Timeout

    try:
        if path.is_file():
            FileLock(path, timeout=0).acquire().lock.release()
    except Timeout:
        return True
    except OSError:  # a folder that cannot be written is trained in by nobody
        return False
    return False
