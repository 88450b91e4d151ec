"""A sweep: missing jobs are run, every result is kept at once, and pages are written as it goes.

<folder>/
    jobs/<key>.json  a job's specification and its row, or why it failed, with a checksum
    journal.csv      a line for each job that ended: when, how, for how long, where
    sweep.md, sweep.html, sweep.csv
"""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from spikedeploy import envs
from spikedeploy.campaign.sweep_grid import JobSpecification, SweepGrid, expand, versions_for
from spikedeploy.campaign.sweep_page import Sweep, write_sweep
from spikedeploy.comparison.comparison import Comparison, Row
from spikedeploy.comparison.episodes import EpisodeJob, period_of, play
from spikedeploy.comparison.lineup import Entry
from spikedeploy.console import progress, say
from spikedeploy.jobs.pool import JobBackend, JobResult, sigterm_as_interrupt
from spikedeploy.outputs import check_folder, has_text, mark
from spikedeploy.policies.registry import Candidate, find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text, locked, write_json
from spikedeploy.setup import Setup
from spikedeploy.user_errors import one_line

_EVERY = 30.0  # [s] between two pages while jobs run,
_SHARE = 20  # and at least so many times what writing one takes
_HEAD = "ended,key,status,seconds,worker\n"


def run_sweep(grid: SweepGrid, folder: Path, backend: JobBackend, retry: bool = False) -> Sweep:
    """Run what is missing of a sweep.

    folder   in which results are kept
    backend  that runs the jobs
    retry    whether those that failed are run again
    """
    plan, store = expand(grid), SweepFolder(folder)
    with store.locked():
        sweep = _stored(grid, plan.jobs, store)
        done = {*sweep.rows} if retry else {*sweep.rows, *sweep.failed}
        missing = [job for job in plan.jobs if job.key not in done]
        say(f"{len(missing)} of {len(plan.jobs)} jobs to do, in {folder}")
        jobs = [SweepJob(job, plan.policies.get(job.sha256)) for job in missing]
        try:
            _run(jobs, sweep, store, backend)
        except KeyboardInterrupt:
            sweep.interrupted = True
        finally:
            sweep.files = write_sweep(sweep, folder)
    return sweep


def load_sweep(grid: SweepGrid, folder: Path) -> Sweep:
    """The state of a sweep, finished or running, with its pages written anew."""
    sweep = _stored(grid, expand(grid).jobs, SweepFolder(folder))
    sweep.files = write_sweep(sweep, folder)
    return sweep


def _stored(grid: SweepGrid, jobs: Sequence[JobSpecification], store: "SweepFolder") -> Sweep:
    sweep = Sweep(grid, jobs)
    for job in jobs:
        if (stored := store.read(job)) is not None:
            sweep.add(job, *stored)
    for file in store.damaged:
        say(f"{file} is damaged: its job has to be run again")
    return sweep


def _run(jobs: "Sequence[SweepJob]", sweep: Sweep, store: "SweepFolder", on: JobBackend) -> None:
    """Run the jobs, store each result, and from time to time write the pages."""
    due = time.monotonic() + _EVERY
    with sigterm_as_interrupt(), on, progress(sweep.grid.name, len(jobs)) as done:
        for result in on.run(evaluate_job, jobs):
            job = jobs[result.index].of
            sweep.add(job, *store.write(job, result))
            sweep.ran += 1
            done()
            if (began := time.monotonic()) > due:
                write_sweep(sweep, store.path)
                ended = time.monotonic()
                due = ended + max(_EVERY, _SHARE * (ended - began))


@dataclass(frozen=True)
class SweepJob:
    """A job as it travels to a worker.

    of      its specification
    policy  bytes of the file; None for a built-in
    """

    of: JobSpecification
    policy: bytes | None


