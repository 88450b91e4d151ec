"""Checksums of a run's files, so that what is read is what training wrote.

A checkpoint holds its own, and those of the files that belong to it. That of config.json stands in
SHA256SUMS beside it, as `sha256sum -c` reads it.
"""

import hashlib
from pathlib import Path

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.atomic import replacing

SUMS = "SHA256SUMS"
_CHUNK = 1 << 20


def of_bytes(content: bytes) -> str:
    """Return the SHA-256 of some bytes, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def of_file(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def write_summed(path: Path, content: bytes) -> None:
    """Write a file with its checksum beside it; killed in between, both contents are accepted."""
    new = of_bytes(content)
    before = _accepted(path) or ([of_file(path)] if path.is_file() else [])
    _write_sums(path, [*before, new])
    with replacing(path) as part:
        part.write_bytes(content)
    _write_sums(path, [new])


def check_summed(path: Path) -> None:
    """Refuse a file that is not what `write_summed` wrote; one without a checksum passes."""
    accepted = _accepted(path)
    if accepted and path.is_file() and of_file(path) not in accepted:
        raise ConfigError(
            f"{path} is damaged, or was changed by hand: put it back, or change settings with "
            f"--set. The checkpoints beside it are not affected; without {SUMS} the file is taken "
            "as it is."
        )


def _accepted(path: Path) -> list[str]:
    sums = path.parent / SUMS
    if not sums.is_file():
        return []
    lines = (
        line.split() for line in sums.read_text(encoding="utf-8", errors="replace").split("\n")
    )
    return [words[0] for words in lines if words[1:] == [path.name]]


def _write_sums(path: Path, sums: list[str]) -> None:
    with replacing(path.parent / SUMS) as part:
        part.write_text("".join(f"{each}  {path.name}\n" for each in dict.fromkeys(sums)))
