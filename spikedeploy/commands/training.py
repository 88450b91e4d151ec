"""`train`, `distill`, `tune`, `sweep`, `runs` and `visualize`: from a recipe to run folders."""

import re
import shlex
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from spikedeploy.commands.options import (
    ChipName,
    EnvName,
    File,
    Force,
    Json,
    OutputPath,
    OwnNetwork,
    Resume,
    RunsFolder,
    Settings,
    TrainedFor,
    TrainingSeed,
    Workers,
)
from spikedeploy.console import (
    name_program,
    print_json,
    print_result,
    print_text,
    program_name,
    say,
)
from spikedeploy.evaluation_setup import Count

_RUNS = Path("runs")


def train(
    *,
    what: Annotated[str, typer.Argument(metavar="RECIPE|ENV")] | None = None,
    recipe: Annotated[str, typer.Option(metavar="NAME")] | None = None,
    network: OwnNetwork | None = None,
    chip: TrainedFor | None = None,
    config: File | None = None,
    set_: Settings | None = None,
    budget: Annotated[str, typer.Option(metavar="sops=N|macs=N")] | None = None,
    seed: TrainingSeed | None = None,
    several: Annotated[str, typer.Option("--seeds", metavar="0-4|0,2,5")] | None = None,
    jobs: Count | None = None,
    resume: Resume | None = None,
    runs: RunsFolder = _RUNS,
    json: Json = False,
) -> None:
    """Train a policy. Ctrl-C stops at a checkpoint; --resume last goes on.

    what: name of a recipe; `recipes` lists them. With --recipe an environment: short name, id of
        gymnasium, or module:Class (default: with --resume that of the run)
    recipe: recipe for any environment, such as ppo-snn or sac-popsan; `recipes` lists them
        (default: the first argument)
    network: train a network of yours: a torch module, or a file, which training goes on from;
        recipe ppo-network, or sac-network
    chip: train in the integers of this chip: imitating a teacher, recipe for-chip, or with
        --network (default: in float)
    config: TOML file with settings
    set_: one setting, as in --set env.count=8
    budget: operations of a control step, of sparse recipes: spiking or float (default: the
        recipe's)
    seed: seed of the training (default: 0)
    several: train with several seeds side by side, each as a command of its own (default: one
        training)
    jobs: with --seeds: trainings side by side (default: all cores)
    """
    if what is None and (resume is None or recipe is not None):
        raise typer.BadParameter("name a RECIPE, an ENV with --recipe, or a run with --resume")
    from spikedeploy.training_settings import chip_student, own_network

    own: list[str] = []
    if network is not None:
        if what is None or resume is not None:
            raise typer.BadParameter(
                "--network goes with an ENV, as in train CartPole-v1 --network my_module:Net; a "
                "resumed run keeps its network"
            )
        recipe, own = recipe or "ppo-network", own_network(network, chip)
    elif chip is not None:
        if what is None or recipe is not None:
            raise typer.BadParameter(
                "--for goes with an ENV alone, train CartPole-v1 --for odin, or with --network"
            )
        recipe, own = "for-chip", chip_student(what, chip, set_ or [])
    settings: dict[str, Any] = {
        "env": what if recipe else None,
        "config_file": config,
        "overrides": [*own, *(set_ or ())],
        "budget": budget,
    }
    if several is not None:
        if seed is not None or resume is not None:
            raise typer.BadParameter("--seeds goes without --seed and --resume")
        _run_seeds(several, jobs, json, runs, recipe or what, **settings)
    if jobs is not None:
        raise typer.BadParameter("--jobs goes with --seeds")
    run = _learn(recipe or what, json, seed=seed, resume=resume, runs=runs, **settings)
    if json:
        print_json({"run": str(run)})
    else:
        typer.echo(f"trained: {run}\npage: {run / 'report.html'}\nnext: {_comparison(run)}")


def _comparison(run: Path, others: Sequence[str | Path] = (), options: Sequence[str] = ()) -> str:
    """Return the command that compares a run with other policies."""
    from spikedeploy.shipping.exported_run import trained_in

    words = ["compare", str(trained_in(str(run))), str(run), *map(str, others), *options]
    return f"{program_name()} {shlex.join(words)}"