def evaluate_job(job: SweepJob) -> dict[str, Any]:
    """The row of a report, as `run` gives it, and the control steps of each episode."""
    of = job.of
    _check_versions(of)
    entry = Entry(_candidate(of, job.policy), of.place, setup=_setup(of))
    seeds = range(of.seed, of.seed + of.episodes)
    episodes = [play(EpisodeJob(of.env, entry, seed)) for seed in seeds]
    spec, period = envs.spec(of.env), period_of(of.env, entry.setup)
    found = Comparison(spec.id, seeds, [Row(entry, episodes)], spec.foreign, period).as_json()[0]
    return {**found, "file": of.policy, "steps": [episode.steps for episode in episodes]}


def _check_versions(of: JobSpecification) -> None:
    here: Mapping[str, str | None] = versions_for(of.env)
    for package, version in of.versions.items():
        if here.get(package) != version:
            raise ConfigError(
                f"this worker has {package} {here.get(package)}, the sweep was begun with "
                f"{version}: install the same on all machines"
            )


def _candidate(of: JobSpecification, policy: bytes | None) -> Candidate:
    return replace(find(of.format if policy is None else str(_file(of, policy))), name=of.policy)


def _setup(of: JobSpecification) -> Setup:
    options = {**of.options, **({"disturb": of.disturb} if of.disturb else {})}
    on_chip = {"quantise" if n == "granularity" else n: v for n, v in of.quantisation.items()}
    return Setup.with_options(
        options,
        metric=of.metrics,
        limits="on" if of.limits else "off",
        fault=of.fault,
        specimen=of.specimen,
        **on_chip,
    )


def _file(of: JobSpecification, policy: bytes) -> Path:
    """The policy's file on this machine, written where it is not there yet."""
    if (found := hashlib.sha256(policy).hexdigest()) != of.sha256:
        raise ConfigError(f"{of.policy}: its bytes arrived damaged, with SHA-256 {found}")
    file = Path(_temporary_folder().name) / f"{of.sha256}{of.format}"
    if not file.is_file():
        file.write_bytes(policy)
    return file


@cache
def _temporary_folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="spikedeploy-")


class SweepFolder:
    """The results of a sweep on disk.

    path     the folder
    damaged  files that are not what was written, whose jobs are run again
    """

    def __init__(self, path: Path) -> None:
        self.path, self.damaged = path, list[Path]()

    def locked(self) -> AbstractContextManager[None]:
        """Keep other processes out."""
        check_folder("-o", self.path)
        busy = f"another sweep is running in {self.path}: wait for it, or look at it with --no-run"
        return locked(self.path / ".lock", busy)

    def read(self, job: JobSpecification) -> tuple[dict[str, Any] | None, str] | None:
        """The row of a job and why it failed; None where it was not run, or the file is damaged."""
        file = self._file(job)
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            claimed = content.pop("sha256")
            if claimed == _checksum(content) and content["job"] == job.record:
                return content["row"], content["failed"]
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            pass
        self.damaged.append(file)
        return None

    def write(self, job: JobSpecification, result: JobResult) -> tuple[dict[str, Any] | None, str]:
        """Store a result, then note it in the journal; return what `read` will."""
        failed = "" if result.error is None else _sentence(result.error)
        content = {"job": job.record, "row": result.value, "failed": failed}
        content = json.loads(as_text(content))  # as it will be read: NaN is null
        write_json(self._file(job), {**content, "sha256": _checksum(content)})
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        status = "failed" if failed else "done"
        with (self.path / "journal.csv").open("a", encoding="utf-8") as file:
            line = f"{now},{job.key},{status},{result.seconds:.4f},{result.worker}\n"
            file.write(line if file.tell() else _HEAD + line)
        return content["row"], failed

    def _file(self, job: JobSpecification) -> Path:
        return self.path / "jobs" / f"{job.key}.json"


def is_sweep(folder: Path) -> bool:
    """True where a sweep has results in the folder, or a page without any yet."""
    journal = folder / "journal.csv"
    if journal.is_file():
        with journal.open("rb") as file:
            return file.read(len(_HEAD)) == _HEAD.encode()
    return not journal.exists() and has_text(folder / "sweep.md", f"<!-- {mark('sweep')} -->")


def _checksum(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _sentence(error: Exception) -> str:
    """The reason why a job failed, in one line; of a bug its kind too."""
    return one_line(error) or " ".join(f"{type(error).__name__}: {error}".split())
