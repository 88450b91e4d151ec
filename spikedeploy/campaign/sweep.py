"""A sweep: missing jobs are run, every result is kept at once, and pages are written as it goes.

<folder>/
    results.jsonl  a line for each job that ended: its record and row, or why it failed
    report.html, report.json, sweep.csv
"""

import json
import time
from collections.abc import Iterator, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spikedeploy import envs
from spikedeploy.campaign.sweep_grid import SweepGrid, SweepJob, expand
from spikedeploy.campaign.sweep_page import Sweep, write_sweep
from spikedeploy.comparison.comparison import Comparison, PolicyRow
from spikedeploy.comparison.episodes import EpisodeJob, period_of, play
from spikedeploy.console import progress, say
from spikedeploy.jobs import JobResult, Serial, local_pool, sigterm_as_interrupt
from spikedeploy.outputs import check_folder
from spikedeploy.reports.page import is_page_of
from spikedeploy.runtime.files import as_text, locked
from spikedeploy.user_errors import one_line

RESULTS = "results.jsonl"
_HEAD = b'{"key": "'  # of every line
_EVERY = 30.0  # [s] between two pages while jobs run,
_SHARE = 20  # and at least so many times what writing one takes


def run_sweep(grid: SweepGrid, folder: Path, workers: int | None = 1, retry: bool = False) -> Sweep:
    """Run what is missing of a sweep.

    folder: in which results are kept
    workers: processes; None is one for each core, and 1 this process
    retry: whether those that failed are run again
    """
    check_folder("-o", folder)
    busy = f"another sweep is running in {folder}: wait for it, or look at it with --no-run"
    with locked(folder / ".lock", busy):
        sweep = _stored(grid, folder)
        done = {*sweep.rows} if retry else {*sweep.rows, *sweep.failed}
        missing = [job for job in sweep.jobs if job.key not in done]
        say(f"{len(missing)} of {len(sweep.jobs)} jobs to do, in {folder}")
        try:
            _run(missing, sweep, folder, local_pool(workers))
        except KeyboardInterrupt:
            sweep.interrupted = True
        finally:
            sweep.files = write_sweep(sweep, folder)
    return sweep


def load_sweep(grid: SweepGrid, folder: Path) -> Sweep:
    """Return the state of a sweep, finished or running, with its pages written anew."""
    sweep = _stored(grid, folder)
    sweep.files = write_sweep(sweep, folder)
    return sweep


def _stored(grid: SweepGrid, folder: Path) -> Sweep:
    sweep = Sweep(grid.name, expand(grid))
    wanted = {job.key: job for job in sweep.jobs}
    damaged = 0
    for line in _lines(folder):
        job = wanted.get(str(line.get("key")))
        damaged += not line or (job is not None and line.get("job") != job.record)
        if job is not None and line.get("job") == job.record:
            sweep.add(job, line.get("row"), str(line.get("failed")))
    if damaged:
        say(f"{folder / RESULTS}: {damaged} lines are damaged, and their jobs run again")
    return sweep


def _lines(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the lines of results; {} for one that is damaged, such as by a kill."""
    if not (folder / RESULTS).is_file():
        return
    with (folder / RESULTS).open("rb") as file:
        for line in file:
            try:
                found = json.loads(line)
            except (ValueError, RecursionError):
                found = None
            yield found if isinstance(found, dict) else {}


def _run(jobs: list[SweepJob], sweep: Sweep, folder: Path, pool: Serial) -> None:
    """Run the jobs, store each result, and from time to time write the pages."""
    due = time.monotonic() + _EVERY
    with sigterm_as_interrupt(), pool, progress(sweep.name, len(jobs)) as done:
        for result in pool.run(evaluate_job, jobs):
            sweep.add(jobs[result.index], *_store(folder, jobs[result.index], result))
            sweep.ran += 1
            done()
            if (began := time.monotonic()) > due:
                write_sweep(sweep, folder)
                ended = time.monotonic()
                due = ended + max(_EVERY, _SHARE * (ended - began))


def evaluate_job(job: SweepJob) -> dict[str, Any]:
    """Return the row of a report, as `run` gives it, and the control steps of each episode."""
    seeds = range(job.seed, job.seed + job.episodes)
    episodes = [play(EpisodeJob(job.env, job.entry, seed)) for seed in seeds]
    spec, period = envs.spec(job.env), period_of(job.env, job.entry.setup)
    rows = [PolicyRow(job.entry, episodes)]
    found = Comparison(spec.id, seeds, rows, spec.foreign, period).as_json()[0]
    return {**found, "steps": [episode.steps for episode in episodes]}


def _store(folder: Path, job: SweepJob, result: JobResult) -> tuple[Mapping[str, Any] | None, str]:
    """Append a result to the file; return its row and why it failed, as they will be read."""
    failed = "" if result.error is None else _sentence(result.error)
    line = {
        "key": job.key,
        "job": job.record,
        "row": result.value,
        "failed": failed,
        "seconds": result.seconds,
        "ended": datetime.now(timezone.utc).isoformat(timespec="seconds"),
    }
    line = json.loads(as_text(line))  # NaN is null
    with (folder / RESULTS).open("a+b") as file:
        if file.tell():
            file.seek(-1, 2)
            if file.read(1) != b"\n":  # after a line that a kill cut off
                file.write(b"\n")
        file.write(json.dumps(line).encode() + b"\n")
    return line["row"], failed


def _sentence(error: Exception) -> str:
    """Return the reason why a job failed, in one line; of a bug its kind too."""
    return one_line(error) or " ".join(f"{type(error).__name__}: {error}".split())


def is_sweep(folder: Path) -> bool:
    """Return True where a sweep has results in the folder, or a page without any yet."""
    results = folder / RESULTS
    if results.is_file():
        with results.open("rb") as file:
            return file.read(len(_HEAD)) == _HEAD
    return not results.exists() and is_page_of("sweep")(folder)
