"""The folder of a sweep: one file for each job, checked when it is read, and a journal.

<folder>/
    jobs/<key>.json  a job's specification and its row, or why it failed, with a checksum
    journal.csv      a line for each job that ended: when, how, for how long, where
    sweep.md, sweep.csv
"""

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spikedeploy.files import as_text, locked, write_text
from spikedeploy.jobs.answer import JobAnswer
from spikedeploy.outputs import check_folder, mark, marked
from spikedeploy.sweeps.specification import JobSpecification
from spikedeploy.user_errors import one_line

Record = dict[str, Any]
_HEAD = "ended,key,status,seconds,worker\n"


@dataclass(frozen=True)
class StoredJob:
    """What is kept of a job.

    row     of a report; None where it failed
    failed  why, in a sentence; empty where it did not
    """

    row: Record | None
    failed: str = ""


class SweepFolder:
    """The results of a sweep on disk.

    path     the folder
    damaged  files that were not what was written, and are made again
    """

    def __init__(self, path: Path) -> None:
        self.path, self.damaged = path, list[Path]()

    def file(self, job: JobSpecification) -> Path:
        """The file of a job."""
        return self.path / "jobs" / f"{job.key}.json"

    def read(self, job: JobSpecification) -> StoredJob | None:
        """What is kept of a job; None where it was not run, or its file is damaged."""
        file = self.file(job)
        try:
            text = file.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError):
            text = ""
        kept = _checked(text, job)
        if kept is None:
            self.damaged.append(file)
        return kept

    def write(self, job: JobSpecification, answer: JobAnswer) -> StoredJob:
        """Keep the answer to a job, then note it in the journal; what a reader would get."""
        failed = "" if answer.error is None else _sentence(answer.error)
        content = {"job": job.record, "row": answer.value, "failed": failed}
        content = json.loads(as_text(content))  # as it will be read: NaN is null
        write_text(self.file(job), as_text({**content, "sha256": _checksum(content)}))
        self._note(job, answer, "failed" if failed else "done")
        return StoredJob(content["row"], failed)

    def _note(self, job: JobSpecification, answer: JobAnswer, status: str) -> None:
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        line = f"{now},{job.key},{status},{answer.seconds:.4f},{answer.worker}\n"
        with (self.path / "journal.csv").open("a", encoding="utf-8") as file:
            file.write(line if file.tell() else _HEAD + line)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other processes out; the system lets them in when this one ends, however."""
        check_folder("-o", self.path)
        busy = f"another sweep is running in {self.path}: wait for it, or look at it with --no-run"
        with locked(self.path / ".lock", busy):
            yield


def is_sweep(folder: Path) -> bool:
    """Whether a sweep has results in the folder, or a page without any yet."""
    journal = folder / "journal.csv"
    if journal.is_file():
        with journal.open("rb") as file:
            return file.read(len(_HEAD)) == _HEAD.encode()
    return not journal.exists() and marked(folder / "sweep.md", f"<!-- {mark('sweep')} -->")


def _checked(text: str, job: JobSpecification) -> StoredJob | None:
    """The content of a file if it is whole, and of this job."""
    try:
        content = json.loads(text)
        claimed = content.pop("sha256")
        whole = claimed == _checksum(content) and content["job"] == job.record
        return StoredJob(content["row"], content["failed"]) if whole else None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def _checksum(content: Record) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _sentence(error: Exception) -> str:
    """Why a job failed, in one line; of a bug its kind too."""
    return one_line(error) or " ".join(f"{type(error).__name__}: {error}".split())
