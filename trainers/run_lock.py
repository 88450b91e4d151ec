"""The lock of a run folder: one process trains in it at a time; reading needs no lock."""

import errno
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from spikedeploy.runtime.errors import ConfigError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_NAME = ".lock"
_DIGITS = 9  # of the number of a process
# of file systems without flock, as some of networks are
_WITHOUT = (errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK, errno.ENOSYS, errno.EINVAL)


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Hold the run folder's lock within the block, or raise ConfigError that names its holder.

    The lock is flock's, which the kernel releases when its process ends, however it does: a lock is
    never stale. Where the file system has no flock, the process that the file names is looked up.
    """
    file = run / _NAME
    handle = _taken(file, run)
    try:
        yield
    finally:
        with suppress(OSError):
            file.unlink(missing_ok=True)
        os.close(handle)


def in_use(run: Path) -> bool:
    """Return whether another process trains in a run folder; without taking its lock."""
    try:
        # a FIFO would wait for a writer
        handle = os.open(run / _NAME, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        return stat.S_ISREG(os.fstat(handle).st_mode) and _alive(_holder(handle))
    finally:
        os.close(handle)


def _taken(file: Path, run: Path) -> int:
    """Return the open and locked file."""
    while True:
        try:
            handle = os.open(file, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise ConfigError(
                f"cannot train in {run}: {error.strerror}. Copy it to a folder that can be written."
            ) from error
        if not _free(handle):
            holder = _holder(handle)
            os.close(handle)
            raise ConfigError(_busy(run, holder))
        if _same(file, handle):
            os.ftruncate(handle, 0)
            os.pwrite(handle, f"{os.getpid()} {socket.gethostname()}\n".encode(), 0)
            return handle
        os.close(handle)  # the holder before has just taken the file away


def _free(handle: int) -> bool:
    """Whether the lock could be taken."""
    if fcntl is None:
        return not _alive(_holder(handle))
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _WITHOUT:
            raise
        return not _alive(_holder(handle))
    return True


def _same(file: Path, handle: int) -> bool:
    """Whether the name still leads to the open file."""
    try:
        return os.path.samestat(os.stat(file), os.fstat(handle))
    except FileNotFoundError:
        return False


def _holder(handle: int) -> tuple[int, str]:
    """Return the process that the file names, and its machine; 0 where it names none."""
    words = os.pread(handle, 300, 0).decode("utf-8", "replace").split()
    if len(words) != 2 or not words[0].isdecimal() or len(words[0]) > _DIGITS:
        return 0, ""
    return int(words[0]), words[1]


def _alive(holder: tuple[int, str]) -> bool:
    """Whether a process runs; one of another machine may."""
    number, machine = holder
    if machine != socket.gethostname():
        return bool(number)
    if number in (0, os.getpid()):  # its number from before: containers begin to count anew
        return False
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _busy(run: Path, holder: tuple[int, str]) -> str:
    number, machine = holder
    if not number:
        return f"{run} is being trained by another process: wait for its end."
    there = "" if machine == socket.gethostname() else f" on {machine}"
    gone = f" If it has ended, delete {run / _NAME}." if there else ""
    return f"{run} is being trained by process {number}{there}: wait for its end, or stop it.{gone}"
