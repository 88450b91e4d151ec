"""The kart experiment: runs the missing parts, and writes its page after each."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spikedeploy.experiments import workers
from spikedeploy.experiments.evaluation import BuiltInEvaluation
from spikedeploy.experiments.kart_design import ExperimentDesign
from spikedeploy.experiments.kart_page import write
from spikedeploy.experiments.progress import ExperimentProgress
from spikedeploy.experiments.trial import Trial
from spikedeploy.experiments.workers import Job, JobEnd
from spikedeploy.runtime.errors import ConfigError


@dataclass(frozen=True)
class TrialOutcome:
    """The result of running an experiment.

    done, of     number of complete parts, and of all
    failed       part -> last line of its log
    interrupted  whether it was stopped from outside
    files        page, tables and pictures
    """

    done: int
    of: int
    failed: dict[str, str]
    interrupted: bool
    files: list[Path]


def experiment(
    design: ExperimentDesign, only: Sequence[str], count: int, results: Path, train: bool = True
) -> TrialOutcome:
    """Run the missing parts of the experiment.

    only     prefixes of the names of parts; empty for all
    count    processes in parallel
    results  folder of kart.md and kart/
    train    False only writes the page
    """
    for trial in design.trials():
        _check(trial)
    jobs = [_job(part, design) for part in _chosen(design, only) if not part.done] if train else []
    failed: dict[str, str] = {}
    with ExperimentProgress(design.folder, len(jobs)) as progress:

        def ended(end: JobEnd) -> None:
            progress.end(end)
            if end.failed:
                failed[end.job.name] = end.last_line
            write(design, results)

        whole = workers.run(jobs, count, ended, progress.update)
    files = write(design, results)
    done = [part.done for part in design.parts]
    return TrialOutcome(sum(done), len(done), failed, not whole, files)


def _check(trial: Trial) -> None:
    """Refuse unknown settings before the first training starts."""
    try:
        trial.config  # noqa: B018 - reading it is what may fail
    except ConfigError as error:
        raise ConfigError(f"{trial.name}: {error}") from error


def _chosen(design: ExperimentDesign, only: Sequence[str]) -> list[BuiltInEvaluation | Trial]:
    """The parts whose names have one of the prefixes."""
    for beginning in only:
        if not any(part.name.startswith(beginning) for part in design.parts):
            known = dict.fromkeys(
                part.name.rpartition("-s")[0] or part.name for part in design.trials()
            )
            raise ConfigError(
                f"no part of the experiment begins with {beginning!r}; known: {', '.join(known)}"
            )
    return [p for p in design.parts if not only or p.name.startswith(tuple(only))]


def _job(part: BuiltInEvaluation | Trial, design: ExperimentDesign) -> Job:
    log = Path(design.folder) / "logs" / f"{part.name}.log"
    return Job(part.name, f"{type(part).__module__}:perform", log, part.arguments())
