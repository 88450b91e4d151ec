"""Which tests reach which lines of the files under mutation, and how long each test takes."""

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent


def record(items: Sequence[pytest.Item], run: Callable[[pytest.Item], bool], kept: Path,
           files: Sequence[str]) -> None:  # fmt: skip
    """Run tests with their fixtures, and write seconds and lines of each that passes.

    run: runs a test; whether it passed.
    """
    trace, tests = Trace(files), {}
    for item in items:
        start = time.process_time()
        with trace:
            passed = run(item)
        seconds = round(time.process_time() - start, 3)
        if passed:
            tests[item.nodeid] = {"seconds": seconds, "reached": trace.lines()}
    part = kept.with_suffix(".part")
    part.write_text(json.dumps(tests), "utf-8")
    part.replace(kept)


class Trace:
    """While entered, notes the lines of some files that run."""

    def __init__(self, files: Sequence[str]) -> None:
        self._files = {str(ROOT / file): file for file in files}
        self._known: dict[str, str | None] = {}
        self._lines: set[tuple[str, int]] = set()

    def __enter__(self) -> None:
        self._lines.clear()
        sys.settrace(self._called)

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def lines(self) -> dict[str, list[int]]:
        """File -> its lines."""
        found: dict[str, list[int]] = {}
        for file, line in sorted(self._lines):
            found.setdefault(file, []).append(line)
        return found

    def _called(self, frame: FrameType, event: str, _: object) -> Any:  # noqa: ANN401
        name = frame.f_code.co_filename
        if name not in self._known:
            self._known[name] = self._files.get(os.path.realpath(name))
        if (file := self._known[name]) is None:
            return None
        lines = self._lines

        def line(frame: FrameType, event: str, _: object) -> Any:  # noqa: ANN401
            lines.add((file, frame.f_lineno))
            return line

        return line(frame, event, None)
