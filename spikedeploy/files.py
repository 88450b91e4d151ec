"""Files written atomically: under a temporary name, then renamed."""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import atomic


def check_folder(option: str, path: Path) -> None:
    """Refuse a folder to write to that is a file, or would be inside one."""
    for part in (path, *path.parents):
        if part.exists():
            if not part.is_dir():
                raise ConfigError(f"{option} {path}: {part} is a file. Name a folder.")
            return


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path, renamed to `path` when the block succeeds; its folder is created."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic.replacing(path) as part:
        yield part


def write_text(path: Path, text: str) -> Path:
    """Write the text; return the path."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")
    return path


def read_json(path: Path, remedy: str = "put it back, or move it away") -> dict[str, Any]:
    """The object in a JSON file that a command wrote; ConfigError where it is damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is damaged ({error}): {remedy}") from error
    if not isinstance(found, dict):
        raise ConfigError(f"{path} is damaged, it holds no JSON object: {remedy}")
    return found


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