def _learn(
    recipe: str | None,
    json: bool,
    *,
    seed: int | None = None,
    resume: str | Path | None = None,
    runs: Path = _RUNS,
    verb: str = "train",
    again: Path | None = None,
    **settings: Any,  # noqa: ANN401
) -> Path:
    """Train, write the page, and return the run; stopped by a signal, exit with its code.

    verb: the command that goes on, of the run `again`, by default the last one
    settings: more arguments of trainers.train.train
    """
    if resume is not None and seed is not None:
        raise typer.BadParameter("a resumed run keeps its seed: leave --seed out")
    from spikedeploy.reports.runs import LivePage
    from spikedeploy.trainers.progress import Interrupt
    from spikedeploy.trainers.train import train as learn

    interrupt, more = Interrupt(), {"seed": seed or 0, "resume": resume, "runs": runs, **settings}
    run = learn(recipe, quiet=json, interrupt=interrupt, watch=LivePage(), **more)
    _show_run(run)
    if interrupt.share is not None:
        if json:
            print_json({"run": str(run)})
        where = ["--runs", str(runs)] if again is None and runs != _RUNS else []
        words = shlex.join([verb, "--resume", str(again or "last"), *where])
        with suppress(OSError):  # of a terminal that was closed
            say(f"stopped at {100 * interrupt.share:.0f} %; go on with `spikedeploy {words}`")
        raise typer.Exit(interrupt.exit_code)
    return run


def _show_run(run: Path) -> None:
    """Write the page; a failure here does not affect the training."""
    from spikedeploy.reports.runs import write_run_page
    from spikedeploy.runtime.errors import SpikedeployError
    from spikedeploy.user_errors import one_line

    try:
        write_run_page(run)
    except (OSError, SpikedeployError) as error:
        with suppress(OSError):  # of a terminal that was closed
            say(f"the page is not written: {one_line(error) or error}")


def visualize(
    *,
    runs: Annotated[list[str], typer.Argument(metavar="RUN…")],
    output: OutputPath = Path("reports/curves.png"),
    force: Force = False,
    json: Json = False,
) -> None:
    """Draw the learning curves of training runs into one PNG.

    runs: run folders, or their names under runs/

    Output:
        output: PNG to write
    """
    from spikedeploy.outputs import check_output, has_text, mark
    from spikedeploy.reports.plots import draw_curves, read_curve
    from spikedeploy.trainers.run_folder import existing_run

    own = mark("visualize")
    folders = [Path(run) if Path(run).is_dir() else existing_run(run) for run in runs]
    check_output("-o", output, folders, force, lambda path: has_text(path, own))
    curves = [read_curve(run / "metrics.csv", run.resolve().name) for run in folders]
    picture = draw_curves(curves, output, own)
    record = {"path": str(picture), "curves": [vars(each) for each in curves]}
    print_result(json, record, f"wrote {picture}")


def _run_seeds(
    text: str,
    jobs: int | None,
    json: bool,
    runs: Path,
    recipe: str | None,
    config_file: Path | None,
    **settings: Any,  # noqa: ANN401
) -> None:
    """Train with each seed of a text such as `0-4`; print a line each and a table."""
    from spikedeploy.campaign.training_seeds import estimate, train_seeds
    from spikedeploy.comparison.statistics import FEWEST
    from spikedeploy.jobs import cores
    from spikedeploy.reports.table import Table
    from spikedeploy.seeds import training_seeds
    from spikedeploy.trainers.config import require_known
    from spikedeploy.trainers.recipes import RECIPES

    require_known(str(recipe), RECIPES, "recipe")  # before processes are started
    numbers = training_seeds("--seeds", text)
    count = min(jobs or cores(), len(numbers))
    file = str(config_file) if config_file else None
    arguments = {"recipe": recipe, "config_file": file, "runs": str(runs), **settings}
    say(f"{len(numbers)} trainings, {count} at a time; logs in {runs / 'logs'}")
    found, stopped = train_seeds(
        numbers, count, runs / "logs", arguments, lambda each: say(each.line)
    )
    mean = estimate(found)
    if json:
        print_json({"seeds": [vars(each) for each in found], "best": mean and mean.as_json()})
    else:
        rows = [
            (str(e.seed), "–" if e.best is None else f"{e.best:,.4g}", e.run or "–") for e in found
        ]
        Table(("seed", "best validation return", "run"), rows, str(recipe)).print()
        if mean is not None:
            few = f"; of fewer than {FEWEST} trainings the interval holds the truth too seldom"
            whole = sum(e.best is not None and not e.stopped for e in found)
            print_text(f"mean {mean.text(',.4g')}{few if whole < FEWEST else ''}")
    if stopped:
        for each in found:
            if each.run and each.stopped:
                say(f"go on with `spikedeploy train --resume {shlex.quote(each.run)}`")
        raise typer.Exit(130)
    raise typer.Exit(1 if any(each.failed for each in found) else 0)


