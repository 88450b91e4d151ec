"""The kart experiment, run: what is missing is done, and its page written after every part."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spikedeploy.experiments import workers
from spikedeploy.experiments.evaluation import Drive
from spikedeploy.experiments.kart_design import ExperimentDesign
from spikedeploy.experiments.kart_page import write
from spikedeploy.experiments.progress import ProgressBoard
from spikedeploy.experiments.trial import Trial
from spikedeploy.experiments.workers import Ended, Job
from spikedeploy.runtime.errors import ConfigError


@dataclass(frozen=True)
class TrialOutcome:
    """How far an experiment came.

    done, of     parts of it that are complete, and all of them
    failed       name -> the last words of parts that failed
    interrupted  whether it was stopped from outside
    files        page, tables and pictures that were written
    """

    done: int
    of: int
    failed: dict[str, str]
    interrupted: bool
    files: list[Path]


def experiment(
    design: ExperimentDesign, only: Sequence[str], count: int, results: Path, train: bool = True
) -> TrialOutcome:
    """Do what is missing of the experiment.

    only     names, or beginnings of names, of the parts to do; none stands for all
    count    processes side by side
    results  folder of kart.md and kart/
    train    False writes the page of what there is
    """
    for trial in design.trials():
        _check(trial)
    jobs = [_job(part, design) for part in _chosen(design, only) if not part.done] if train else []
    failed: dict[str, str] = {}
    with ProgressBoard(design.folder, len(jobs)) as board:

        def ended(end: Ended) -> None:
            board.ended(end)
            if end.failed:
                failed[end.job.name] = end.last_words
            write(design, results)

        whole = workers.run(jobs, count, ended, board.look)
    files = write(design, results)
    done = [part.done for part in design.parts]
    return TrialOutcome(sum(done), len(done), failed, not whole, files)


def _check(trial: Trial) -> None:
    """Refuse settings that it does not have, before the first of all trainings has begun."""
    try:
        trial.config  # noqa: B018 - reading it is what may fail
    except ConfigError as error:
        raise ConfigError(f"{trial.name}: {error}") from error


def _chosen(design: ExperimentDesign, only: Sequence[str]) -> list[Drive | Trial]:
    """The parts whose names begin so."""
    for beginning in only:
        if not any(part.name.startswith(beginning) for part in design.parts):
            known = dict.fromkeys(
                part.name.rpartition("-s")[0] or part.name for part in design.trials()
            )
            raise ConfigError(
                f"no part of the experiment begins with {beginning!r}; known: {', '.join(known)}"
            )
    return [p for p in design.parts if not only or p.name.startswith(tuple(only))]


def _job(part: Drive | Trial, design: ExperimentDesign) -> Job:
    log = Path(design.folder) / "logs" / f"{part.name}.log"
    return Job(part.name, f"{type(part).__module__}:perform", log, part.arguments())
