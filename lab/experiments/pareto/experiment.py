"""The pareto experiment: runs the missing parts in order of importance, writes its page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from lab.experiments.pareto import page
from lab.experiments.pareto.design import ParetoDesign
from lab.experiments.pareto.evaluation import reference_rows, rows
from lab.experiments.pareto.training import Training, check
from lab.experiments.pareto.tuning import RewardTraining
from lab.experiments.parts import parts_to_do, run_parts
from spikedeploy.jobs.resumable import Job, Outcome
from spikedeploy.outputs import check_folder
from spikedeploy.runtime.errors import ConfigError

_EVALUATION = "lab.experiments.pareto.evaluation"
_TRAINING = "lab.experiments.pareto.training"
_TUNING = "lab.experiments.pareto.tuning"


@dataclass(frozen=True)
class _Part:
    """A part of the experiment.

    job    what does it
    last   whether it evaluates the last level only
    """

    job: Job
    training: Training | RewardTraining | None
    evaluates: bool
    last: bool
    design: ParetoDesign

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""
        if self.training is None:
            return all(row.found is not None for row in reference_rows(self.design))
        if not self.training.trained or not self.evaluates:
            return self.training.trained
        asked = rows(self.design, self.training, self.last, self.design.levels)
        return all(row.found is not None for row in asked)


def experiment(
    design: ParetoDesign,
    only: Sequence[str],
    count: int | None,
    results: Path,
    train: bool = True,
) -> Outcome:
    """Run the missing parts of the experiment.

    only     prefixes of the names of parts; empty for all
    count    processes in parallel; None for one
    results  folder of pareto.md and pareto/
    train    False only writes the page
    """
    check_folder("--runs", Path(design.runs))
    check_folder("--output", results)
    for training in design.everything():
        check(training)
    parts = _parts(design)
    to_do = parts_to_do(parts, only, train)
    _check_what_comes_before(to_do)
    trainings = {training.name: training for training in design.everything()}
    return run_parts(
        parts,
        to_do,
        count,
        lambda: page.write(design, results),
        lambda job: _progress(job, trainings.get(job.name)),
    )


def _progress(job: Job, training: Training | RewardTraining | None) -> str:
    """A running job, and how far its training is."""
    if training is None or training.run is None:
        return job.name
    made, total = training.progress
    return f"{job.name}: {max(made, 0):,} of {total:,} {training.unit}"


def _check_what_comes_before(parts: Sequence[_Part]) -> None:
    """Refuse parts that need a training which is neither complete nor among them."""
    names = {part.job.name for part in parts}
    for part in parts:
        if part.training is None or names.issuperset(part.job.after):
            continue
        if not part.evaluates:
            if part.training.run is None:
                part.training.beginning()  # raises where it cannot begin
        elif not part.training.trained:
            raise ConfigError(
                f"{part.job.name} evaluates {part.training.name}, which is not trained yet. Run "
                f"the experiment without --only, or with --only {part.training.name} first."
            )


def _parts(design: ParetoDesign) -> list[_Part]:
    """All parts: each training, and its levels after it; last levels elsewhere come at the end."""
    return [*_every_level(design), *_last_levels(design)]


def _every_level(design: ParetoDesign) -> Iterator[_Part]:
    call = f"{_EVALUATION}:perform_references"
    references = _job(design, " and ".join(design.references), call, {"design": _of(design)})
    yield _Part(references, None, True, False, design)
    for training in design.everything():
        after = (training.donor.name,) if training.donor else ()
        call = f"{_TUNING if isinstance(training, RewardTraining) else _TRAINING}:perform"
        job = _job(design, training.name, call, training.arguments(), after)
        yield _Part(job, training, False, False, design)
        yield _evaluation(design, training, last=False)


def _last_levels(design: ParetoDesign) -> Iterator[_Part]:
    for training in design.trainings():
        yield _evaluation(design, training, last=True)


def _evaluation(design: ParetoDesign, training: Training | RewardTraining, last: bool) -> _Part:
    arguments = {"design": _of(design), "name": training.name, "last": last}
    name = f"{training.name}: {'last level on chips' if last else 'levels'}"
    job = _job(design, name, f"{_EVALUATION}:perform", arguments, (training.name,))
    return _Part(job, training, True, last, design)


def _of(design: ParetoDesign) -> dict[str, object]:
    return design.arguments()


def _job(
    design: ParetoDesign,
    name: str,
    call: str,
    arguments: dict[str, object],
    after: tuple[str, ...] = (),
) -> Job:
    stem = name.replace(": ", "-").replace(" ", "-")
    return Job(name, call, Path(design.runs) / "logs" / f"{stem}.log", arguments, after)
