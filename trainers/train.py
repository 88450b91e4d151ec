"""Training: a recipe's name in, a run folder out.

An algorithm is a class named in `trainers.ALGORITHMS` with four members:

    Config                    class attribute, the model of its configuration, a `RunConfig`
    columns(config)           names of its metrics, the first of which is the step
    __init__(config, run)     builds everything, seeded by `config.seed`; nothing is written yet
    learn(journal, stopped)   goes on from the checkpoint "last" where the run has one; reports to
                              the journal; asks `stopped()` often, and returns when it is true;
                              leaves the checkpoints "last" and "best" in the run
"""

from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Protocol, cast

import torch

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import ALGORITHMS
from spikedeploy.trainers.config import RunConfig, amended, known, resolve
from spikedeploy.trainers.curve import draw_curve
from spikedeploy.trainers.interrupt import Interrupt
from spikedeploy.trainers.journal import Journal
from spikedeploy.trainers.progress import ProgressBar
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import RunFolder


class Algorithm(Protocol):
    """A way of training; see this module's docstring."""

    Config: ClassVar[type[RunConfig]]

    def __init__(self, config: Any, run: RunFolder) -> None: ...  # noqa: ANN401

    @staticmethod
    def columns(config: Any) -> tuple[str, ...]:  # noqa: ANN401
        """Return the names of the metrics, the first of which is the step."""
        ...

    def learn(self, journal: Journal, stopped: Callable[[], bool]) -> None:
        """Train to the end, or until stopped; leave checkpoints in the run."""
        ...


def algorithm(name: str) -> type[Algorithm]:
    """Return an algorithm's class by its key in `ALGORITHMS`."""
    module, attribute = ALGORITHMS[known(name, ALGORITHMS, "algorithm")].split(":")
    return cast(type[Algorithm], getattr(import_module(module), attribute))


def train(
    recipe: str,
    *,
    config_file: str | Path | None = None,
    overrides: Iterable[str] = (),
    seed: int = 0,
    resume: str | Path | None = None,
    runs: str | Path = "runs",
    quiet: bool = False,
) -> Path:
    """Train a recipe, or go on with a run of it ("last" or a folder), and return the run folder.

    A resumed run keeps its own configuration and seed; the file and the overrides change it.
    """
    torch.set_num_threads(1)  # more lose time on matrices this small, and starve other runs
    kind = algorithm(RECIPES[known(recipe, RECIPES, "recipe")].algorithm)
    if resume is None:
        config = resolve(kind.Config, recipe, file=config_file, overrides=overrides, seed=seed)
        run = RunFolder.create(runs, config)
    else:
        run = RunFolder.find(resume, runs, recipe)
        if (recipe_of_run := run.settings()["recipe"]) != recipe:
            raise ConfigError(f"{run.path} is a run of '{recipe_of_run}', not of '{recipe}'")
        config = amended(run.config(kind.Config), file=config_file, overrides=overrides)
        run.write_config(config)
    _learn(kind, config, run, quiet)
    return run.path


def _learn(kind: type[Algorithm], config: RunConfig, run: RunFolder, quiet: bool) -> None:
    """Run the algorithm under a progress bar and a polite Ctrl-C, then draw its curve."""
    learner = kind(config, run)
    with Interrupt() as stopped, ProgressBar(run.path.name, quiet) as bar:
        journal = Journal(run, kind.columns(config), bar)
        try:
            learner.learn(journal, stopped)
        finally:
            journal.close()
    draw_curve(run.metrics, run.path / "curve.png", run.path.name)
