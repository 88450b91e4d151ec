"""Recorded traces against the emulator; a file that cannot be replayed is reported as such."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.runtime.traces.fields import escaped, shown_names
from spikedeploy.runtime.traces.verify import Verdict
from spikedeploy.runtime.traces.verify import verify as verdict_of
from spikedeploy.user_errors import one_line


@dataclass(frozen=True)
class ReplayedTrace:
    """The result of replaying a trace file.

    verdict  None where it could not be replayed
    error    why not; without the path where that comes first
    """

    path: Path
    verdict: Verdict | None
    error: str = ""

    @property
    def equal(self) -> bool:
        """True if it was replayed and every number equals the recorded one."""
        return self.verdict is not None and self.verdict.equal

    def as_json(self) -> dict[str, Any]:
        """The verdict, or why there is none."""
        if self.verdict is None:
            return {"file": str(self.path), "equal": False, "error": self.error}
        return {"file": str(self.path), **self.verdict.as_json(), "error": None}

    def describe(self) -> str:
        """The result in one line."""
        if self.verdict is None:
            return f"not replayed: {self.error}"
        found = self.verdict
        what = f"{found.compared:,} numbers of {found.steps} timesteps"
        if found.difference is not None:
            return f"differs on {found.chip}: {found.difference.describe()}"
        return f"equal on {found.chip}: {what}; recorded by {escaped(found.source, 200)}"

    def remarks(self) -> list[str]:
        """Remarks: what was not compared, and why; how it was replayed where that is not plain."""
        if self.verdict is None:
            return []
        found, remarks = self.verdict, []
        if found.passed_over:
            remarks.append(f"not compared: {found.passed_over} {found.why}")
        if found.unread:
            remarks.append(f"not compared: fields that are not used: {shown_names(found.unread)}")
        return [*remarks, *found.remarks]


def replay_trace(path: Path) -> ReplayedTrace:
    """Replay one file."""
    try:
        return ReplayedTrace(path, verdict_of(path))
    except Exception as error:
        line = one_line(error)
        if line is None:
            raise
        return ReplayedTrace(path, None, line.removeprefix(f"{path}: "))
