"""The training runs of a folder, sorted, as a table."""

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from spikedeploy.envs import spec
from spikedeploy.reports.cells import ABSENT
from spikedeploy.reports.run_scores import RunScores, scores
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.run_folder import is_run, runs_in

HEADS = ("run", "return", "success", "operations", "done", "age")
_DEEP = 2  # folders in folders: experiments have their runs there
_UNITS = ((86_400.0, "d"), (3_600.0, "h"), (60.0, "min"))  # [s]


def _known(value: float | None) -> float:
    return -math.inf if value is None else value


# column -> what is sorted by, the least first
SORTS: dict[str, Callable[[RunScores], tuple[float | str, ...]]] = {
    "return": lambda run: (run.env, -_known(run.earned)),
    "success": lambda run: (-_known(run.success), -_known(run.earned)),
    "operations": lambda run: (math.inf if run.operations is None else run.operations,),
    "share": lambda run: (-run.share,),
    "age": lambda run: (-run.changed,),
    "name": lambda run: (run.name,),
}


def found_runs(
    folder: Path, env: str | None = None, sort: str = "age"
) -> tuple[list[RunScores], list[str]]:
    """The runs in a folder and below, and why others cannot be read.

    env   of the runs; None for all
    sort  key of SORTS; returns are sorted within each environment, as they compare nowhere else
    """
    rows, damaged = [], []
    wanted = None if env is None else spec(env).id
    for run in _below(folder, _DEEP):
        try:
            found = scores(run)
        except ConfigError as error:
            damaged.append(str(error))
            continue
        if wanted in (None, found.env):
            rows.append(found)
    return sorted(rows, key=SORTS[sort]), damaged


def _below(folder: Path, deep: int) -> Iterator[Path]:
    """The runs in a folder, then those of its folders."""
    yield from runs_in(folder)
    if deep and folder.is_dir():
        for each in sorted(folder.iterdir()):
            if each.is_dir() and not each.is_symlink() and not is_run(each):
                yield from _below(each, deep - 1)


def cells(run: RunScores, folder: Path) -> tuple[str, ...]:
    """A row of HEADS."""
    return (
        str(run.path.relative_to(folder)),
        ABSENT if run.earned is None else f"{run.earned:,.4g}",
        ABSENT if run.success is None else f"{run.success:.0%}",
        ABSENT if run.operations is None else f"{run.operations:,.0f} {run.counts}",
        f"{run.share:.0%}{', at work' if run.running else ''}",
        _age(time.time() - run.changed),
    )


def _age(seconds: float) -> str:
    """`3 h`, `12 min`, `40 s`."""
    for size, unit in _UNITS:
        if seconds >= size:
            return f"{seconds / size:.0f} {unit}"
    return f"{max(seconds, 0):.0f} s"
