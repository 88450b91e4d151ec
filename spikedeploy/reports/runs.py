"""Training runs: their scores, the list of those in a folder, and the page of each."""

import json
import math
import shlex
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.envs import spec
from spikedeploy.outputs import no_link
from spikedeploy.policies import run_record
from spikedeploy.reports.page import render
from spikedeploy.reports.plots import curves_figure, step_unit, svg
from spikedeploy.reports.table import ABSENT, HeadlineNumber, Table
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.files import is_locked, write_text
from spikedeploy.trainers.metrics_file import read_metrics, spike_rate
from spikedeploy.trainers.run_folder import RunFolder, is_run, runs_in

PAGE = "report.html"
ALT = "Return, success, spike rate and operations over the training"
_DEEP = 2  # folders in folders: experiments have their runs there
_UNITS = ((86_400.0, "d"), (3_600.0, "h"), (60.0, "min"))  # [s]
_RELOAD = 20  # [s] between two pages of a run that is trained
_SHARE = 0.02  # of the time that pages may take


@dataclass(frozen=True)
class RunScores:
    """Scores of a run, known without playing it.

    path: path of its folder
    recipe: its name
    env: id of its environment
    seed: seed of the training
    kind: kind of its policy, such as "popsan"
    earned: mean return of the best validation
    success: part of the validation's episodes that finish, where the environment says so
    operations: operations of a control step in the validation, where training counts them
    rate: spikes for each neuron and timestep, mean of the layers, of a network that has them
    steps: steps of the training so far, and their unit
    share: share of the training that is done, from 0 to 1
    running: whether a process trains in it
    changed: [s] since 1970, when it was last written
    """

    path: Path
    recipe: str
    env: str
    seed: int
    kind: str
    earned: float | None
    success: float | None
    operations: float | None
    rate: float | None
    steps: tuple[int, str]
    share: float
    running: bool
    changed: float

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.path.resolve().name

    @property
    def spikes(self) -> bool:
        """True of a spiking policy, which chips run."""
        return self.kind in run_record.SPIKING

    @property
    def counts(self) -> str:
        """The unit of its operations: SOPs, or MACs."""
        return "SOPs" if self.spikes else "MACs"

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        return {**vars(self), "path": str(self.path), "name": self.name, "steps": self.steps[0]}


def scores(run: Path) -> RunScores:
    """The scores of a run folder; of one without a checkpoint those of its metrics."""
    settings, rows = run_record.settings(run), metrics_of(run)
    best = _best_validation(run, rows)
    last = run_record.checkpoint_record(run, "last")
    with run_record.checked_record(run / "config.json"):
        recipe, seed, kind = settings["recipe"], int(settings["seed"]), settings["policy"]["kind"]
    with run_record.checked_record(run / "checkpoints"):
        share = float(last.get("share", 1.0 if last else 0.0))
        earned, success, operations = (
            None if best.get(name) is None else float(best[name])
            for name in ("eval_return", "eval_finish", "eval_operations")
        )
        rate = spike_rate(best)
    written = [run / "config.json", run / "metrics.csv", *run.glob("checkpoints/*.json")]
    return RunScores(
        path=run,
        recipe=str(recipe),
        env=run_record.env_of(run) or "",
        seed=seed,
        kind=str(kind),
        earned=earned,
        success=success,
        operations=operations,
        rate=rate,
        steps=(int(next(iter(rows[-1].values()))) if rows else 0, step_unit(rows)),
        share=share,
        running=is_locked(run / ".lock"),
        changed=max(path.stat().st_mtime for path in written if path.exists()),
    )


def metrics_of(run: Path) -> list[dict[str, float]]:
    """The rows of the metrics of a run; none where it has not begun."""
    metrics = run / "metrics.csv"
    return read_metrics(metrics) if metrics.is_file() else []


def _best_validation(run: Path, rows: Sequence[Mapping[str, float]]) -> Mapping[str, Any]:
    """The validation of the checkpoint that is deployed; without one the best of the metrics."""
    record = run_record.checkpoint_record(run, RunFolder(run).deployed())
    if record.get("eval_return") is not None:
        return record
    validated = [row for row in rows if "eval_return" in row]
    return max(validated, key=lambda row: row["eval_return"], default={})


# the runs of a folder


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


def find_runs(
    folder: Path, env: str | None = None, sort: str = "age"
) -> tuple[list[RunScores], list[str]]:
    """The runs in a folder and below, and why others cannot be read.

    env: environment of the runs; None for all
    sort: key of SORTS; returns are sorted within each environment, as they compare nowhere else
    """
    found, damaged = [], []
    wanted = None if env is None else spec(env).id
    for run in _runs_below(folder, _DEEP):
        try:
            each = scores(run)
        except ConfigError as error:
            damaged.append(str(error))
            continue
        if wanted in (None, each.env):
            found.append(each)
    return sorted(found, key=SORTS[sort]), damaged


