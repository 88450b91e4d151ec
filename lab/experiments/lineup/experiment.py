"""The lineup experiment: runs the missing parts in order, writes its page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lab.experiments.lineup import page, records
from lab.experiments.lineup.design import LineupDesign, Member
from lab.experiments.lineup.evaluation import result
from lab.experiments.pareto.training import check
from lab.experiments.parts import parts_to_do, run_parts
from spikedeploy.jobs.resumable import Job, Outcome
from spikedeploy.outputs import check_folder

_PERFORM = "lab.experiments.lineup.evaluation:perform"


@dataclass(frozen=True)
class _MemberPart:
    """A training and its evaluation, or that of a shipped policy."""

    design: LineupDesign
    member: Member

    @property
    def job(self) -> Job:
        """What does it."""
        name = self.member.name
        log = Path(self.design.runs) / "logs" / f"{name}.log"
        return Job(name, _PERFORM, log, {"design": self.design.arguments(), "name": name})

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""
        return result(self.design, self.member) is not None


def experiment(
    design: LineupDesign,
    only: Sequence[str],
    count: int | None,
    results: Path,
    train: bool = True,
) -> Outcome:
    """Run the missing parts of the experiment.

    only     prefixes of the names of parts; empty for all
    count    processes in parallel; None for one
    results  folder of lineup.md
    train    False only writes the page
    """
    check_folder("--runs", Path(design.runs))
    check_folder("--output", results)
    records.kept(design, results / page.TABLE)
    members = design.members()
    for member in members:
        if member.training is not None:
            check(member.training)
    parts = [_MemberPart(design, member) for member in members]
    to_do = parts_to_do(parts, only, train)
    trainings = {member.name: member.training for member in members}

    def progress(job: Job) -> str:
        training = trainings[job.name]
        return job.name if training is None else f"{job.name}: {training.share:.0%}"

    return run_parts(parts, to_do, count, lambda: page.write(design, results), progress)
