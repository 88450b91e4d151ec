"""One recipe trained with several seeds, side by side, each as a command of its own would."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.comparison.statistics import Estimate, bootstrap
from spikedeploy.jobs import Pool, output_to, sigterm_as_interrupt
from spikedeploy.policies.run_record import describe_progress
from spikedeploy.runtime.files import read_json
from spikedeploy.user_errors import one_line


@dataclass(frozen=True)
class SeedTraining:
    """The end of the training with a seed.

    seed: of the training
    run: its folder; None where it failed
    best: highest validation return; None without a validation
    stopped: how far it came where it was stopped: `12 %`
    failed: why it failed; empty where it did not
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


def estimate(trainings: Sequence[SeedTraining]) -> Estimate | None:
    """Mean of the best validation returns of whole trainings, with its bootstrap interval."""
    whole = [each.best for each in trainings if each.best is not None and not each.stopped]
    return bootstrap(whole, np.random.default_rng(0)) if whole else None


def train_seeds(
    seeds: Sequence[int],
    count: int,
    logs: Path,
    arguments: Mapping[str, Any],
    ended: Callable[[SeedTraining], None],
) -> tuple[list[SeedTraining], bool]:
    """Train with each of the seeds, `count` at a time; Ctrl-C stops them at checkpoints.

    Returns the ends of those that were begun, and whether they were stopped from outside.

    logs: folder of a log for each
    arguments: of trainers.train.train
    ended: is called with each that ends
    """
    found: dict[int, SeedTraining] = {}
    job, interrupted = partial(train_seed, logs, arguments), False
    try:
        with sigterm_as_interrupt(), Pool(count) as pool:
            for result in pool.run(job, seeds):
                seed = seeds[result.index]
                found[seed] = result.value or _failed(
                    seed, result.error, _log(logs, arguments, seed)
                )
                ended(found[seed])
    except KeyboardInterrupt:
        interrupted = True
    return [found[seed] for seed in seeds if seed in found], interrupted


def train_seed(logs: Path, arguments: Mapping[str, Any], seed: int) -> SeedTraining:
    """Train with a seed, and write what is said into a log."""
    from spikedeploy.trainers.train import train

    with output_to(_log(logs, arguments, seed)):
        run = train(seed=seed, quiet=True, **arguments)
    file = run / "checkpoints/best.json"
    best = read_json(file).get("eval_return") if file.is_file() else None
    return SeedTraining(seed, str(run), best, describe_progress(run))


def _failed(seed: int, error: Exception | None, log: Path) -> SeedTraining:
    why = "" if error is None else one_line(error) or f"{type(error).__name__}: {error}"
    return SeedTraining(seed, failed=f"{why} ({log})")


def _log(logs: Path, arguments: Mapping[str, Any], seed: int) -> Path:
    return logs / f"{arguments['recipe']}-s{seed}.log"