def _runs_below(folder: Path, deep: int) -> Iterator[Path]:
    yield from runs_in(folder)
    if deep and folder.is_dir():
        for each in sorted(folder.iterdir()):
            if each.is_dir() and not each.is_symlink() and not is_run(each):
                yield from _runs_below(each, deep - 1)


def run_table(runs: Sequence[RunScores], folder: Path) -> Table:
    """A row for each run in a folder."""
    heads = ("run", "return", "success", "operations", "done", "age")
    rows = [
        (
            str(run.path.relative_to(folder)),
            ABSENT if run.earned is None else f"{run.earned:,.4g}",
            ABSENT if run.success is None else f"{run.success:.0%}",
            ABSENT if run.operations is None else f"{run.operations:,.0f} {run.counts}",
            f"{run.share:.0%}{', at work' if run.running else ''}",
            _age(time.time() - run.changed),
        )
        for run in runs
    ]
    return Table(heads, rows, f"Runs in {folder}", numbers=True)


def _age(seconds: float) -> str:
    """`3 h`, `12 min`, `40 s`."""
    for size, unit in _UNITS:
        if seconds >= size:
            return f"{seconds / size:.0f} {unit}"
    return f"{max(seconds, 0):.0f} s"


# the page of a run


class LivePage:
    """Writes the page of a run while it is trained: rarely enough to cost nothing."""

    def __init__(self) -> None:
        self._due = 0.0

    def __call__(self, run: Path) -> None:
        """Write the page if it is due; an error does not end the training."""
        began = time.monotonic()
        if began < self._due:
            return
        with suppress(OSError, SpikedeployError):
            write_run_page(run, live=True)
        took = time.monotonic() - began
        self._due = began + max(_RELOAD, took / _SHARE)


def write_run_page(run: Path, live: bool = False) -> Path:
    """Write report.html into a run folder.

    live: whether this process trains in it
    """
    return write_text(no_link(run / PAGE), run_page(scores(run), live))


def run_page(found: RunScores, live: bool = False) -> str:
    """The page of a run as one file."""
    live = live or found.running
    figure = curves_figure(metrics_of(found.path))
    settings = dict(flatten(run_record.settings(found.path)))
    versions = run_record.versions(found.path)
    return render(
        "training",
        title=found.name,
        lead=f"{found.recipe} in {found.env}, training seed {found.seed}: {_state(found, live)}",
        reload=_RELOAD if live else 0,
        numbers=list(_numbers(found, settings)),
        curves=svg(figure, ALT) if figure else "",
        commands=list(_next_commands(found, live)),
        settings=settings.items(),
        versions=[(name, str(number or ABSENT)) for name, number in versions.items()],
    )


def _state(found: RunScores, live: bool) -> str:
    if live:
        return f"at work, {found.share:.0%} at the last checkpoint. This page reloads itself."
    return f"stopped at {found.share:.0%}." if found.share < 1 else "trained to its end."


def _numbers(found: RunScores, settings: Mapping[str, str]) -> Iterator[HeadlineNumber]:
    if found.earned is not None:
        episodes = settings.get("validation.episodes", "some")
        beside = f"mean of {episodes} greedy episodes, which chose the checkpoint"
        yield HeadlineNumber("best validation return", f"{found.earned:,.4g}", (beside,))
    if found.success is not None:
        yield HeadlineNumber("success", f"{found.success:.0%}", ("of these episodes",))
    if found.operations is not None:
        number = f"{found.operations:,.4g} {found.counts}"
        yield HeadlineNumber("operations of a control step", number, ("in the same validation",))
    if found.rate is not None:
        beside = "of neurons in each timestep, on average"
        yield HeadlineNumber("spike rate", f"{found.rate:.1%}", (beside,))
    steps, unit = found.steps
    yield HeadlineNumber("training", f"{found.share:.0%}", (f"{steps:,} {unit}",))


def _next_commands(found: RunScores, live: bool) -> Iterator[tuple[str, str]]:
    """Suggest the next steps, each with its command."""
    run = shlex.quote(str(found.path))
    if found.share < 1 and not live:
        yield "go on with the training", f"spikedeploy train --resume {run}"
    yield "compare it on fresh seeds", f"spikedeploy compare {shlex.quote(found.env)} {run}"
    yield "replay an episode", f"spikedeploy run {run} -o reports/{shlex.quote(found.name)}"
    yield "write its file", f"spikedeploy export {run}"


def flatten(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Settings with their groups in their names, as --set takes them."""
    for key, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value if isinstance(value, str) else json.dumps(value)
