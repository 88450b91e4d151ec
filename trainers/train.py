"""Training: from the name of a recipe to a run folder.

An algorithm is a subclass of `Runner`, named in `trainers.ALGORITHMS`.
"""

import json
import shutil
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any

import torch

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import ALGORITHMS, metrics
from spikedeploy.trainers.atomic import replacing
from spikedeploy.trainers.config import RunConfig
from spikedeploy.trainers.journal import Journal
from spikedeploy.trainers.progress import ProgressBar
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.resolve import amended, known, resolve
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import Runner
from spikedeploy.trainers.sparse.budget import with_budget


def algorithm(name: str) -> Any:  # noqa: ANN401 - a subclass of Runner; what it takes is its Config
    """Return an algorithm's class by its key in `ALGORITHMS`."""
    module, attribute = ALGORITHMS[known(name, ALGORITHMS, "algorithm")].split(":")
    return getattr(import_module(module), attribute)


def train(
    recipe: str | None,
    *,
    env: str | None = None,
    config_file: str | Path | None = None,
    overrides: Iterable[str] = (),
    budget: str | None = None,
    seed: int = 0,
    resume: str | Path | None = None,
    runs: str | Path = "runs",
    quiet: bool = False,
    interrupt: "Interrupt | None" = None,
) -> Path:
    """Train a recipe, or resume a run of it ("last" or a folder), and return the run folder.

    A resumed run keeps its configuration and seed, changed by the file and the overrides. Its
    recipe may be None.

    env: environment of a recipe for any; short name, registered id or module:Class
    budget: operations of a control step, of a sparse recipe: "sops=480", "macs=500"
    interrupt: requests a stop, and says afterwards whether there was one
    """
    stopped = interrupt or Interrupt()
    torch.set_num_threads(1)  # more threads slow down matrices of this size, and other runs
    if resume is not None and recipe is None:
        recipe = str(RunFolder.find(resume, runs).settings()["recipe"])
    if recipe is None:
        raise ConfigError("name a recipe to train, or a run to resume")
    kind = algorithm(RECIPES[known(recipe, RECIPES, "recipe")].algorithm)
    overrides = [*_named(recipe, env), *overrides]
    if resume is None:
        config = resolve(kind.Config, recipe, file=config_file, overrides=overrides, seed=seed)
        config = config if budget is None else with_budget(config, budget)
        _check_env(config)
        config = _by_name(config)
        run = RunFolder.create(runs, config)
        with _removed_if_refused(run):
            _learn(kind(config, run), config, run, quiet, stopped)
    else:
        run = RunFolder.find(resume, runs, recipe)
        if (recipe_of_run := run.settings()["recipe"]) != recipe:
            raise ConfigError(f"{run.path} is a run of '{recipe_of_run}', not of '{recipe}'")
        if env not in (None, there := run.settings()["env"]["name"]):
            raise ConfigError(f"{run.path} was trained in {there}, not in {env}: name the run")
        config = amended(run.config(kind.Config), file=config_file, overrides=overrides)
        config = config if budget is None else with_budget(config, budget)
        _check_metrics(run, kind, config)
        with _written(run, config):
            runner = kind(config, run)
        _learn(runner, config, run, quiet, stopped)
    return run.path


def _named(recipe: str, env: str | None) -> list[str]:
    """Return the override that names the environment of a recipe for any."""
    if env is None:
        return []
    if not RECIPES[recipe].any_env:
        theirs = RECIPES[recipe].settings.get("env", {}).get("name")
        some = ", ".join(name for name, entry in RECIPES.items() if entry.any_env)
        if theirs != env:
            raise ConfigError(
                f"{recipe} is made for {theirs}, not for {env}; recipes for any environment: {some}"
            )
    return [f"env.name={json.dumps(env)}"]


def _check_env(config: RunConfig) -> None:
    """Refuse an environment that is unknown, or was not named."""
    if not config.env.name:
        raise ConfigError(
            f"{config.recipe} trains in any environment: name one, as in "
            f"`spikedeploy train CartPole-v1 --recipe {config.recipe}`"
        )
    envs.spec(config.env.name)


def _by_name(config: RunConfig) -> RunConfig:
    """Return it with the folder of the run that is "last" now: later another one is."""
    runs = [name for name in ("teacher", "start", "pool") if getattr(config, name, "") == "last"]
    return config.model_copy(update={name: str(RunFolder.find("last").path) for name in runs})


@contextmanager
def _removed_if_refused(run: RunFolder) -> Iterator[None]:
    """Remove a new run folder where its training is refused before anything was learned."""
    try:
        yield
    except BaseException:  # Ctrl-C too
        learned = any((run.path / "checkpoints").iterdir())
        if not learned and not (run.metrics.is_file() and metrics.read(run.metrics)):
            shutil.rmtree(run.path)
        raise


@contextmanager
def _written(run: RunFolder, config: RunConfig) -> Iterator[None]:
    """Write the configuration of a run to be resumed; the former one where it is refused."""
    file = run.path / "config.json"
    before = file.read_bytes()
    run.write_config(config)
    try:
        yield
    except Exception:
        with replacing(file) as part:
            part.write_bytes(before)
        raise


def _check_metrics(run: RunFolder, kind: type[Runner[Any]], config: RunConfig) -> None:
    """Refuse a run to be resumed whose metrics are damaged."""
    if run.checkpoint("last").is_file():
        state, _ = run.load("last")
        step = state[kind.COUNTERS[0]]
        metrics.check(run.metrics, kind.columns(config), step, state.get("logged"))


def _learn(
    runner: Runner[Any], config: RunConfig, run: RunFolder, quiet: bool, stopped: "Interrupt"
) -> None:
    """Run the algorithm under a progress bar until it ends or Ctrl-C, then draw its curve."""
    with ProgressBar(run.path.name, quiet) as bar, stopped.acknowledged(bar, quiet):
        journal = Journal(run, runner.columns(config), bar)
        try:
            runner.learn(journal, stopped)
        finally:
            journal.close()
    stopped.share = None if runner.finished else runner.share
    metrics.draw_curve(run.metrics, run.path / "curve.png", run.path.name)


class Interrupt:
    """While entered, Ctrl-C (SIGINT) requests a stop; a second one interrupts at once.

    requested: whether it was pressed
    share: part of the training that is done, where it stopped before its end
    """

    def __init__(self) -> None:
        self.requested = False
        self.share: float | None = None
        self._before: Any = None
        self._say: Callable[[str], None] | None = None

    def __call__(self) -> bool:
        """Return whether a stop was requested."""
        return self.requested

    @contextmanager
    def acknowledged(self, bar: ProgressBar, quiet: bool) -> Iterator[None]:
        """Say beside the bar that it was pressed, at once."""
        self._say = None if quiet else bar.say
        with self:
            yield
        self._say = None

    def __enter__(self) -> "Interrupt":
        if threading.current_thread() is threading.main_thread():  # elsewhere Python forbids it
            self._before = signal.signal(signal.SIGINT, self._request)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        if self._say is not None:
            self._say("stopping after this step … (Ctrl-C again stops at once)")