def distill(
    *,
    teacher: Annotated[str, typer.Argument(metavar="TEACHER")] | None = None,
    env: Annotated[str, typer.Option(metavar="ENV")] | None = None,
    size: Annotated[str, typer.Option(metavar="N,N…")] | None = None,
    encoder: Literal["population", "rate", "delta"] | None = None,
    timesteps: Count | None = None,
    budget: Annotated[str, typer.Option(metavar="sops=N")] | None = None,
    dense: bool = False,
    rival: bool = True,
    network: OwnNetwork | None = None,
    chip: TrainedFor | None = None,
    set_: Settings | None = None,
    seed: TrainingSeed | None = None,
    resume: Resume | None = None,
    runs: RunsFolder = Path("runs"),
    json: Json = False,
) -> None:
    """Train a spiking student that imitates a teacher. A function of yours runs as your code.

    teacher: policy to imitate: .onnx (of rsl_rl too), .zip of Stable-Baselines3,
        my_module:function, a run folder, or a shipped policy (default: with --resume that of the
        run)
    env: short name, id of gymnasium, or module:Class (default: with --resume that of the run)
    set_: one setting, as in --set updates=8000
    seed: seed of the training (default: 0)

    Student:
        size: neurons of the hidden layers; one layer of a sparse student (default: 64; 64,64 if
            dense)
        encoder: code of the observation; population and rate make a dense student (default: delta;
            population if dense)
        timesteps: timesteps T of an inference; above 1 the student is dense (default: 1; 8 if
            dense)
        budget: prune to so many synaptic operations of a control step (default: as few as keep 98 %
            of the teacher in validation)
        dense: a student that is not pruned: 64-64 LIF neurons, population code
        rival: train a small float MLP beside it, pruned by the same rule
        network: train a network of yours: a torch module, or a file, which training goes on from;
            recipe distill-network
        chip: train in the integers of this chip; recipe for-chip, or distill-network with --network
            (default: in float)
    """
    if resume is None and (teacher is None or env is None):
        raise typer.BadParameter("name a TEACHER and --env ENV, or a run with --resume")
    own = {"--size": size, "--encoder": encoder, "--timesteps": timesteps, "--for": chip}
    own["--network"] = network
    named = [name for name, value in {**own, "--dense": dense or None}.items() if value is not None]
    if resume is not None and named:
        raise typer.BadParameter(f"a resumed run keeps its network: leave {', '.join(named)} out")
    from spikedeploy.commands.distillation import (
        describe,
        fronts,
        is_searched,
        print_fronts,
        rival_arguments,
        teacher_options,
    )
    from spikedeploy.training_settings import student

    recipe, settings = student(teacher, network, chip, size, encoder, timesteps, budget, dense)
    run = _learn(
        recipe if resume is None else None, json, env=env, overrides=[*settings, *(set_ or ())],
        budget=budget, seed=seed, resume=resume, runs=runs, verb="distill",
    )  # fmt: skip
    beside, levels = None, {}
    if is_searched(run):
        if rival:
            say("beside it: a small float MLP, pruned by the same rule (--no-rival leaves it out)")
            beside = _learn(json=json, again=run, verb="distill", **rival_arguments(run))
        levels = fronts(run, beside)
    if json:
        front = {name: [vars(each) for each in of] for name, of in levels.items()}
        print_json({"run": str(run), "rival": beside and str(beside), "front": front})
        return
    print_fronts(levels)
    next_ = _comparison(run, [beside] if beside else [], teacher_options(run))
    page = f"page: {run / 'report.html'}"
    typer.echo(f"trained: {run}\n{describe(run, levels)}{page}\nnext: {next_}")


_Objective = Literal["return", "return,sops"]


