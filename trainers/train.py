"""Training: from the name of a recipe to a run folder.

An algorithm is a subclass of `Runner`, named in `trainers.ALGORITHMS`.
"""

import json
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

from spikedeploy.envs.repeats import check_repeats
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import ALGORITHMS
from spikedeploy.trainers.config import C, Ramp, RunConfig, amend, require_known, resolve
from spikedeploy.trainers.metrics_file import Journal, draw_curve
from spikedeploy.trainers.progress import Interrupt, ProgressBar
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import RunFolder, write_errors
from spikedeploy.trainers.runner import Runner


def algorithm(name: str) -> Any:  # noqa: ANN401 - a subclass of Runner; what it takes is its Config
    """Return an algorithm's class by its key in `ALGORITHMS`."""
    module, attribute = ALGORITHMS[require_known(name, ALGORITHMS, "algorithm")].split(":")
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
    interrupt: Interrupt | None = None,
    watch: Callable[[Path], None] | None = None,
) -> Path:
    """Train a recipe, or resume a run of it ("last" or a folder), and return the run folder.

    A resumed run keeps its configuration and seed, changed by the file and the overrides. Its
    recipe may be None.

    env: environment of a recipe for any; short name, registered id or module:Class
    budget: operations of a control step, of a sparse recipe: "sops=480", "macs=500"
    interrupt: requests a stop, and says afterwards whether there was one
    watch: is called with the run folder after each row of metrics
    """
    stopped = interrupt or Interrupt()
    torch.set_num_threads(1)  # more threads slow down matrices of this size, and other runs
    if resume is not None:
        run = RunFolder.find(resume, runs, recipe or "")
        with run.locked():
            runner = _resumed(run, recipe, env, config_file, overrides, budget)
            _learn(runner, run, quiet, stopped, watch)
        return run.path
    if recipe is None:
        raise ConfigError("name a recipe to train, or a run to resume")
    world = f". To train in it: `spikedeploy train {shlex.quote(recipe)} --recipe ppo-snn`"
    remedy = world if ":" in recipe or re.search(r"-v\d+$", recipe) else ""
    kind = algorithm(RECIPES[require_known(recipe, RECIPES, "recipe", remedy)].algorithm)
    config = resolve(
        kind.Config, recipe, seed=seed, file=config_file,
        overrides=[*_env_override(recipe, env), *overrides],
    )  # fmt: skip
    config = _with_paths(_budgeted(config, budget))
    if not config.env.name:
        raise ConfigError(
            f"{recipe} trains in any environment: name one, as in "
            f"`spikedeploy train CartPole-v1 --recipe {recipe}`"
        )
    if remark := check_repeats(config.env.name, config.env.options):  # unknown ones are refused
        print(remark, file=sys.stderr)
    run = RunFolder.create(runs, config)
    with run.locked():
        try:
            runner = kind(config, run)
            _learn(runner, run, quiet, stopped, watch)
        except BaseException:  # Ctrl-C too
            if not run.begun:
                shutil.rmtree(run.path)
            raise
    return run.path


def _resumed(
    run: RunFolder,
    recipe: str | None,
    env: str | None,
    config_file: str | Path | None,
    overrides: Iterable[str],
    budget: str | None,
) -> Runner[Any]:
    """Return the runner of a run at its last checkpoint, its settings changed as asked for."""
    kind = algorithm(str(run.settings().get("algorithm")))
    former = run.config(kind.Config)
    if recipe not in (None, former.recipe):
        raise ConfigError(f"{run.path} is a run of '{former.recipe}', not of '{recipe}'")
    if env not in (None, former.env.name):
        raise ConfigError(
            f"{run.path} was trained in {former.env.name}, not in {env}: name the run"
        )
    config = _budgeted(amend(former, file=config_file, overrides=overrides), budget)
    if config.seed != former.seed:
        raise ConfigError(f"{run.path} has the seed {former.seed}, which a resumed run keeps")
    run.sweep()
    runner: Runner[Any] = kind(config, run)
    if run.begun:  # else it was killed before anything was learned
        runner.resume()
    if runner.finished and config != former:
        print(f"{run.path} was trained, and keeps its configuration", file=sys.stderr)
    else:
        for remark in _remarks(former, config):
            print(f"{run.path}: {remark}", file=sys.stderr)
    return runner


def _remarks(former: RunConfig, config: RunConfig) -> Iterator[str]:
    """Yield what a run that is resumed with other settings may not be expected to do."""
    rate, steps = getattr(config, "actor_rate", None), getattr(config, "steps", 0)
    longer = steps > getattr(former, "steps", 0)
    if longer and isinstance(rate, Ramp) and rate.end == 0 and rate.finish < steps:
        yield (
            f"its learning rate is 0 from step {rate.finish:,} on. To learn to the end: "
            f"--set actor_rate.finish={steps}"
        )
    if config.env.options != former.env.options:
        yield "its best checkpoint was chosen in the environment as it was before"


def _env_override(recipe: str, env: str | None) -> list[str]:
    """Return the override that names the environment of a recipe for any."""
    if env is None:
        return []
    theirs = RECIPES[recipe].settings.get("env", {}).get("name")
    if theirs != env and not RECIPES[recipe].any_env:
        some = ", ".join(name for name, entry in RECIPES.items() if entry.any_env)
        raise ConfigError(
            f"{recipe} is made for {theirs}, not for {env}; recipes for any environment: {some}"
        )
    return [f"env.name={json.dumps(env)}"]


def _budgeted(config: C, budget: str | None) -> C:
    if budget is None:
        return config
    from spikedeploy.trainers.sparse.sparse import with_budget

    return with_budget(config, budget)


def _with_paths(config: C) -> C:
    """Return the configuration with "last" replaced by its run folder, as the last run changes."""
    named = (key for key in ("teacher", "start", "pool") if getattr(config, key, "") == "last")
    return config.model_copy(update={key: str(RunFolder.find("last").path) for key in named})


def _learn(
    runner: Runner[Any],
    run: RunFolder,
    quiet: bool,
    stopped: Interrupt,
    watch: Callable[[Path], None] | None,
) -> None:
    """Run the algorithm under a progress bar until it ends or is stopped, then draw its curve."""
    with ProgressBar(run.path.name, quiet) as stopped.bar, stopped:
        journal = Journal(run, runner.columns(runner.config), stopped.bar, watch)
        try:
            if run.begun:
                journal.rewind(runner.step, runner.logged)
            if not (run.begun and runner.finished):  # else nothing is trained with other settings
                run.write_config(runner.config)
            if not run.begun:
                runner.begin()
            runner.learn(journal, stopped)
        finally:
            journal.close()
    stopped.share = None if runner.finished else runner.share
    with write_errors(run.path / "curve.png") as picture:
        draw_curve(run.metrics, picture, run.path.name)
