"""Atomic writes: a file is complete or does not exist."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, which replaces it at the end of the block.

    A link is followed, and stays. What is no plain file is refused: a device would be replaced.
    """
    whole = Path(os.path.realpath(path))
    if whole.exists() and not whole.is_file():
        raise FileExistsError(errno.EEXIST, "is no plain file, and is not replaced", str(path))
    temporary = whole.with_name(f".{whole.name}.{os.getpid()}.part")
    try:
        yield temporary
        flush(temporary)
        os.replace(temporary, whole)
        flush(whole.parent)
    finally:
        temporary.unlink(missing_ok=True)


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
