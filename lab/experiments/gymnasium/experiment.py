"""The gymnasium experiment: runs the missing parts in order, writes its page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lab.experiments.gymnasium import page
from lab.experiments.gymnasium.design import GymnasiumDesign
from lab.experiments.gymnasium.evaluation import missing
from lab.experiments.gymnasium.training import TaskTraining
from lab.experiments.pareto.training import check
from lab.experiments.parts import parts_to_do, run_parts
from spikedeploy.jobs.resumable import Job, Outcome
from spikedeploy.outputs import check_folder

_EVALUATION = "lab.experiments.gymnasium.evaluation"


@dataclass(frozen=True)
class _TaskPart:
    """A training, or its evaluation.

    job  what does it
    """

    job: Job
    training: TaskTraining
    evaluates: bool
    design: GymnasiumDesign

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""
        if self.evaluates:
            return not missing(self.design, self.training)
        return self.training.trained


def experiment(
    design: GymnasiumDesign,
    only: Sequence[str],
    count: int | None,
    results: Path,
    train: bool = True,
) -> Outcome:
    """Run the missing parts of the experiment.

    only     prefixes of the names of parts; empty for all
    count    processes in parallel; None for one
    results  folder of gymnasium.md
    train    False only writes the page
    """
    check_folder("--runs", Path(design.runs))
    check_folder("--output", results)
    for training in design.trainings():
        check(training)
    parts = _parts(design)
    to_do = parts_to_do(parts, only, train)
    _check_what_comes_before(to_do)
    trainings = {part.job.name: part.training for part in parts if not part.evaluates}
    return run_parts(
        parts,
        to_do,
        count,
        lambda: page.write(design, results),
        lambda job: _progress(job, trainings.get(job.name)),
    )


def _progress(job: Job, training: TaskTraining | None) -> str:
    return job.name if training is None else f"{job.name}: {training.share:.0%}"


def _check_what_comes_before(parts: Sequence[_TaskPart]) -> None:
    """Refuse parts that need a training which is neither complete nor among them."""
    names = {part.job.name for part in parts}
    for part in parts:
        if not part.evaluates and not names.issuperset(part.job.after):
            lacking = {
                key: source
                for key, source in part.training.sources.items()
                if source.name not in names
            }
            TaskTraining(**{**vars(part.training), "sources": lacking}).beginning()


def _parts(design: GymnasiumDesign) -> list[_TaskPart]:
    """All parts: each training, and its evaluation after it."""
    return [
        part
        for training in design.trainings()
        for part in (_part(design, training, False), _part(design, training, True))
    ]


def _part(design: GymnasiumDesign, training: TaskTraining, evaluates: bool) -> _TaskPart:
    name = f"{training.name}: evaluation" if evaluates else training.name
    before = [training] if evaluates else training.sources.values()
    call = f"{_EVALUATION}:{'perform' if evaluates else 'train'}"
    log = Path(design.runs) / "logs" / f"{name.replace(': ', '-')}.log"
    arguments = {"design": design.arguments(), "name": training.name}
    job = Job(name, call, log, arguments, [each.name for each in before])
    return _TaskPart(job, training, evaluates, design)
