"""Which tests reach which lines of the files under mutation, and how long each test takes.

A plugin of pytest: it is loaded in a process of its own (`-p benchmarks.mutant_reach`), traces the
lines of the files in $MUTANT_FILES and writes $MUTANT_REACH at the end.
"""

import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent


class Reach:
    """Records, for each test that passes, its seconds and the lines that it reaches."""

    def __init__(self, files: list[str]) -> None:
        self._files = {str(ROOT / file): file for file in files}
        self._known: dict[str, str | None] = {}
        self._lines: set[tuple[str, int]] = set()
        self.tests: dict[str, dict[str, Any]] = {}

    def _trace(self, frame: FrameType, event: str, _: object) -> Any:
        name = frame.f_code.co_filename
        if name not in self._known:
            self._known[name] = self._files.get(os.path.realpath(name))
        if (file := self._known[name]) is None:
            return None
        lines = self._lines

        def local(frame: FrameType, event: str, _: object) -> Any:
            lines.add((file, frame.f_lineno))
            return local

        lines.add((file, frame.f_lineno))
        return local

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Trace a test with its fixtures."""
        self._lines = set()
        start = time.process_time()
        sys.settrace(self._trace)
        yield
        sys.settrace(None)
        reached: dict[str, list[int]] = {}
        for file, line in sorted(self._lines):
            reached.setdefault(file, []).append(line)
        seconds = time.process_time() - start
        self.tests[item.nodeid] = {"seconds": round(seconds, 3), "reached": reached}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note what did not pass, which can kill nothing."""
        if not report.passed:
            self.tests.setdefault(report.nodeid, {})["unfit"] = report.outcome

    def pytest_sessionfinish(self) -> None:
        """Write what was found."""
        Path(os.environ["MUTANT_REACH"]).write_text(json.dumps(self.tests), "utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """Start recording."""
    config.pluginmanager.register(Reach(json.loads(os.environ["MUTANT_FILES"])), "reach")
