"""The robustness experiment: evaluates what is missing, part by part, and writes its page."""

from collections.abc import Sequence
from pathlib import Path

from lab.experiments.parts import Report, run_missing
from lab.experiments.robustness import page
from lab.experiments.robustness.design import RobustnessDesign
from lab.experiments.robustness.evaluation import missing
from spikedeploy.jobs.resumable import Job, Outcome, chosen

_QUICK_PARTS = 8  # of a job
_PERFORM = "lab.experiments.robustness.evaluation:perform"


def experiment(
    design: RobustnessDesign,
    only: Sequence[str],
    count: int | None,
    results: Path,
    train: bool = True,
) -> Outcome:
    """Run the missing parts of the experiment: one a disturbance or fault, and the undisturbed.

    only     prefixes of the names of parts; empty for all
    count    processes in parallel; None for one
    results  folder of robustness.md and robustness/
    train    False only writes the page
    """
    left = [part for part in chosen(design.parts, only) if missing(design, part)] if train else []
    report = Report(
        len(left),
        len(design.parts),
        lambda: [not missing(design, part) for part in design.parts],
        lambda: page.write(design, results),
        often=False,
    )
    return run_missing(_jobs(design, left), count or 1, report)


def _jobs(design: RobustnessDesign, parts: Sequence[str]) -> list[Job]:
    """A job a part; of a quick look, whose parts are shorter than a start, one for many."""
    size = _QUICK_PARTS if design.quick else 1
    bundles = [parts[at : at + size] for at in range(0, len(parts), size)]
    return [_job(design, bundle) for bundle in bundles]


def _job(design: RobustnessDesign, parts: Sequence[str]) -> Job:
    name = parts[0] if len(parts) == 1 else f"{parts[0]} to {parts[-1]}"
    log = Path(design.runs) / "logs" / f"{name.replace(' ', '-')}.log"
    return Job(name, _PERFORM, log, {"design": design.arguments(), "parts": list(parts)})
