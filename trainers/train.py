"""Training: from the name of a recipe to a run folder.

An algorithm is a subclass of `Runner`, named in `trainers.ALGORITHMS`.
"""

import json
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

from spikedeploy.envs.foreign import is_target
from spikedeploy.envs.repeats import check_repeats
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import write_json
from spikedeploy.trainers import ALGORITHMS, metrics_file
from spikedeploy.trainers.config import C, RunConfig, amend, require_known, resolve
from spikedeploy.trainers.policies import NetworkPolicy, Policy
from spikedeploy.trainers.progress import Interrupt, Journal, ProgressBar
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import RunFolder, is_beginning, write_errors
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
    if resume is not None and recipe is None:
        recipe = str(RunFolder.find(resume, runs).settings()["recipe"])
    if recipe is None:
        raise ConfigError("name a recipe to train, or a run to resume")
    world = f". To train in it: `spikedeploy train {shlex.quote(recipe)} --recipe ppo-snn`"
    remedy = world if ":" in recipe or re.search(r"-v\d+$", recipe) else ""
    kind = algorithm(RECIPES[require_known(recipe, RECIPES, "recipe", remedy)].algorithm)
    changes: dict[str, Any] = {"file": config_file, "overrides": [*_named(recipe, env), *overrides]}
    if resume is not None:
        run = RunFolder.find(resume, runs, recipe)
        with run.locked():
            before = run.settings()
            if before["recipe"] != recipe:
                raise ConfigError(f"{run.path} is a run of '{before['recipe']}', not of '{recipe}'")
            if env not in (None, there := before["env"]["name"]):
                raise ConfigError(f"{run.path} was trained in {there}, not in {env}: name the run")
            former = run.config(kind.Config)
            config = _budgeted(amend(former, **changes), budget)
            _check_network(run.path, former, config)
            run.sweep()
            state = _check_left(run, kind, config)
            with _written(run, config):
                runner = kind(config, run)
                _check_sizes(run.path, state, runner.policy)
            _learn(runner, config, run, quiet, stopped, watch)
            if config != former and runner.step == state.get(kind.COUNTERS[0]) and runner.finished:
                write_json(run.path / "config.json", before)  # nothing was trained with the other
                print(f"{run.path} was trained, and keeps its configuration", file=sys.stderr)
        return run.path
    config = _budgeted(resolve(kind.Config, recipe, seed=seed, **changes), budget)
    if not config.env.name:
        raise ConfigError(
            f"{recipe} trains in any environment: name one, as in "
            f"`spikedeploy train CartPole-v1 --recipe {recipe}`"
        )
    if remark := check_repeats(config.env.name, config.env.options):  # unknown ones are refused
        print(remark, file=sys.stderr)
    config = _with_paths(config)
    run = RunFolder.create(runs, config)
    with run.locked(), _removed_if_refused(run):
        _learn(kind(config, run), config, run, quiet, stopped, watch)
    return run.path


def _named(recipe: str, env: str | None) -> list[str]:
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
    """Return the configuration with run names replaced by their folders, as names can change."""
    from spikedeploy.trainers.distill.teachers import find_shipped

    found = {}
    for key in ("teacher", "start", "pool"):
        name = str(getattr(config, key, ""))
        short = find_shipped(name) is None and not is_target(name) and is_beginning(name)
        if name == "last" or short:
            found[key] = str(RunFolder.find(name).path)
    return config.model_copy(update=found)


@contextmanager
def _removed_if_refused(run: RunFolder) -> Iterator[None]:
    """Remove a new run folder where its training is refused before anything was learned."""
    try:
        yield
    except BaseException:  # Ctrl-C too
        learned = any((run.path / "checkpoints").iterdir())
        if not learned and not (run.metrics.is_file() and metrics_file.read(run.metrics)):
            shutil.rmtree(run.path)
        raise


def _check_network(path: Path, former: RunConfig, config: RunConfig) -> None:
    """Refuse a run to be resumed with another network than it was begun with."""
    before, now = former.policy.model_dump(), config.policy.model_dump()
    if changed := [name for name in now if before.get(name) != now[name]]:
        some = ", ".join(f"policy.{name} is {before.get(name)}" for name in changed)
        raise ConfigError(f"a resumed run keeps its network, and in {path} {some}")


def _check_sizes(path: Path, state: Mapping[str, Any], policy: Policy) -> None:
    """Refuse a run to be resumed in an environment whose observations or actions are others."""
    for name in ("observations", "actions") if state else ():
        began, found = state["policy"].get(name), getattr(policy, name)
        if began not in (None, found):
            raise ConfigError(
                f"a resumed run keeps its network, and in {path} it has {began} {name}; with these "
                f"settings of env there are {found}"
            )
    if not state or not isinstance(policy, NetworkPolicy):
        return
    # numbers that are not trained are those of the checkpoint
    now = policy.spec()
    if any(state["policy"].get(name) != now[name] for name in ("network", "reset", "at_threshold")):
        raise ConfigError(
            f"a resumed run keeps its network, and that of policy.network is another now than in "
            f"{path}: bring its module or file back as it was"
        )


@contextmanager
def _written(run: RunFolder, config: RunConfig) -> Iterator[None]:
    """Write the configuration of a run to be resumed; the former one where it is refused."""
    before = run.settings()
    run.write_config(config)
    try:
        yield
    except Exception:
        write_json(run.path / "config.json", before)
        raise


def _check_left(run: RunFolder, kind: type[Runner[Any]], config: RunConfig) -> dict[str, Any]:
    """Refuse a run to be resumed whose tables are damaged, or whose last weights are missing.

    Return the numbers of its last checkpoint; without one it starts from the beginning.
    """
    run.check_weights("last")
    if not run.checkpoint("last").is_file():
        return {}
    state, _ = run.load("last")
    for table in kind.tables(run, config):
        table.check(state[kind.COUNTERS[0]], state)
    return state


def _learn(
    runner: Runner[Any],
    config: RunConfig,
    run: RunFolder,
    quiet: bool,
    stopped: Interrupt,
    watch: Callable[[Path], None] | None,
) -> None:
    """Run the algorithm under a progress bar until it ends or is stopped, then draw its curve."""
    with ProgressBar(run.path.name, quiet) as stopped.bar, stopped:
        journal = Journal(run, runner.columns(config), stopped.bar, watch)
        try:
            runner.learn(journal, stopped)
        finally:
            journal.close()
    stopped.share = None if runner.finished else runner.share
    with write_errors(run.path / "curve.png") as picture:
        metrics_file.draw_curve(run.metrics, picture, run.path.name)