def tune(
    *,
    recipe: Annotated[str, typer.Argument(metavar="RECIPE")],
    env: EnvName | None = None,
    objective: _Objective = "return",
    search: Annotated[list[str], typer.Option(metavar="KEY=low..high[:log]|KEY=a|b")] | None = None,
    set_: Settings | None = None,
    trials: Count = 50,
    jobs: Count = 1,
    episodes: Count = 20,
    chip: ChipName | None = None,
    seed: TrainingSeed = 0,
    folder: Path | None = None,
    json: Json = False,
) -> None:
    """Search for the settings of a recipe with Optuna; go on where it stopped.

    recipe: name of a recipe; `recipes` lists them
    env: environment of a recipe for any: short name, id, or module:Class
    objective: return, or both return and SOPs, with the Pareto front
    search: what a setting may be, may be repeated (default: the recipe's own;
        docs/sweeps.md)
    set_: one setting of every training
    trials: trials of the search in all
    jobs: processes side by side, a core each
    episodes: episodes that judge a trial
    chip: chip of a spiking policy; 'float' for its float twin (default: that which it is trained
        for, or loihi1)
    seed: seed of the trainings
    folder: folder of the search, which goes on there (default: runs/tune/RECIPE)
    """
    from spikedeploy.campaign.tune import TuningPlan, best, describe
    from spikedeploy.campaign.tune import tune as find
    from spikedeploy.campaign.tune_page import is_study, study_page
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.page import FILES, write_page

    plan = TuningPlan(
        recipe=recipe, env=env or "", objective=objective,
        search=tuple(search or ()), fixed=tuple(set_ or ()), seed=seed, episodes=episodes,
        chip=chip or "",
    )  # fmt: skip
    of_env = re.sub(r"[^A-Za-z0-9.-]+", "-", plan.env)  # in letters that a path may have
    where = folder or Path("runs/tune") / "-".join(filter(None, (recipe, of_env)))
    # a study goes on; other people's files of these names stay
    check_output_folder("--folder", where, (*FILES, "journal.log"), (), False, is_study)
    study, finished = find(plan, where, trials, jobs, (lambda line: None) if json else say)
    chosen = best(plan, study)
    commands = [plan.command(trial.params) for trial in chosen]
    record = {
        "trials": [describe(trial) for trial in study.trials],
        "best": [{**describe(t), "command": c} for t, c in zip(chosen, commands, strict=True)],
    }
    page, _ = write_page("tune", study_page(plan, study), record, where)
    print_result(json, record, *commands, f"wrote {page}")
    raise typer.Exit(130 if not finished else 0 if chosen else 1)


def sweep(
    *,
    spec: Annotated[Path, typer.Argument(metavar="SPEC.toml", exists=True, dir_okay=False)],
    workers: Workers | None = None,
    retry: bool = False,
    run: bool = True,
    output: OutputPath | None = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Evaluate a grid of policies, chips, disturbances and seeds; run again, it goes on.

    spec: the grid: env, policy, chip, bits, disturb, fault, specimen, seed; docs/sweeps.md
    retry: run those again that failed, too
    run: run missing jobs; --no-run only shows what is there

    Output:
        output: folder of the results (default: runs/sweeps/NAME)
    """
    from spikedeploy.campaign.sweep import RESULTS, is_sweep, load_sweep, run_sweep
    from spikedeploy.campaign.sweep_grid import read_grid
    from spikedeploy.campaign.sweep_page import NUMBERS, print_sweep
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.page import FILES

    grid = read_grid(spec)
    folder = output or Path("runs/sweeps") / grid.name
    files = (*FILES, NUMBERS, RESULTS)
    check_output_folder("-o", folder, files, (spec,), force, is_sweep)
    found = run_sweep(grid, folder, workers, retry) if run else load_sweep(grid, folder)
    if json:
        print_json(found.as_json() | {"folder": str(folder), "ran": found.ran})
    else:
        print_sweep(found)
        for label, why in found.failures:
            typer.echo(f"failed: {label}: {why}", err=True)
        typer.echo(f"{found.summary}: {found.files[0]}")
    if found.interrupted:
        say("stopped; the same command goes on")
        raise typer.Exit(130)
    raise typer.Exit(1 if found.failed else 0)


# fields of RunScores; a test holds them together
SortKey = Literal["return", "success", "operations", "share", "age", "name"]


def runs(
    *,
    folder: Annotated[Path, typer.Option("--runs")] = Path("runs"),
    sort: SortKey = "age",
    env: EnvName | None = None,
    json: Json = False,
) -> None:
    """List training runs: validation return, success, operations, how far each came, age.

    folder: folder with the run folders; also those below it
    sort: column to sort by; the best, newest or first are on top
    env: only of this environment (default: all)
    """
    from spikedeploy.reports.runs import find_runs, run_table

    rows, damaged = find_runs(folder, env, sort)
    if json:
        print_json([row.as_json() for row in rows])
    elif rows:
        run_table(rows, folder).print()
    else:
        typer.echo(name_program(f"no runs in {folder}: `spikedeploy train RECIPE` makes one"))
    for line in damaged:
        typer.echo(f"left out: {line}", err=True)
