"""One recipe trained with several seeds, side by side, each as a command of its own would."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from spikedeploy.comparison.statistics import Estimate, bootstrap
from spikedeploy.jobs import resumable
from spikedeploy.jobs.resumable import Job, JobEnd
from spikedeploy.policies.run_record import describe_progress
from spikedeploy.runtime.files import read_json, write_text

_PERFORM = "spikedeploy.campaign.training_seeds:perform"


@dataclass(frozen=True)
class SeedTraining:
    """The end of the training with a seed.

    seed      of the training
    run       its folder; None where it was refused or killed
    best      highest validation return; None without a validation
    stopped   how far it came where it was stopped: `12 %`
    failed    why it failed; empty where it did not
    """

    seed: int
    run: str | None = None
    best: float | None = None
    stopped: str = ""
    failed: str = ""

    @property
    def line(self) -> str:
        """`seed 0: best validation return 812.3, runs/…`."""
        best = "no validation" if self.best is None else f"best validation return {self.best:,.4g}"
        stopped = f"stopped at {self.stopped}, " if self.stopped else ""
        end = f"failed: {self.failed}" if self.failed else f"{stopped}{best}, {self.run}"
        return f"seed {self.seed}: {end}"


@dataclass(frozen=True)
class SeedTrainings:
    """The ends of all of them.

    each         in the order of the seeds; those that were not begun are missing
    interrupted  whether they were stopped from outside
    """

    each: Sequence[SeedTraining]
    interrupted: bool

    @property
    def estimate(self) -> Estimate | None:
        """Mean of the best validation returns of whole trainings, with its bootstrap interval."""
        best = self.whole
        return bootstrap(best, np.random.default_rng(0)) if best else None

    @property
    def whole(self) -> list[float]:
        """The best validation returns of whole trainings."""
        return [e.best for e in self.each if e.best is not None and not e.stopped]

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        mean = self.estimate.as_json() if self.estimate else None
        return {"seeds": [asdict(each) for each in self.each], "best": mean}


def train_seeds(
    seeds: Sequence[int],
    count: int,
    logs: Path,
    arguments: Mapping[str, Any],
    ended: Callable[[SeedTraining], None],
) -> SeedTrainings:
    """Train with each of the seeds, `count` at a time; Ctrl-C stops them at checkpoints.

    logs       folder of a log for each
    arguments  of trainers.train.train, JSON types
    ended      is called with each that ends
    """
    found: dict[int, SeedTraining] = {}
    with TemporaryDirectory(prefix="spikedeploy-") as folder:
        jobs = {f"seed-{seed}": seed for seed in seeds}

        def note(end: JobEnd) -> None:
            seed = jobs[end.job.name]
            found[seed] = _ending(seed, end, Path(folder) / str(seed))
            ended(found[seed])

        whole = resumable.run(
            [_job(seed, Path(folder), logs, arguments) for seed in seeds], count, note
        )
    return SeedTrainings([found[seed] for seed in seeds if seed in found], not whole)


def _job(seed: int, folder: Path, logs: Path, arguments: Mapping[str, Any]) -> Job:
    name = f"seed-{seed}"
    given = {"place": str(folder / str(seed)), "seed": seed, **arguments}
    return Job(name, _PERFORM, logs / f"{arguments['recipe']}-s{seed}.log", given)


def perform(place: str, **arguments: Any) -> bool:  # noqa: ANN401
    """Train (a job of `resumable`), and write into the file `place` where; False if interrupted."""
    from spikedeploy.trainers.progress import Interrupt
    from spikedeploy.trainers.train import train

    interrupt = Interrupt()
    run = train(quiet=True, interrupt=interrupt, **arguments)
    write_text(Path(place), str(run))
    return interrupt.share is None


def _ending(seed: int, end: JobEnd, place: Path) -> SeedTraining:
    if end.failed:
        return SeedTraining(seed, failed=f"{end.last_line.removeprefix('error: ')} ({end.job.log})")
    if not place.is_file():
        return SeedTraining(seed, failed="stopped before its first checkpoint")
    run = Path(place.read_text(encoding="utf-8"))
    return SeedTraining(seed, str(run), _best(run), describe_progress(run))


def _best(run: Path) -> float | None:
    file = run / "checkpoints/best.json"
    return read_json(file).get("eval_return") if file.is_file() else None
